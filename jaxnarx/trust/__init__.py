"""Where a model may be trusted, and what it does beyond."""

from jaxnarx.trust.domain import DomainIndex, Excursion, domain
from jaxnarx.trust.errors import error_variables, learn_errors
from jaxnarx.trust.intervals import Intervals, intervals
from jaxnarx.trust.learn import learn_domain
from jaxnarx.trust.released import knowing, released

__all__ = [
    "DomainIndex",
    "Excursion",
    "Intervals",
    "domain",
    "error_variables",
    "intervals",
    "knowing",
    "learn_domain",
    "learn_errors",
    "released",
]
