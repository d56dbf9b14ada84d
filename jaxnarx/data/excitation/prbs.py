"""The pseudo-random binary sequence of a shift register: two levels, flat spectrum."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxnarx.data.excitation.require import Pair, span, whole
from jaxnarx.errors import SpecError

LARGEST_ORDER = 24


def prbs(
    length: int,
    *,
    amplitude: Pair,
    clock: int = 1,
    order: int | None = None,
    shift: int = 0,
) -> Float[Array, " time"]:
    """Maximum-length binary sequence between the two levels `amplitude`.

    The register of `order` n moves every `clock` samples, so a period has
    clock (2^n - 1) samples; the longest hold is n clocks. Without `order`, the smallest
    whose period is not shorter than `length`. `shift`, in clocks, begins later in the
    sequence: the same sequence shifted by a part of a period is a nearly uncorrelated
    second input. Deterministic.

    With m the middle and a half the distance of the levels, the autocorrelation of
    (x - m) / a over a full period is 1 at multiples of the period and -1 / (2^n - 1) at
    all other multiples of the clock. Power is flat up to about 0.44 / clock cycles per
    sample. Two levels cannot show a nonlinearity: use `aprbs` for that.

    Reference: S. W. Golomb, Shift Register Sequences, 1967; L. Ljung, System
    Identification, 2nd edition, 1999, section 13.3.
    """
    from scipy.signal import max_len_seq

    low, high = span(amplitude, "amplitude")
    length, clock = whole(length, "length"), whole(clock, "clock")
    ticks = -(-length // clock)
    order = max(2, ticks.bit_length()) if order is None else whole(order, "order", 2)
    if order > LARGEST_ORDER:
        raise SpecError(
            f"order must be from 2 to {LARGEST_ORDER}, got {order}", field="order"
        )
    shift = whole(shift, "shift", 0) % (2**order - 1)
    bits = max_len_seq(order, length=shift + ticks)[0][shift:]
    return jnp.repeat(jnp.where(bits, high, low).astype(float), clock)[:length]
