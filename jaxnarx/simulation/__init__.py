"""Runs of a network: k steps ahead from measured history, or freely."""

from jaxnarx.simulation._prepared import Prepared as Prepared
from jaxnarx.simulation._prepared import check_records as check_records
from jaxnarx.simulation._prepared import ensure_prepared as ensure_prepared
from jaxnarx.simulation._prepared import get_dataset as get_dataset
from jaxnarx.simulation._prepared import match_records as match_records
from jaxnarx.simulation._prepared import prepare as prepare
from jaxnarx.simulation._prepared import stack_batch as stack_batch
from jaxnarx.simulation._prepared import stack_fitting as stack_fitting
from jaxnarx.simulation.masks import Masks as Masks
from jaxnarx.simulation.masks import first_anchor as first_anchor
from jaxnarx.simulation.masks import make_masks as make_masks
from jaxnarx.simulation.masks import tables as tables
from jaxnarx.simulation.masks import window_anchors as window_anchors
from jaxnarx.simulation.observer import begin_hidden as begin_hidden
from jaxnarx.simulation.observer import observe_hidden as observe_hidden
from jaxnarx.simulation.outputs import free_run as free_run
from jaxnarx.simulation.outputs import predict_ahead as predict_ahead
from jaxnarx.simulation.outputs import ready as ready
from jaxnarx.simulation.outputs import residual as residual
from jaxnarx.simulation.outputs import run_parts as run_parts
from jaxnarx.simulation.outputs import run_status as run_status
from jaxnarx.simulation.outputs import scaled_run as scaled_run
from jaxnarx.simulation.outputs import stack as stack
from jaxnarx.simulation.outputs import start_hidden as start_hidden
from jaxnarx.simulation.outputs import unstack as unstack
from jaxnarx.simulation.runs import RunInputs as RunInputs
from jaxnarx.simulation.runs import drive_from_signals as drive_from_signals
from jaxnarx.simulation.runs import make_drive as make_drive
from jaxnarx.simulation.runs import run as run
from jaxnarx.simulation.runs import run_steps as run_steps
from jaxnarx.simulation.runs import states as states
from jaxnarx.simulation.trajectories import IN_A_ROW as IN_A_ROW
from jaxnarx.simulation.trajectories import Trajectories as Trajectories
from jaxnarx.simulation.trajectories import has_diverged as has_diverged
from jaxnarx.simulation.trajectories import join_runs as join_runs
from jaxnarx.simulation.trajectories import limited_samples as limited_samples
from jaxnarx.simulation.verbs import predict as predict
from jaxnarx.simulation.verbs import simulate as simulate

__all__ = [
    "Prepared",
    "Trajectories",
    "free_run",
    "has_diverged",
    "predict",
    "predict_ahead",
    "prepare",
    "ready",
    "residual",
    "run_status",
    "simulate",
    "stack",
    "unstack",
]
