"""Preparation of measurements: fitted on training data, applied to all, kept as JSON.

Offsets, trends, outliers, filters, sample times, crank angle, alignment and scaling,
after chapter 2.1.2 and equations (6.7) and 4.2.3 of the thesis. NumPy and scipy only.
"""

from jaxnarx.data.preparation.cleaning import Hampel as Hampel
from jaxnarx.data.preparation.cleaning import LowPass as LowPass
from jaxnarx.data.preparation.cleaning import OutliersMasked as OutliersMasked
from jaxnarx.data.preparation.crank_angle import AtCrankAngle as AtCrankAngle
from jaxnarx.data.preparation.crank_angle import ToCrankAngle as ToCrankAngle
from jaxnarx.data.preparation.crank_angle import ToTime as ToTime
from jaxnarx.data.preparation.levels import Detrend as Detrend
from jaxnarx.data.preparation.levels import OffsetRemoved as OffsetRemoved
from jaxnarx.data.preparation.levels import RemoveOffset as RemoveOffset
from jaxnarx.data.preparation.levels import Scale as Scale
from jaxnarx.data.preparation.levels import Scaled as Scaled
from jaxnarx.data.preparation.pipeline import Change as Change
from jaxnarx.data.preparation.pipeline import Changes as Changes
from jaxnarx.data.preparation.pipeline import Preparation as Preparation
from jaxnarx.data.preparation.pipeline import prepare as prepare
from jaxnarx.data.preparation.resample import Decimate as Decimate
from jaxnarx.data.preparation.resample import Resample as Resample
from jaxnarx.data.preparation.resample import Shift as Shift
from jaxnarx.data.preparation.step import AbstractFitted as AbstractFitted
from jaxnarx.data.preparation.step import AbstractStep as AbstractStep
