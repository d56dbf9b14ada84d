"""Validity functions, local models and the network that blends them."""

from typing import TYPE_CHECKING

from jaxnarx.deprecation import find_old as _find_old
from jaxnarx.models._assemble import OUTPUT_MARGIN as OUTPUT_MARGIN
from jaxnarx.models._assemble import assemble as assemble
from jaxnarx.models._assemble import global_model as global_model
from jaxnarx.models._assemble import local_models as local_models
from jaxnarx.models._assemble import output_model as output_model
from jaxnarx.models._assemble import ranges as ranges
from jaxnarx.models._assemble import set_bounds as set_bounds
from jaxnarx.models._assemble import set_ranges as set_ranges
from jaxnarx.models._assemble import training_bounds as training_bounds
from jaxnarx.models._combine_outputs import combine_outputs as combine_outputs
from jaxnarx.models._combine_outputs import hidden_names as hidden_names
from jaxnarx.models._split_outputs import NetworkPart as NetworkPart
from jaxnarx.models._split_outputs import split_outputs as split_outputs
from jaxnarx.models._total import total as total
from jaxnarx.models.domain import LARGEST_INDEX as LARGEST_INDEX
from jaxnarx.models.domain import LAYERS as LAYERS
from jaxnarx.models.domain import Domain as Domain
from jaxnarx.models.drop_channels import drop_outputs as drop_outputs
from jaxnarx.models.error_model import GROWTH_EXPONENT as GROWTH_EXPONENT
from jaxnarx.models.error_model import STORED_PROBABILITIES as STORED_PROBABILITIES
from jaxnarx.models.error_model import ErrorModel as ErrorModel
from jaxnarx.models.feedback import advance as advance
from jaxnarx.models.feedback import collapse as collapse
from jaxnarx.models.feedback import collapsed_step as collapsed_step
from jaxnarx.models.feedback import collapses as collapses
from jaxnarx.models.feedback import depth as depth
from jaxnarx.models.feedback import fed_back_variables as fed_back_variables
from jaxnarx.models.feedback import fold_slopes as fold_slopes
from jaxnarx.models.feedback import general_step as general_step
from jaxnarx.models.feedback import group_weights as group_weights
from jaxnarx.models.feedback import looks_back as looks_back
from jaxnarx.models.feedback import monomials as monomials
from jaxnarx.models.feedback import places as places
from jaxnarx.models.feedback import respond as respond
from jaxnarx.models.feedback import sources as sources
from jaxnarx.models.feedback import term_values as term_values
from jaxnarx.models.feedback import widen as widen
from jaxnarx.models.feedback import with_history as with_history
from jaxnarx.models.feedback import with_own as with_own
from jaxnarx.models.limits import held_inputs as held_inputs
from jaxnarx.models.limits import hold_signals as hold_signals
from jaxnarx.models.limits import hold_to_range as hold_to_range
from jaxnarx.models.limits import overshoot as overshoot
from jaxnarx.models.limits import overshoot_decay as overshoot_decay
from jaxnarx.models.limits import overshoot_rule as overshoot_rule
from jaxnarx.models.limits import report_outputs as report_outputs
from jaxnarx.models.limits import reported_range as reported_range
from jaxnarx.models.limits import within_margin as within_margin
from jaxnarx.models.missing import Gaps as Gaps
from jaxnarx.models.missing import hold_missing as hold_missing
from jaxnarx.models.missing import input_memory as input_memory
from jaxnarx.models.missing import largest_sizes as largest_sizes
from jaxnarx.models.missing import set_nan_policy as set_nan_policy
from jaxnarx.models.missing import trusted_samples as trusted_samples
from jaxnarx.models.network import MISSING as MISSING
from jaxnarx.models.network import LocalModels as LocalModels
from jaxnarx.models.network import Network as Network
from jaxnarx.models.network import OutputModel as OutputModel
from jaxnarx.models.observer import PRIOR_WEIGHT as PRIOR_WEIGHT
from jaxnarx.models.observer import hidden_start as hidden_start
from jaxnarx.models.observer import scales as scales
from jaxnarx.models.observer import start_of_window as start_of_window
from jaxnarx.models.observer import window_size as window_size
from jaxnarx.models.observer import with_hidden_start as with_hidden_start
from jaxnarx.models.outside import FLAG as FLAG
from jaxnarx.models.outside import HOLD as HOLD
from jaxnarx.models.outside import LINEAR as LINEAR
from jaxnarx.models.outside import NAN as NAN
from jaxnarx.models.outside import OUTSIDE as OUTSIDE
from jaxnarx.models.outside import OUTSIDE_WORDS as OUTSIDE_WORDS
from jaxnarx.models.policies import describe_limits as describe_limits
from jaxnarx.models.policies import describe_missing as describe_missing
from jaxnarx.models.policies import describe_policies as describe_policies
from jaxnarx.models.record_run import recursion as recursion
from jaxnarx.models.record_run import run_record as run_record
from jaxnarx.models.record_run import run_states as run_states
from jaxnarx.models.rest_pairs import INPUT_STEP_SHARE as INPUT_STEP_SHARE
from jaxnarx.models.rest_pairs import RestPairs as RestPairs
from jaxnarx.models.rest_pairs import make_pairs as make_pairs
from jaxnarx.models.scheduling import scaled_points as scaled_points
from jaxnarx.models.scheduling import scheduling_values as scheduling_values
from jaxnarx.models.scheduling import weights_at as weights_at
from jaxnarx.models.signed_root import LEAST_DISTANCE as LEAST_DISTANCE
from jaxnarx.models.signed_root import SignedRoot as SignedRoot
from jaxnarx.models.state import carried as carried
from jaxnarx.models.state import driving_signals as driving_signals
from jaxnarx.models.state import filter_poles as filter_poles
from jaxnarx.models.state import remember_outputs as remember_outputs
from jaxnarx.models.state import require_computed as require_computed
from jaxnarx.models.state import state_sizes as state_sizes
from jaxnarx.models.state_form import REST_STEPS as REST_STEPS
from jaxnarx.models.state_form import REST_TOLERANCE as REST_TOLERANCE
from jaxnarx.models.state_form import StateForm as StateForm
from jaxnarx.models.state_form import middle_inputs as middle_inputs
from jaxnarx.models.state_form import state_space as state_space
from jaxnarx.models.storage import load as load
from jaxnarx.models.storage import load_about as load_about
from jaxnarx.models.storage import save as save
from jaxnarx.models.validate import require_consistent as require_consistent
from jaxnarx.models.validity import VALIDITIES as VALIDITIES
from jaxnarx.models.validity import AbstractValidity as AbstractValidity
from jaxnarx.models.validity import AdditiveGates as AdditiveGates
from jaxnarx.models.validity import Boxes as Boxes
from jaxnarx.models.validity import Compact as Compact
from jaxnarx.models.validity import GateProducts as GateProducts
from jaxnarx.models.validity import Gaussians as Gaussians
from jaxnarx.models.validity import LogSigmoids as LogSigmoids
from jaxnarx.models.validity import SigmoidTree as SigmoidTree
from jaxnarx.models.validity import count_models as count_models
from jaxnarx.models.validity import register_validity as register_validity
from jaxnarx.models.validity import tied_outputs as tied_outputs
from jaxnarx.models.validity import weights_of as weights_of
from jaxnarx.models.validity.gaussians import LEAST_LOG_WIDTH as LEAST_LOG_WIDTH
from jaxnarx.models.validity.sigmoid_tree import LARGEST_ARGUMENT as LARGEST_ARGUMENT

