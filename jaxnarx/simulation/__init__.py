"""Runs of a network: k steps ahead from measured history, or freely."""

from jaxnarx.simulation.masks import Masks as Masks
from jaxnarx.simulation.masks import first_anchor as first_anchor
from jaxnarx.simulation.masks import make_masks as make_masks
from jaxnarx.simulation.masks import tables as tables
from jaxnarx.simulation.masks import window_anchors as window_anchors
from jaxnarx.simulation.observer import begun as begun
from jaxnarx.simulation.observer import observed as observed
from jaxnarx.simulation.runs import RunInputs as RunInputs
from jaxnarx.simulation.runs import drive_of as drive_of
from jaxnarx.simulation.runs import make_drive as make_drive
from jaxnarx.simulation.runs import recursion as recursion
from jaxnarx.simulation.runs import run as run
from jaxnarx.simulation.runs import run_record as run_record
from jaxnarx.simulation.runs import run_states as run_states
from jaxnarx.simulation.runs import run_steps as run_steps
from jaxnarx.simulation.runs import states as states
from jaxnarx.simulation.trajectories import IN_A_ROW as IN_A_ROW
from jaxnarx.simulation.trajectories import Trajectories as Trajectories
from jaxnarx.simulation.trajectories import has_diverged as has_diverged
from jaxnarx.simulation.trajectories import limited as limited
from jaxnarx.simulation.verbs import fitting as fitting
from jaxnarx.simulation.verbs import predict as predict
from jaxnarx.simulation.verbs import simulate as simulate
from jaxnarx.simulation.verbs import stacked as stacked
