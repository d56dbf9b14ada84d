"""Measurements: channels, records, files, checks, scaling.

Imported without jax, so that files can be read and checked without waiting for it.
"""

from jaxnarx.data.channels import Channel as Channel
from jaxnarx.data.channels import Channels as Channels
from jaxnarx.data.check import check as check
from jaxnarx.data.check import first_look as first_look
from jaxnarx.data.compare_records import other_units as other_units
from jaxnarx.data.dataset import Dataset as Dataset
from jaxnarx.data.delays import Delay as Delay
from jaxnarx.data.delays import Delays as Delays
from jaxnarx.data.delays import delays as delays
from jaxnarx.data.description import load_toml as load_toml
from jaxnarx.data.files import Split as Split
from jaxnarx.data.files import fingerprint as fingerprint
from jaxnarx.data.files import read as read
from jaxnarx.data.files import read_files as read_files
from jaxnarx.data.files import read_split as read_split
from jaxnarx.data.findings import Finding as Finding
from jaxnarx.data.findings import Findings as Findings
from jaxnarx.data.groups import Fold as Fold
from jaxnarx.data.groups import Groups as Groups
from jaxnarx.data.groups import groups as groups
from jaxnarx.data.hold_out import hold_out as hold_out
from jaxnarx.data.join import join as join
from jaxnarx.data.lags import LagSuggestion as LagSuggestion
from jaxnarx.data.lags import step_times as step_times
from jaxnarx.data.lags import suggest_lags as suggest_lags
from jaxnarx.data.match import in_units as in_units
from jaxnarx.data.match import match_channels as match_channels
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
from jaxnarx.data.record import Record as Record
from jaxnarx.data.shortened import shortened as shortened
