"""Preparation of measurements: fitted on training data, applied to all, kept as JSON.

Offsets, trends, outliers, filters, sample times, crank angle, alignment and scaling,
after chapter 2.1.2 and equations (6.7) and 4.2.3 of the thesis. NumPy and scipy only.
"""

from jaxnarx.data.preparation.cleaning import Hampel, LowPass, OutliersMasked
from jaxnarx.data.preparation.crank_angle import AtCrankAngle, ToCrankAngle, ToTime
from jaxnarx.data.preparation.levels import (
    Detrend,
    OffsetRemoved,
    RemoveOffset,
    Scale,
    Scaled,
)
from jaxnarx.data.preparation.pipeline import Change, Changes, Preparation, prepare
from jaxnarx.data.preparation.resample import Decimate, Resample, Shift
from jaxnarx.data.preparation.step import AbstractFitted, AbstractStep

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
