"""Where a model may be trusted: the domain of its training."""

from jaxnarx.trust.domain import DomainIndex, Excursion, domain
from jaxnarx.trust.learn import learn_domain

__all__ = ["DomainIndex", "Excursion", "domain", "learn_domain"]
