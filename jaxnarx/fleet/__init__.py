"""Fleets: one structure, a population of engines, a new one from few samples."""

from jaxnarx.data import Fleet as Fleet
from jaxnarx.fleet._calibrate import calibrate as calibrate
from jaxnarx.fleet._calibrate import calibrate_each as calibrate_each
from jaxnarx.fleet._compare import EngineChange as EngineChange
from jaxnarx.fleet._compare import compare_records as compare_records
from jaxnarx.fleet._learn import learn as learn
from jaxnarx.fleet._plan import plan as plan
from jaxnarx.fleet.calibration_work import CalibrationWork as CalibrationWork
from jaxnarx.fleet.draws import draw_engines as draw_engines
from jaxnarx.fleet.population import Population as Population
from jaxnarx.fleet.prior import FleetPrior as FleetPrior
from jaxnarx.fleet.prior import load_prior as load_prior
from jaxnarx.fleet.prior import save_prior as save_prior
