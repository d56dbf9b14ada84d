"""Inverse models: from wanted outputs of a plant to its commands.

An inverse is an ordinary `Network`, identified on a dataset that is read backwards
(`inverse_data`). In front of a forward network it makes a cascade (`cascade`), on whose
tracking error it can be trained (`compensate`). `invertible` and `reachable` say before
what cannot be inverted, `unity_gain` afterwards how near the cascade comes to one.

Reference: thesis section 7.3; B. Widrow, E. Walach, Adaptive Inverse Control, 1996.
"""

from jaxnarx.inverse.cascade import Tracking as Tracking
from jaxnarx.inverse.cascade import cascade as cascade
from jaxnarx.inverse.compensate import compensate as compensate
from jaxnarx.inverse.dataset import inverse_data as inverse_data
from jaxnarx.inverse.forward import dead_times as dead_times
from jaxnarx.inverse.invertible import Invertibility as Invertibility
from jaxnarx.inverse.invertible import invertible as invertible
from jaxnarx.inverse.reachable import Reach as Reach
from jaxnarx.inverse.reachable import reachable as reachable
from jaxnarx.inverse.region import Region as Region
from jaxnarx.inverse.unity import UnityGain as UnityGain
from jaxnarx.inverse.unity import unity_gain as unity_gain
