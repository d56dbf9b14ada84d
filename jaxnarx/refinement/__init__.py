"""Training of networks on simulation error; their stability and their uncertainty."""

from jaxnarx.refinement.bands import Bands, bands
from jaxnarx.refinement.criterion import squares
from jaxnarx.refinement.guard import Guard, Judged
from jaxnarx.refinement.layout import Layout, freeze, make_layout
from jaxnarx.refinement.problem import Problem
from jaxnarx.refinement.refine import refine
from jaxnarx.refinement.stability import (
    Certificate,
    Stability,
    certificate,
    certified,
    largest_local_pole,
    rate_of,
    stability,
)
from jaxnarx.refinement.stages import Stage, stages
from jaxnarx.refinement.uncertainty import Uncertainty, uncertainty

__all__ = [
    "Bands",
    "Certificate",
    "Guard",
    "Judged",
    "Layout",
    "Problem",
    "Stability",
    "Stage",
    "Uncertainty",
    "bands",
    "certificate",
    "certified",
    "freeze",
    "largest_local_pole",
    "make_layout",
    "rate_of",
    "refine",
    "squares",
    "stability",
    "stages",
    "uncertainty",
]
