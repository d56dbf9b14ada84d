"""Inverse models: from wanted outputs of a plant to its commands.

An inverse is an ordinary `Network`, identified on a dataset that is read backwards
(`inverse_data`). In front of a forward network it makes a cascade (`cascade`), on whose
tracking error it can be trained (`compensate`). `invertible` and `reachable` say before
what cannot be inverted, `unity_gain` afterwards how near the cascade comes to one.

Reference: thesis section 7.3; B. Widrow, E. Walach, Adaptive Inverse Control, 1996.
"""

from jaxnarx.docstrings import document
from jaxnarx.inverse._cascade import Tracking, cascade
from jaxnarx.inverse._compensate import compensate
from jaxnarx.inverse._invertible import Invertibility, invertible
from jaxnarx.inverse._reachable import Reach, reachable
from jaxnarx.inverse.dataset import inverse_data
from jaxnarx.inverse.forward import dead_times
from jaxnarx.inverse.region import Region
from jaxnarx.inverse.unity import UnityGain, unity_gain
from jaxnarx.settings import ActuatorLimits, TrackingError

__all__ = [
    "ActuatorLimits",
    "Invertibility",
    "Reach",
    "Region",
    "Tracking",
    "TrackingError",
    "UnityGain",
    "cascade",
    "compensate",
    "dead_times",
    "inverse_data",
    "invertible",
    "reachable",
    "unity_gain",
]

document(ActuatorLimits, TrackingError)
