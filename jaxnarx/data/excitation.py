"""Excitation signals: what to feed an engine so that its records tell something.

Every signal takes `key` first if it is random, then its length in samples, and returns
one input over time; several inputs are stacked with `jnp.stack(..., axis=-1)`.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxnarx.errors import SpecError


def aprbs(
    key: PRNGKeyArray,
    length: int,
    *,
    hold: tuple[int, int],
    amplitude: tuple[float, float],
) -> Float[Array, " time"]:
    """Amplitude-modulated pseudo-random binary sequence.

    A staircase whose hold times are uniform over the whole numbers `hold[0]` to
    `hold[1]`, both included, in samples, and whose levels are uniform over
    `amplitude`, in the unit of the input. The last hold may be cut short by the end.

    Long holds show gains, short ones dynamics, and the levels visit the whole range,
    which a binary sequence does not; nonlinear identification needs all three.

    Reference: O. Nelles, Nonlinear System Identification, Springer 2001, section 17.7.
    """
    shortest, longest = hold
    low, high = amplitude
    _require_length(length)
    if not 1 <= shortest <= longest:
        raise SpecError(
            f"hold must be (shortest, longest) in samples with 1 <= shortest <= "
            f"longest, got {hold}",
            field="hold",
        )
    if not low <= high:
        raise SpecError(
            f"amplitude must be (low, high) with low <= high, got {amplitude}",
            field="amplitude",
        )
    most = -(-length // shortest)
    time_key, level_key = jax.random.split(key)
    holds = jax.random.randint(time_key, (most,), shortest, longest + 1)
    level = jax.random.uniform(level_key, (most,), float, low, high)
    segment = jnp.searchsorted(jnp.cumsum(holds), jnp.arange(length), side="right")
    return level[segment]


def steps(levels: Sequence[float], *, hold: int) -> Float[Array, " time"]:
    """Each of `levels` in turn, for `hold` samples."""
    if hold < 1:
        raise SpecError(f"hold must be at least one sample, got {hold}", field="hold")
    return jnp.repeat(jnp.asarray(levels, float), hold)


def _require_length(length: int) -> None:
    if length < 1:
        raise SpecError(
            f"length must be at least one sample, got {length}", field="length"
        )
