"""Measurements: channels, records, files, checks, scaling.

Imported without jax, so that files can be read and checked without waiting for it.
"""

from jaxnarx.data.channels import Channel, Channels
from jaxnarx.data.check import check
from jaxnarx.data.dataset import Dataset, Record
from jaxnarx.data.files import Split, fingerprint, read, read_files, read_split
from jaxnarx.data.findings import Finding, Findings
from jaxnarx.data.hold_out import hold_out
from jaxnarx.data.lags import LagSuggestion, suggest_lags
from jaxnarx.data.match import match_channels

__all__ = [
    "Channel",
    "Channels",
    "Dataset",
    "Finding",
    "Findings",
    "LagSuggestion",
    "Record",
    "Split",
    "check",
    "fingerprint",
    "hold_out",
    "match_channels",
    "read",
    "read_files",
    "read_split",
    "suggest_lags",
]
