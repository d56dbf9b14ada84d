"""jaxnarx: engines from measurements, as multi-model networks refined in simulation."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxnarx.data import Channel as Channel
    from jaxnarx.data import Channels as Channels
    from jaxnarx.data import Dataset as Dataset
    from jaxnarx.data import check as check
    from jaxnarx.data import read as read
    from jaxnarx.data import read_split as read_split
    from jaxnarx.data import suggest_lags as suggest_lags
    from jaxnarx.errors import DataError as DataError
    from jaxnarx.errors import DataFileError as DataFileError
    from jaxnarx.errors import JaxnarxError as JaxnarxError
    from jaxnarx.errors import ModelFileError as ModelFileError
    from jaxnarx.errors import SpecError as SpecError
    from jaxnarx.evaluation import Report as Report
    from jaxnarx.evaluation import report as report
    from jaxnarx.methods import ForwardOLS as ForwardOLS
    from jaxnarx.methods import Global as Global
    from jaxnarx.methods import Lolimot as Lolimot
    from jaxnarx.methods import SimulationError as SimulationError
    from jaxnarx.models import Network as Network
    from jaxnarx.models import load as load
    from jaxnarx.models import save as save
    from jaxnarx.partition import grow as grow
    from jaxnarx.refinement import refine as refine
    from jaxnarx.regressors import Pool as Pool
    from jaxnarx.regressors import polynomial_pool as polynomial_pool
    from jaxnarx.selection import Selection as Selection
    from jaxnarx.selection import select as select
    from jaxnarx.simulation import predict as predict
    from jaxnarx.simulation import simulate as simulate
    from jaxnarx.solution import RESULTS as RESULTS
    from jaxnarx.solution import Solution as Solution

_HOME = {
    "data": "Channel Channels Dataset check read read_split suggest_lags",
    "errors": "DataError DataFileError JaxnarxError ModelFileError SpecError",
    "evaluation": "Report report",
    "methods": "ForwardOLS Global Lolimot SimulationError",
    "models": "Network load save",
    "partition": "grow",
    "refinement": "refine",
    "regressors": "Pool polynomial_pool",
    "selection": "Selection select",
    "simulation": "predict simulate",
    "solution": "RESULTS Solution",
}
_MODULE = {name: module for module, names in _HOME.items() for name in names.split()}

__all__ = sorted(_MODULE)  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    """Load a public name on first use, so that `import jaxnarx` stays quick."""
    if name not in _MODULE:
        raise AttributeError(f"module 'jaxnarx' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"jaxnarx.{_MODULE[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