__all__ = [
    "AbstractValidity",
    "AdditiveGates",
    "Boxes",
    "Compact",
    "Domain",
    "ErrorModel",
    "LARGEST_INDEX",
    "FLAG",
    "GROWTH_EXPONENT",
    "Gaps",
    "GateProducts",
    "Gaussians",
    "HOLD",
    "LAYERS",
    "STORED_PROBABILITIES",
    "LINEAR",
    "LocalModels",
    "LogSigmoids",
    "MISSING",
    "NAN",
    "Network",
    "OUTSIDE",
    "OUTSIDE_WORDS",
    "OutputModel",
    "PRIOR_WEIGHT",
    "SigmoidTree",
    "SignedRoot",
    "StateForm",
    "VALIDITIES",
    "advance",
    "assemble",
    "set_bounds",
    "collapse",
    "collapsed_step",
    "collapses",
    "depth",
    "describe_missing",
    "describe_policies",
    "driving_signals",
    "overshoot_decay",
    "fed_back_variables",
    "fold_slopes",
    "general_step",
    "global_model",
    "group_weights",
    "held_inputs",
    "hidden_names",
    "hidden_start",
    "hold_missing",
    "hold_to_range",
    "largest_sizes",
    "describe_limits",
    "load",
    "load_about",
    "local_models",
    "input_memory",
    "combine_outputs",
    "count_models",
    "drop_outputs",
    "output_model",
    "overshoot",
    "overshoot_rule",
    "places",
    "set_ranges",
    "recursion",
    "register_validity",
    "report_outputs",
    "reported_range",
    "require_consistent",
    "respond",
    "run_record",
    "run_states",
    "save",
    "scaled_points",
    "scales",
    "scheduling_values",
    "set_nan_policy",
    "sources",
    "split_outputs",
    "state_space",
    "term_values",
    "total",
    "trusted_samples",
    "weights_at",
    "weights_of",
    "widen",
    "with_hidden_start",
    "with_history",
    "with_own",
    "within_margin",
]
"""Names for users; other rooms may import every name above."""

if not TYPE_CHECKING:

    def __getattr__(name):
        return _find_old(__name__, name, {"fed_back": "fed_back_variables"})
