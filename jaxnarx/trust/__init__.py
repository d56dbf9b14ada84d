"""Where a model may be trusted: the domain of its training."""

from jaxnarx.trust.domain import DomainIndex, Excursion, domain
from jaxnarx.trust.learn import knowing, learn_domain

__all__ = ["DomainIndex", "Excursion", "domain", "knowing", "learn_domain"]
