"""Many engines, settings or starts at once: resumable, on several processes."""

from typing import TYPE_CHECKING

from jaxnarx.data import Fleet as Fleet
from jaxnarx.deprecation import find_old as _find_old
from jaxnarx.sweep.analysis import Comparison as Comparison
from jaxnarx.sweep.analysis import Interval as Interval
from jaxnarx.sweep.analysis import SweepTable as SweepTable
from jaxnarx.sweep.analysis import best_per_group as best_per_group
from jaxnarx.sweep.analysis import paired_comparison as paired_comparison
from jaxnarx.sweep.analysis import pareto_front as pareto_front
from jaxnarx.sweep.analysis import summary as summary
from jaxnarx.sweep.cases import grid_cases as grid_cases
from jaxnarx.sweep.cases import random_cases as random_cases
from jaxnarx.sweep.devices import OverDevices as OverDevices
from jaxnarx.sweep.drive import describe_progress as describe_progress
from jaxnarx.sweep.drive import read_sweep as read_sweep
from jaxnarx.sweep.drive import run_sweep as run_sweep
from jaxnarx.sweep.folder.run_folder import find_run as find_run
from jaxnarx.sweep.identify import IdentificationWork as IdentificationWork
from jaxnarx.sweep.identify import identify_each as identify_each
from jaxnarx.sweep.identify import network_of as network_of
from jaxnarx.sweep.identify import score_names as score_names
from jaxnarx.sweep.progress import Progress as Progress
from jaxnarx.sweep.work import Work as Work

if not TYPE_CHECKING:

    def __getattr__(name):
        return _find_old(__name__, name, {"so_far": "describe_progress"})
