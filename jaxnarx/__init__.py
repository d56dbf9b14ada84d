"""jaxnarx: engines from measurements, as multi-model networks refined in simulation.

The names for every day stand here. Families of methods for special ends stand in their
rooms, loaded on first use: `jnx.linear`, `jnx.inverse`, `jnx.design`, `jnx.sweep` and
the others that `dir(jnx)` shows.
"""

import importlib
import warnings
from typing import TYPE_CHECKING, Any

from jaxnarx.texts import document

if TYPE_CHECKING:
    from jaxnarx import data as data
    from jaxnarx import design as design
    from jaxnarx import engines as engines
    from jaxnarx import errors as errors
    from jaxnarx import evaluation as evaluation
    from jaxnarx import excitation as excitation
    from jaxnarx import identification as identification
    from jaxnarx import inverse as inverse
    from jaxnarx import linear as linear
    from jaxnarx import methods as methods
    from jaxnarx import metrics as metrics
    from jaxnarx import models as models
    from jaxnarx import partition as partition
    from jaxnarx import refinement as refinement
    from jaxnarx import regressors as regressors
    from jaxnarx import selection as selection
    from jaxnarx import simulation as simulation
    from jaxnarx import states as states
    from jaxnarx import sweep as sweep
    from jaxnarx import targets as targets
    from jaxnarx import trust as trust
    from jaxnarx.data import Channel as Channel
    from jaxnarx.data import Channels as Channels
    from jaxnarx.data import Dataset as Dataset
    from jaxnarx.data import check as check
    from jaxnarx.data import read as read
    from jaxnarx.data import read_split as read_split
    from jaxnarx.errors import DataError as DataError
    from jaxnarx.errors import JaxnarxError as JaxnarxError
    from jaxnarx.errors import SpecError as SpecError
    from jaxnarx.evaluation import Report as Report
    from jaxnarx.evaluation import diagnose as diagnose
    from jaxnarx.evaluation import report as report
    from jaxnarx.identification import identify as identify
    from jaxnarx.methods import Anova as Anova
    from jaxnarx.methods import Backward as Backward
    from jaxnarx.methods import ForwardOLS as ForwardOLS
    from jaxnarx.methods import Given as Given
    from jaxnarx.methods import Global as Global
    from jaxnarx.methods import Grid as Grid
    from jaxnarx.methods import Identification as Identification
    from jaxnarx.methods import Lolimot as Lolimot
    from jaxnarx.methods import Placed as Placed
    from jaxnarx.methods import Polynomial as Polynomial
    from jaxnarx.methods import PredictionError as PredictionError
    from jaxnarx.methods import SigmoidTree as SigmoidTree
    from jaxnarx.methods import SimulationError as SimulationError
    from jaxnarx.methods import SimulationOLS as SimulationOLS
    from jaxnarx.methods import StepwiseF as StepwiseF
    from jaxnarx.models import Network as Network
    from jaxnarx.models import load as load
    from jaxnarx.models import save as save
    from jaxnarx.models import state_space as state_space
    from jaxnarx.partition import grow as grow
    from jaxnarx.refinement import bands as bands
    from jaxnarx.refinement import freeze as freeze
    from jaxnarx.refinement import refine as refine
    from jaxnarx.refinement import stability as stability
    from jaxnarx.refinement import uncertainty as uncertainty
    from jaxnarx.regressors import LowPass as LowPass
    from jaxnarx.regressors import Pool as Pool
    from jaxnarx.regressors import polynomial_pool as polynomial_pool
    from jaxnarx.selection import Selection as Selection
    from jaxnarx.selection import select as select
    from jaxnarx.shell import plot as plot
    from jaxnarx.simulation import free_run as free_run
    from jaxnarx.simulation import predict as predict
    from jaxnarx.simulation import predict_ahead as predict_ahead
    from jaxnarx.simulation import prepare as prepare
    from jaxnarx.simulation import residual as residual
    from jaxnarx.simulation import simulate as simulate
    from jaxnarx.simulation import stack as stack
    from jaxnarx.simulation import unstack as unstack
    from jaxnarx.solution import RESULTS as RESULTS
    from jaxnarx.solution import Solution as Solution
    from jaxnarx.sweep import Fleet as Fleet
    from jaxnarx.sweep import read_sweep as read_sweep
    from jaxnarx.sweep import run_sweep as run_sweep
    from jaxnarx.targets import export as export
    from jaxnarx.trust import domain as domain
    from jaxnarx.trust import intervals as intervals

_HOME = {
    "data": "Channel Channels Dataset check read read_split",
    "errors": "DataError JaxnarxError SpecError",
    "evaluation": "Report diagnose report",
    "identification": "identify",
    "methods": "Anova Backward ForwardOLS Given Global Grid Identification Lolimot "
    "Placed Polynomial PredictionError SigmoidTree SimulationError "
    "SimulationOLS StepwiseF",
    "models": "Network load save state_space",
    "partition": "grow",
    "refinement": "bands freeze refine stability uncertainty",
    "regressors": "LowPass Pool polynomial_pool",
    "selection": "Selection select",
    "shell": "plot",
    "simulation": "free_run predict predict_ahead prepare residual simulate "
    "stack unstack",
    "solution": "RESULTS Solution",
    "sweep": "Fleet read_sweep run_sweep",
    "targets": "export",
    "trust": "domain intervals",
}
_MODULE = {name: module for module, names in _HOME.items() for name in names.split()}

_ROOMS = {
    name: f"jaxnarx.{name}"
    for name in (
        "data design engines errors evaluation excitation identification inverse "
        "linear methods metrics models partition refinement regressors selection "
        "simulation states sweep targets trust"
    ).split()
}

_MOVED = {
    "DataFileError": "errors",
    "IdentificationWork": "sweep",
    "Kautz": "regressors",
    "Laguerre": "regressors",
    "ModelFileError": "errors",
    "Orthonormal": "regressors",
    "suggest_lags": "data",
}
"""Names of version 0.2 that stand in their rooms alone; here for one release more."""

__all__ = sorted(_MODULE)  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    """Load a name or a room on first use, so that `import jaxnarx` stays quick."""
    if name in _ROOMS:
        globals()[name] = room = importlib.import_module(_ROOMS[name])
        return room
    if name in _MOVED:
        warnings.warn(
            f"jnx.{name} is now jnx.{_MOVED[name]}.{name}",
            DeprecationWarning,
            stacklevel=2,
        )
        return getattr(importlib.import_module(f"jaxnarx.{_MOVED[name]}"), name)
    if name not in _MODULE:
        raise AttributeError(f"module 'jaxnarx' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"jaxnarx.{_MODULE[name]}"), name)
    if _MODULE[name] == "methods":
        document(value)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, *_ROOMS])
