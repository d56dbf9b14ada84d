"""The swept sine."""

from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxnarx.data.excitation.require import Number, Pair, member, positive, span, whole
from jaxnarx.errors import SpecError

Sweep = Literal["linear", "logarithmic"]


def chirp(
    length: int,
    *,
    frequency: Pair,
    amplitude: Pair,
    sample_time: Number,
    sweep: Sweep = "linear",
) -> Float[Array, " time"]:
    """Sine whose frequency goes from `frequency[0]` to `frequency[1]`, in Hz.

    With m the middle and a half the width of `amplitude`, T the time of the last sample
    and f0, f1 the frequencies,

        x(t) = m + a sin(2 pi c(t)),
        linear:       c = f0 t + (f1 - f0) t^2 / (2 T),
        logarithmic:  c = f0 T (r^(t / T) - 1) / ln r,  r = f1 / f0.

    A linear sweep spends the same time at every frequency, a logarithmic one in every
    octave. Downward sweeps are possible. `sample_time` in s; frequencies are from 0 (a
    logarithmic sweep: above 0) to the Nyquist frequency 1 / (2 sample_time).
    """
    first, last = _frequencies(frequency, positive(sample_time, "sample_time"))
    low, high = span(amplitude, "amplitude")
    length = whole(length, "length")
    member(sweep, ("linear", "logarithmic"), "sweep")
    time = np.arange(length) * sample_time
    end = max(float(time[-1]), sample_time)
    if sweep == "linear" or first == last:
        cycles = first * time + (last - first) * time**2 / (2 * end)
    elif min(first, last) <= 0:
        raise SpecError(
            f"a logarithmic sweep needs frequencies above 0 Hz, got {frequency}",
            field="frequency",
        )
    else:
        log_ratio = np.log(last / first)
        cycles = first * end * np.expm1(log_ratio * time / end) / log_ratio
    wave = (low + high) / 2 + (high - low) / 2 * np.sin(2 * np.pi * cycles)
    return jnp.asarray(wave, float)


def _frequencies(frequency: Pair, sample_time: float) -> tuple[float, float]:
    nyquist = 1 / (2 * sample_time)
    first, last = frequency
    if not all(0 <= f <= nyquist * (1 + 1e-12) for f in (first, last)):
        raise SpecError(
            f"frequencies must be from 0 Hz to the Nyquist frequency {nyquist:g} Hz of "
            f"a sample time of {sample_time:g} s, got {frequency}",
            field="frequency",
        )
    return float(first), float(last)
