"""Measurements: channels, records, files, checks, scaling.

Imported without jax, so that files can be read and checked without waiting for it.
"""

from jaxnarx.data.channels import Channel, Channels
from jaxnarx.data.check import check
from jaxnarx.data.dataset import Dataset
from jaxnarx.data.delays import Delay, Delays, delays
from jaxnarx.data.description import load_toml
from jaxnarx.data.files import Split, fingerprint, read, read_files, read_split
from jaxnarx.data.findings import Finding, Findings
from jaxnarx.data.hold_out import hold_out
from jaxnarx.data.lags import LagSuggestion, step_times, suggest_lags
from jaxnarx.data.match import match_channels
from jaxnarx.data.preparation import (
    Changes,
    Decimate,
    Detrend,
    Hampel,
    LowPass,
    Preparation,
    RemoveOffset,
    Resample,
    Scale,
    Shift,
    ToCrankAngle,
    ToTime,
    prepare,
)
from jaxnarx.data.record import Record

__all__ = [
    "Channel",
    "Channels",
    "Changes",
    "Dataset",
    "Decimate",
    "Delay",
    "Delays",
    "Detrend",
    "Finding",
    "Findings",
    "Hampel",
    "LagSuggestion",
    "LowPass",
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
    "fingerprint",
    "hold_out",
    "load_toml",
    "match_channels",
    "prepare",
    "read",
    "read_files",
    "read_split",
    "step_times",
    "suggest_lags",
]
