"""jaxnarx: engines from measurements, as multi-model networks refined in simulation.

The names for every day stand here. Families of methods for special ends stand in their
rooms, loaded on first use: `jnx.linear`, `jnx.inverse`, `jnx.design`, `jnx.sweep` and
the others that `dir(jnx)` shows.
"""

import importlib
import warnings
from typing import TYPE_CHECKING, Any

from jaxnarx.docstrings import document

if TYPE_CHECKING:
    from jaxnarx import calibration as calibration
    from jaxnarx import confidence as confidence
    from jaxnarx import control as control
    from jaxnarx import data as data
    from jaxnarx import design as design
    from jaxnarx import engines as engines
    from jaxnarx import errors as errors
    from jaxnarx import evaluation as evaluation
    from jaxnarx import excitation as excitation
    from jaxnarx import exporters as exporters
    from jaxnarx import fleet as fleet
    from jaxnarx import identification as identification
    from jaxnarx import inverse as inverse
    from jaxnarx import linear as linear
    from jaxnarx import metrics as metrics
    from jaxnarx import models as models
    from jaxnarx import partition as partition
    from jaxnarx import refinement as refinement
    from jaxnarx import regressors as regressors
    from jaxnarx import selection as selection
    from jaxnarx import settings as settings
    from jaxnarx import simulation as simulation
    from jaxnarx import sweep as sweep
    from jaxnarx.confidence import bands as bands
    from jaxnarx.confidence import domain as domain
    from jaxnarx.confidence import intervals as intervals
    from jaxnarx.confidence import uncertainty as uncertainty
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
    from jaxnarx.exporters import export as export
    from jaxnarx.identification import identify as identify
    from jaxnarx.models import Network as Network
    from jaxnarx.models import load as load
    from jaxnarx.models import save as save
    from jaxnarx.models import state_space as state_space
    from jaxnarx.partition import grow as grow
    from jaxnarx.refinement import freeze as freeze
    from jaxnarx.refinement import refine as refine
    from jaxnarx.refinement import stability as stability
    from jaxnarx.regressors import LowPass as LowPass
    from jaxnarx.regressors import Pool as Pool
    from jaxnarx.regressors import polynomial_pool as polynomial_pool
    from jaxnarx.selection import Selection as Selection
    from jaxnarx.selection import select as select
    from jaxnarx.settings import Anova as Anova
    from jaxnarx.settings import Backward as Backward
    from jaxnarx.settings import ForwardOLS as ForwardOLS
    from jaxnarx.settings import Given as Given
    from jaxnarx.settings import Global as Global
    from jaxnarx.settings import Grid as Grid
    from jaxnarx.settings import Identification as Identification
    from jaxnarx.settings import Lolimot as Lolimot
    from jaxnarx.settings import Placed as Placed
    from jaxnarx.settings import Polynomial as Polynomial
    from jaxnarx.settings import PredictionError as PredictionError
    from jaxnarx.settings import SigmoidTree as SigmoidTree
    from jaxnarx.settings import SimulationError as SimulationError
    from jaxnarx.settings import SimulationOLS as SimulationOLS
    from jaxnarx.settings import StepwiseF as StepwiseF
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

_ROOM_NAMES = {
    "confidence": "bands domain intervals uncertainty",
    "data": "Channel Channels Dataset check read read_split",
    "errors": "DataError JaxnarxError SpecError",
    "evaluation": "Report diagnose report",
    "exporters": "export",
    "identification": "identify",
    "models": "Network load save state_space",
    "partition": "grow",
    "refinement": "freeze refine stability",
    "regressors": "LowPass Pool polynomial_pool",
    "selection": "Selection select",
    "settings": "Anova Backward ForwardOLS Given Global Grid Identification Lolimot "
    "Placed Polynomial PredictionError SigmoidTree SimulationError "
    "SimulationOLS StepwiseF",
    "shell": "plot",
    "simulation": "free_run predict predict_ahead prepare residual simulate "
    "stack unstack",
    "solution": "RESULTS Solution",
    "sweep": "Fleet read_sweep run_sweep",
}
_ROOM_BY_NAME = {
    name: module for module, names in _ROOM_NAMES.items() for name in names.split()
}

_ROOM_MODULES = {
    name: f"jaxnarx.{name}"
    for name in (
        "calibration confidence control data design engines errors evaluation "
        "excitation exporters fleet identification inverse linear metrics models "
        "partition refinement regressors selection settings simulation sweep"
    ).split()
}

_MOVED_NAMES = {
    "DataFileError": "errors",
    "IdentificationWork": "sweep",
    "Kautz": "regressors",
    "Laguerre": "regressors",
    "ModelFileError": "errors",
    "Orthonormal": "regressors",
    "suggest_lags": "data",
}
"""Names of version 0.2 that stand in their rooms alone; here for one release more."""

_OLD_ROOMS = {
    "methods": "settings",
    "states": "linear",
    "targets": "exporters",
    "trust": "confidence",
}
"""Rooms of version 0.2 by their names now; as attributes for one release more."""

__all__ = sorted(_ROOM_BY_NAME)  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    """Load a name or a room on first use, so that `import jaxnarx` stays quick."""
    if name in _ROOM_MODULES:
        globals()[name] = room = importlib.import_module(_ROOM_MODULES[name])
        return room
    if name in _OLD_ROOMS:
        warnings.warn(
            f"jnx.{name} is now jnx.{_OLD_ROOMS[name]}",
            DeprecationWarning,
            stacklevel=2,
        )
        return importlib.import_module(f"jaxnarx.{_OLD_ROOMS[name]}")
    if name in _MOVED_NAMES:
        warnings.warn(
            f"jnx.{name} is now jnx.{_MOVED_NAMES[name]}.{name}",
            DeprecationWarning,
            stacklevel=2,
        )
        return getattr(importlib.import_module(f"jaxnarx.{_MOVED_NAMES[name]}"), name)
    if name not in _ROOM_BY_NAME:
        raise AttributeError(f"module 'jaxnarx' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"jaxnarx.{_ROOM_BY_NAME[name]}"), name)
    if _ROOM_BY_NAME[name] == "settings":
        document(value)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, *_ROOM_MODULES])
