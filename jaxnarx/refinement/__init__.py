"""Training of networks on simulation error."""

from jaxnarx.refinement.layout import freeze
from jaxnarx.refinement.refine import refine

__all__ = ["freeze", "refine"]
