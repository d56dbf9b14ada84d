"""Where a model may be trusted, and what it does beyond."""

from jaxnarx.trust.domain import DomainIndex, Excursion, domain
from jaxnarx.trust.learn import learn_domain
from jaxnarx.trust.released import knowing, released

__all__ = ["DomainIndex", "Excursion", "domain", "knowing", "learn_domain", "released"]
