"""Training of networks on simulation error, and their stability."""

from jaxnarx.arrays import ValidationScore
from jaxnarx.refinement._refine import make_task as make_task
from jaxnarx.refinement._refine import refine
from jaxnarx.refinement._refine import refine_task as refine_task
from jaxnarx.refinement._stability import (
    Certificate,
    Stability,
    attach_certificate,
    certificate,
    largest_local_pole,
    rate_of,
    stability,
    stays_bounded,
)
from jaxnarx.refinement._stages import Stage, stages
from jaxnarx.refinement.criterion import squares
from jaxnarx.refinement.gauss_newton import normal_equations as normal_equations
from jaxnarx.refinement.labels import Labels as Labels
from jaxnarx.refinement.labels import label as label
from jaxnarx.refinement.layout import Layout, freeze, make_layout
from jaxnarx.refinement.problem import Problem
from jaxnarx.refinement.sensitivity import join_blocks as join_blocks
from jaxnarx.refinement.sensitivity import linearise_run as linearise_run
from jaxnarx.refinement.sensitivity import seen_history as seen_history
from jaxnarx.refinement.sensitivity import stream as stream
from jaxnarx.refinement.starts import FEEDBACK_FACTORS as FEEDBACK_FACTORS
from jaxnarx.refinement.starts import shrunk as shrunk
from jaxnarx.refinement.training_data import TrainingData as TrainingData
from jaxnarx.refinement.validation import Validator

__all__ = [
    "Certificate",
    "Validator",
    "ValidationScore",
    "Layout",
    "Problem",
    "Stability",
    "Stage",
    "certificate",
    "attach_certificate",
    "freeze",
    "largest_local_pole",
    "make_layout",
    "rate_of",
    "refine",
    "squares",
    "stability",
    "stages",
    "stays_bounded",
]
