"""Settings of the verbs: frozen and jax-free, so that the command line can use them."""

from jaxnarx.methods.anova import Anova
from jaxnarx.methods.description import DESCRIPTION as DESCRIPTION
from jaxnarx.methods.design import OptimalDesign
from jaxnarx.methods.fields import fields_of as fields_of
from jaxnarx.methods.fields import kinds_of as kinds_of
from jaxnarx.methods.identification import Identification
from jaxnarx.methods.inverse import ActuatorLimits, TrackingError
from jaxnarx.methods.least_squares import LeastSquares, Recursive
from jaxnarx.methods.linear import (
    ARMAX,
    ARX,
    FIR,
    BoxJenkins,
    GeneralLinear,
    OutputError,
)
from jaxnarx.methods.linear import LinearMethod as LinearMethod
from jaxnarx.methods.linear import Orders as Orders
from jaxnarx.methods.own import PARTITIONS, SELECTORS, Partitioner, Selector
from jaxnarx.methods.partition import (
    Given,
    Global,
    Grid,
    Lolimot,
    Placed,
    SigmoidTree,
)
from jaxnarx.methods.pool import Polynomial
from jaxnarx.methods.presets import PRESETS as PRESETS
from jaxnarx.methods.presets import Preset as Preset
from jaxnarx.methods.refinement import PredictionError, SimulationError
from jaxnarx.methods.selection import Backward, ForwardOLS, StepwiseF
from jaxnarx.methods.settings import KIND_KEY as KIND_KEY
from jaxnarx.methods.settings import METHOD_KINDS as METHOD_KINDS
from jaxnarx.methods.settings import by_path as by_path
from jaxnarx.methods.settings import from_dict as from_dict
from jaxnarx.methods.settings import hint_at as hint_at
from jaxnarx.methods.settings import names_of as names_of
from jaxnarx.methods.settings import plain_value as plain_value
from jaxnarx.methods.settings import replace_at as replace_at
from jaxnarx.methods.settings import to_dict as to_dict
from jaxnarx.methods.settings import value_at as value_at
from jaxnarx.methods.simulation_ols import SimulationOLS
from jaxnarx.methods.states import HiddenStates

__all__ = [
    "PARTITIONS",
    "SELECTORS",
    "ARMAX",
    "ARX",
    "FIR",
    "ActuatorLimits",
    "Anova",
    "Backward",
    "BoxJenkins",
    "ForwardOLS",
    "GeneralLinear",
    "Given",
    "Global",
    "Grid",
    "HiddenStates",
    "Identification",
    "LeastSquares",
    "Lolimot",
    "OptimalDesign",
    "OutputError",
    "Partitioner",
    "Placed",
    "Polynomial",
    "PredictionError",
    "Recursive",
    "Selector",
    "SigmoidTree",
    "SimulationError",
    "SimulationOLS",
    "StepwiseF",
    "TrackingError",
]
