"""Measurements: channels, records, files, checks, scaling.

Imported without jax, so that files can be read and checked without waiting for it.
"""

from typing import TYPE_CHECKING, Any

from jaxnarx.data._check import check as check
from jaxnarx.data._check import first_look as first_look
from jaxnarx.data._delays import Delay as Delay
from jaxnarx.data._delays import Delays as Delays
from jaxnarx.data._delays import delays as delays
from jaxnarx.data._dynamics import dynamics as dynamics
from jaxnarx.data._groups import Fold as Fold
from jaxnarx.data._groups import Groups as Groups
from jaxnarx.data._groups import groups as groups
from jaxnarx.data._hold_out import hold_out as hold_out
from jaxnarx.data._join import join as join
from jaxnarx.data._shortened import thin_records as thin_records
from jaxnarx.data._survey import ChannelGuess as ChannelGuess
from jaxnarx.data._survey import Survey as Survey
from jaxnarx.data._survey import measurement_files as measurement_files
from jaxnarx.data._survey import survey as survey
from jaxnarx.data.align_channels import convert_units as convert_units
from jaxnarx.data.align_channels import match_channels as match_channels
from jaxnarx.data.channels import Channel as Channel
from jaxnarx.data.channels import Channels as Channels
from jaxnarx.data.channels import number_channels as number_channels
from jaxnarx.data.compare_records import other_units as other_units
from jaxnarx.data.dataset import Dataset as Dataset
from jaxnarx.data.description import load_toml as load_toml
from jaxnarx.data.digest import data_hash as data_hash
from jaxnarx.data.digest import fingerprint as fingerprint
from jaxnarx.data.files import Split as Split
from jaxnarx.data.files import read as read
from jaxnarx.data.files import read_files as read_files
from jaxnarx.data.files import read_split as read_split
from jaxnarx.data.findings import Finding as Finding
from jaxnarx.data.findings import Findings as Findings
from jaxnarx.data.fleet import FLEET_PARTS as FLEET_PARTS
from jaxnarx.data.fleet import Fleet as Fleet
from jaxnarx.data.fleet import Padded as Padded
from jaxnarx.data.lags import LagSuggestion as LagSuggestion
from jaxnarx.data.lags import bank_times as bank_times
from jaxnarx.data.lags import step_times as step_times
from jaxnarx.data.lags import suggest_lags as suggest_lags
from jaxnarx.data.levels import input_levels as input_levels
from jaxnarx.data.missing import hold as hold
from jaxnarx.data.pieces import usual_length as usual_length
from jaxnarx.data.preparation import AbstractStep as AbstractStep
from jaxnarx.data.preparation import Changes as Changes
from jaxnarx.data.preparation import Decimate as Decimate
from jaxnarx.data.preparation import Detrend as Detrend
from jaxnarx.data.preparation import Hampel as Hampel
from jaxnarx.data.preparation import LowPass as LowPass
from jaxnarx.data.preparation import Preparation as Preparation
from jaxnarx.data.preparation import RemoveOffset as RemoveOffset
from jaxnarx.data.preparation import Resample as Resample
from jaxnarx.data.preparation import Scale as Scale
from jaxnarx.data.preparation import Shift as Shift
from jaxnarx.data.preparation import ToCrankAngle as ToCrankAngle
from jaxnarx.data.preparation import ToTime as ToTime
from jaxnarx.data.preparation import prepare as prepare
from jaxnarx.data.readers import FILE_WATCHER as FILE_WATCHER
from jaxnarx.data.readers import KINDS as KINDS
from jaxnarx.data.readers import Asked as Asked
from jaxnarx.data.readers import contents as contents
from jaxnarx.data.readers import read_table as read_table
from jaxnarx.data.readers.columns import numbers as numbers
from jaxnarx.data.record import Record as Record
from jaxnarx.data.runs import Run as Run
from jaxnarx.data.scaling import gains as gains
from jaxnarx.data.scaling import scaling_unit as scaling_unit
from jaxnarx.data.units import LEVEL_QUANTITIES as LEVEL_QUANTITIES
from jaxnarx.data.units import base_unit as base_unit
from jaxnarx.data.units import dimension as dimension
from jaxnarx.data.units import sum_over_time as sum_over_time
from jaxnarx.deprecation import find_old as _find_old

if TYPE_CHECKING:
    from jaxnarx.data.batch import Batch as Batch
    from jaxnarx.data.batch import check_precision as check_precision
    from jaxnarx.data.batch import stack_records as stack_records

__all__ = [
    "Changes",
    "Channel",
    "Channels",
    "Dataset",
    "Decimate",
    "Delay",
    "Delays",
    "Detrend",
    "Finding",
    "Findings",
    "Fleet",
    "Fold",
    "Groups",
    "Hampel",
    "LagSuggestion",
    "LowPass",
    "FLEET_PARTS",
    "Padded",
    "Preparation",
    "Record",
    "RemoveOffset",
    "Resample",
    "Scale",
    "Shift",
    "Split",
    "ToCrankAngle",
    "ToTime",
    "check",
    "delays",
    "data_hash",
    "fingerprint",
    "first_look",
    "groups",
    "hold",
    "hold_out",
    "convert_units",
    "join",
    "load_toml",
    "match_channels",
    "other_units",
    "prepare",
    "read",
    "read_files",
    "read_split",
    "thin_records",
    "step_times",
    "suggest_lags",
]
"""Names for users; other rooms may import every name above."""

_ON_ARRAYS = ("Batch", "check_precision", "stack_records")
"""Names that are loaded on first use, because they need jax."""


_OLD_NAMES = {"in_units": "convert_units", "shortened": "thin_records"}
"""Names of version 0.2 by those that have taken their place."""


def __getattr__(name: str) -> Any:
    if name not in _ON_ARRAYS:
        return _find_old(__name__, name, _OLD_NAMES)
    from jaxnarx.data import batch

    return getattr(batch, name)
