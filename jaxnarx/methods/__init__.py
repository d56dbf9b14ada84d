"""Settings of the verbs: frozen and jax-free, so that the command line can use them."""

from jaxnarx.methods.anova import Anova
from jaxnarx.methods.description import DESCRIPTION as DESCRIPTION
from jaxnarx.methods.design import OptimalDesign
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
