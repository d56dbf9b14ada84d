"""Calibration by gradient: maps of a control unit, optimised through the free run.

A plant, a cycle, maps that set some of the plant's inputs, what is wanted and what must
be kept: `optimise` moves the points of the maps by gradients of the whole cycle.
Reference: H. Langouet, L. Metivier, D. Sinoquet, Q.-H. Tran, Engine calibration:
multi-objective constrained optimization of engine maps, Optimization and Engineering
12, 2011 (the task, by evolution strategies).
"""

from jaxnarx.calibration._optimise import optimise as optimise
from jaxnarx.calibration._read_map import read_map as read_map
from jaxnarx.calibration._trade_off import trade_off as trade_off
from jaxnarx.calibration.formulas import signals_of as signals_of
from jaxnarx.calibration.plants import AbstractPlant as AbstractPlant
from jaxnarx.calibration.plants import EnginePlant as EnginePlant
from jaxnarx.calibration.plants import FunctionPlant as FunctionPlant
from jaxnarx.calibration.plants import NetworkPlant as NetworkPlant
from jaxnarx.calibration.plants import as_plant as as_plant
from jaxnarx.calibration.result import CalibratedMap as CalibratedMap
from jaxnarx.calibration.result import Calibration as Calibration
from jaxnarx.calibration.result import MeasureRow as MeasureRow
from jaxnarx.calibration.setup import require_inputs as require_inputs
from jaxnarx.calibration.tables import LookupTable as LookupTable
from jaxnarx.docstrings import document
from jaxnarx.settings import Calibratable as Calibratable
from jaxnarx.settings import CalibrationSearch as CalibrationSearch
from jaxnarx.settings import CalibrationTask as CalibrationTask
from jaxnarx.settings import CycleLimit as CycleLimit
from jaxnarx.settings import Measure as Measure

__all__ = [
    "Calibratable",
    "CalibratedMap",
    "Calibration",
    "CalibrationSearch",
    "CycleLimit",
    "EnginePlant",
    "FunctionPlant",
    "Measure",
    "MeasureRow",
    "NetworkPlant",
    "LookupTable",
    "optimise",
    "read_map",
    "trade_off",
]

document(Calibratable, Measure, CycleLimit, CalibrationSearch)
