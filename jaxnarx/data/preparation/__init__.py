"""Preparation of measurements: fitted on training data, applied to all, kept as JSON.

Offsets, trends, outliers, filters, sample times, crank angle, alignment and scaling,
after chapter 2.1.2 and equations (6.7) and 4.2.3 of the thesis. NumPy and scipy only.
"""

from jaxnarx.data.preparation.changes import Change, Changes
from jaxnarx.data.preparation.crank_angle import AtCrankAngle, ToCrankAngle, ToTime
from jaxnarx.data.preparation.filters import LowPass
from jaxnarx.data.preparation.offset import OffsetRemoved, RemoveOffset
from jaxnarx.data.preparation.outliers import Hampel, OutliersMasked
from jaxnarx.data.preparation.pipeline import Preparation, prepare
from jaxnarx.data.preparation.resample import Decimate, Resample
from jaxnarx.data.preparation.scale import Scale, Scaled
from jaxnarx.data.preparation.shift import Shift
from jaxnarx.data.preparation.step import AbstractFitted, AbstractStep
from jaxnarx.data.preparation.trend import Detrend

__all__ = [
    "AbstractFitted",
    "AbstractStep",
    "AtCrankAngle",
    "Change",
    "Changes",
    "Decimate",
    "Detrend",
    "Hampel",
    "LowPass",
    "OffsetRemoved",
    "OutliersMasked",
    "Preparation",
    "RemoveOffset",
    "Resample",
    "Scale",
    "Scaled",
    "Shift",
    "ToCrankAngle",
    "ToTime",
    "prepare",
]
