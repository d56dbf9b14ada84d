"""Training of networks on simulation error; their stability and their uncertainty."""

from jaxnarx.refinement.bands import Bands, bands
from jaxnarx.refinement.layout import freeze
from jaxnarx.refinement.refine import refine
from jaxnarx.refinement.stability import Stability, stability
from jaxnarx.refinement.uncertainty import Uncertainty, uncertainty

__all__ = [
    "Bands",
    "Stability",
    "Uncertainty",
    "bands",
    "freeze",
    "refine",
    "stability",
    "uncertainty",
]
