"""The New European Driving Cycle: four urban phases and one outside towns."""

from collections.abc import Sequence
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxnarx.data.excitation.require import Number, member, positive

Phase = Literal["urban", "extra-urban"]

_CORNERS = {
    "urban": (
        *((0, 0), (11, 0), (15, 15), (23, 15), (25, 10), (28, 0), (49, 0), (54, 15)),
        *((56, 15), (61, 32), (85, 32), (93, 10), (96, 0), (117, 0), (122, 15)),
        *((124, 15), (133, 35), (135, 35), (143, 50), (155, 50), (163, 35), (176, 35)),
        *((178, 32), (185, 10), (188, 0), (195, 0)),
    ),
    "extra-urban": (
        *((0, 0), (20, 0), (25, 15), (27, 15), (36, 35), (38, 35), (46, 50), (48, 50)),
        *((61, 70), (111, 70), (119, 50), (188, 50), (201, 70), (251, 70), (286, 100)),
        *((316, 100), (336, 120), (346, 120), (362, 80), (370, 50), (380, 0), (400, 0)),
    ),
}
"""Time [s] and speed [km/h] between which the speed is a straight line."""
WHOLE: tuple[Phase, ...] = ("urban", "urban", "urban", "urban", "extra-urban")


def driving_cycle(
    *,
    sample_time: Number,
    phases: Sequence[Phase] = WHOLE,
) -> Float[Array, " time"]:
    """Vehicle speed in km/h at 0, sample_time [s], ... over `phases` in turn.

    Without `phases` the whole cycle: four times the urban phase of 195 s (ECE 15, about
    1 km each) and the extra-urban one of 400 s (EUDC, about 7 km, up to 120 km/h), 1180
    s together. The last sample is at its end or less than `sample_time` before.

    Reference: UN/ECE Regulation No. 83, annex 4a, tables 1 and 2; gears are left out.
    """
    step = positive(sample_time, "sample_time")
    times, speeds, end = [0.0], [0.0], 0.0
    for phase in phases:
        corners = np.array(_CORNERS[member(phase, _CORNERS, "phases")], float)
        times += (end + corners[1:, 0]).tolist()
        speeds += corners[1:, 1].tolist()
        end = times[-1]
    count = int(end / step * (1 + 1e-12)) + 1
    return jnp.asarray(np.interp(np.arange(count) * step, times, speeds), float)
