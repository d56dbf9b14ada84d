"""Where a model may be trusted, and what it does beyond."""

from jaxnarx.trust._domain import DomainIndex, Excursion, domain
from jaxnarx.trust._intervals import Intervals, intervals
from jaxnarx.trust._released import knowing, released
from jaxnarx.trust.errors import error_variables, learn_errors
from jaxnarx.trust.learn import learn_domain

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
