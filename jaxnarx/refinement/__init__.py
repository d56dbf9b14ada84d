"""Training of networks on simulation error."""

from jaxnarx.refinement.layout import default_trainable, freeze
from jaxnarx.refinement.refine import refine

__all__ = ["default_trainable", "freeze", "refine"]
