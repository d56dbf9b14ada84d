"""Steps and ramps: given levels, held."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxnarx.data.excitation.require import Number, finite, positive, whole
from jaxnarx.errors import SpecError


def steps(levels: Sequence[Number], *, hold: int) -> Float[Array, " time"]:
    """Each of `levels` in turn, for `hold` samples."""
    return jnp.repeat(jnp.asarray(_finite(levels), float), whole(hold, "hold"))


def ramps(
    levels: Sequence[Number],
    *,
    rate: Number | Sequence[Number],
    hold: int,
    sample_time: Number,
) -> Float[Array, " time"]:
    """Each of `levels` in turn, reached in a straight line and held for `hold` samples.

    `rate` is the slope in units of the input per second, one number, or one for each of
    the ramps; `sample_time` in s. The sample j of a ramp has moved by
    j rate sample_time, the last by what is left; it begins the hold. The length of the
    signal follows from the rates. A slow ramp shows a steady-state characteristic in
    one sweep, for quasi-stationary measurement.
    """
    values = _finite(levels)
    hold = whole(hold, "hold")
    slopes = [rate] * (len(values) - 1) if isinstance(rate, int | float) else list(rate)
    if len(slopes) != len(values) - 1:
        raise SpecError(
            f"rate must be one number or one for each of the {len(values) - 1} ramps, "
            f"got {len(slopes)}",
            field="rate",
        )
    each = [positive(r, "rate") * positive(sample_time, "sample_time") for r in slopes]
    pieces = [np.full(hold, values[0])]
    for start, end, slope in zip(values[:-1], values[1:], each, strict=True):
        count = max(int(np.ceil(abs(end - start) / slope * (1 - 1e-12))), 1)
        moved = np.minimum(slope * np.arange(1, count), abs(end - start))
        pieces += [start + np.sign(end - start) * moved, np.full(hold, end)]
    return jnp.asarray(np.concatenate(pieces), float)


def _finite(levels: Sequence[Number]) -> list[float]:
    if not len(levels):
        raise SpecError("levels must hold at least one number", field="levels")
    return [finite(v, "levels") for v in levels]
