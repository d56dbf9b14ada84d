"""Training of networks on simulation error; their stability and their uncertainty."""

from jaxnarx.refinement.bands import Bands, bands
from jaxnarx.refinement.layout import Layout, freeze, make_layout
from jaxnarx.refinement.normal import loss, normal_equations
from jaxnarx.refinement.refine import refine
from jaxnarx.refinement.stability import Stability, stability
from jaxnarx.refinement.stages import Stage, stages
from jaxnarx.refinement.uncertainty import Uncertainty, uncertainty

__all__ = [
    "Bands",
    "Layout",
    "Stability",
    "Stage",
    "Uncertainty",
    "bands",
    "freeze",
    "loss",
    "make_layout",
    "normal_equations",
    "refine",
    "stability",
    "stages",
    "uncertainty",
]
