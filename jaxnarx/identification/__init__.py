"""A whole identification by one settings tree."""

from jaxnarx.identification.pools import joint_pool, make_pool, terms_of
from jaxnarx.identification.verb import Events, identify, needed

__all__ = ["Events", "identify", "joint_pool", "make_pool", "needed", "terms_of"]
