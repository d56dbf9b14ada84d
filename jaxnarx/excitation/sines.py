"""Sums of sines with chosen harmonics and low peaks, and the swept sine."""

from collections.abc import Sequence
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from jaxnarx.checks import Number, Pair, choice, positive, span, whole
from jaxnarx.errors import SpecError


def multisine(
    length: int,
    *,
    harmonics: Sequence[int],
    amplitude: Pair,
    period: int | None = None,
    weights: Sequence[Number] | None = None,
    key: PRNGKeyArray | None = None,
) -> Float[Array, " time"]:
    """Periodic sum of cosines, scaled symmetrically so that its peak meets `amplitude`.

        x(t) = m + g sum_h w_h cos(2 pi h t / period + phase_h)

    with m the middle of `amplitude` = (low, high). `period` in samples is `length`
    unless given; `harmonics` are different whole numbers from 1 to below period / 2;
    harmonic h has the frequency h / (period sample_time) in Hz. `weights` are the
    relative amplitudes, all one unless given. Phases are Schroeder's, which keep the
    peak low,

        phase_k = -2 pi sum_{j<k} (k - j) p_j,  p_j = w_j^2 / sum w^2,

    or, with `key`, random: several inputs need different signals, as one set of
    harmonics split among them or with different keys.

    Over full periods there is no leakage, and harmonics left out show nonlinearity and
    noise apart.

    References: M. R. Schroeder, IEEE Trans. Information Theory 16, 1970; R. Pintelon,
    J. Schoukens, System Identification: A Frequency Domain Approach, 2012, chapter 4.
    """
    low, high = span(amplitude, "amplitude")
    length = whole(length, "length")
    period = length if period is None else whole(period, "period")
    lines = _harmonics(harmonics, period)
    size = _weights(weights, len(lines))
    order = np.argsort(lines)
    lines, size = lines[order], size[order]
    if key is None:
        phase = jnp.asarray(_schroeder(size), float)
    else:
        phase = jax.random.uniform(key, size.shape, float, 0, 2 * np.pi)
    weight = jnp.asarray(size, float)
    spectrum = jax.lax.complex(weight * jnp.cos(phase), weight * jnp.sin(phase))
    bins = jnp.zeros(period // 2 + 1, spectrum.dtype).at[lines].set(spectrum)
    wave = jnp.fft.irfft(bins, period)
    wave = wave / jnp.max(jnp.abs(wave))
    wave = (low + high) / 2 + (high - low) / 2 * wave
    return wave[jnp.arange(length) % period]


def crest_factor(signal: Float[Array, " time"]) -> Float[Array, ""]:
    """Largest distance from the mean over the standard deviation.

    Dimensionless: 1 for a symmetric binary signal, sqrt(2) for a sine; the lower, the
    more power fits into a range. A constant has 1, as a binary signal of no amplitude.
    """
    x = signal - jnp.mean(signal)
    peak, rms = jnp.max(jnp.abs(x)), jnp.sqrt(jnp.mean(x**2))
    return jnp.where(rms > 0, peak / jnp.where(rms > 0, rms, 1.0), 1.0)


def _harmonics(harmonics: Sequence[int], period: int) -> np.ndarray:
    lines = [whole(h, "harmonics") for h in harmonics]
    if not lines or len(set(lines)) < len(lines):
        raise SpecError(
            f"harmonics must be one or more different whole numbers, got {lines}",
            field="harmonics",
        )
    if 2 * max(lines) >= period:
        raise SpecError(
            f"harmonic {max(lines)} of a period of {period} samples is not below the "
            f"Nyquist frequency; the highest possible is {(period - 1) // 2}",
            field="harmonics",
        )
    return np.array(lines)


def _weights(weights: Sequence[Number] | None, count: int) -> np.ndarray:
    if weights is None:
        return np.ones(count)
    if len(weights) != count:
        raise SpecError(
            f"weights must be one number per harmonic, {count}, got {len(weights)}",
            field="weights",
        )
    return np.array([positive(w, "weights") for w in weights])


def _schroeder(size: np.ndarray) -> np.ndarray:
    """Schroeder's phases; the double sum is a cumulative sum taken twice."""
    power = np.cumsum(size**2 / np.sum(size**2))
    return -2 * np.pi * np.concatenate([[0.0], np.cumsum(power)[:-1]])


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
    choice(sweep, ("linear", "logarithmic"), "sweep")
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
