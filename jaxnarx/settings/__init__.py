"""Settings of the verbs: frozen and jax-free, so that the command line can use them."""

from jaxnarx.settings.anova import Anova
from jaxnarx.settings.calibration import TIME as TIME
from jaxnarx.settings.calibration import Calibratable as Calibratable
from jaxnarx.settings.calibration import CalibrationSearch as CalibrationSearch
from jaxnarx.settings.calibration import CalibrationTask as CalibrationTask
from jaxnarx.settings.calibration import CycleLimit as CycleLimit
from jaxnarx.settings.calibration import Measure as Measure
from jaxnarx.settings.control import Command as Command
from jaxnarx.settings.control import OutputLimit as OutputLimit
from jaxnarx.settings.description import DESCRIPTION as DESCRIPTION
from jaxnarx.settings.design import OptimalDesign
from jaxnarx.settings.fields import field_hints as field_hints
from jaxnarx.settings.fields import union_members as union_members
from jaxnarx.settings.identification import Identification
from jaxnarx.settings.inverse import ActuatorLimits, TrackingError
from jaxnarx.settings.least_squares import LEAST_WINDOW_ERROR as LEAST_WINDOW_ERROR
from jaxnarx.settings.least_squares import LeastSquares, Recursive
from jaxnarx.settings.linear import (
    ARMAX,
    ARX,
    FIR,
    BoxJenkins,
    GeneralLinear,
    OutputError,
)
from jaxnarx.settings.linear import LinearMethod as LinearMethod
from jaxnarx.settings.linear import Orders as Orders
from jaxnarx.settings.partition import (
    Given,
    Global,
    Grid,
    Lolimot,
    Placed,
    SigmoidTree,
)
from jaxnarx.settings.physics import Physics
from jaxnarx.settings.physics import require_physics as require_physics
from jaxnarx.settings.pool import Polynomial
from jaxnarx.settings.presets import PRESETS as PRESETS
from jaxnarx.settings.presets import Preset as Preset
from jaxnarx.settings.protocols import PARTITIONS, SELECTORS, Partitioner, Selector
from jaxnarx.settings.refinement import PredictionError, SimulationError
from jaxnarx.settings.selection import Backward, ForwardOLS, StepwiseF
from jaxnarx.settings.simulation_ols import SimulationOLS
from jaxnarx.settings.states import HiddenStates
from jaxnarx.settings.tree import KIND_KEY as KIND_KEY
from jaxnarx.settings.tree import METHOD_KINDS as METHOD_KINDS
from jaxnarx.settings.tree import flatten_table as flatten_table
from jaxnarx.settings.tree import from_dict as from_dict
from jaxnarx.settings.tree import hint_at as hint_at
from jaxnarx.settings.tree import kind_names as kind_names
from jaxnarx.settings.tree import plain_value as plain_value
from jaxnarx.settings.tree import replace_at as replace_at
from jaxnarx.settings.tree import to_dict as to_dict
from jaxnarx.settings.tree import value_at as value_at

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
    "Physics",
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
