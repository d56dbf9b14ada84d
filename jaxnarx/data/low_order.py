"""Linear systems of low order with dead time: simulated, and fitted by a grid.

A *filter* has up to three poles and a static gain of one: `"lags"` of `t1, ...` is a
cascade of first-order lags of so many samples (0 passes its input on), `("swing",
period, damping)` a second-order system. A *system* is one filter, or two in parallel.
Filters begin at rest, at their first input.
"""

import dataclasses
import itertools
from collections.abc import Iterable, Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float


class Filter(NamedTuple):
    """`kind` and its numbers."""

    kind: Literal["lags", "swing"]
    values: tuple[float, ...]


System = tuple[Filter, ...]

NEARLY_BEST_SHARE = 0.95
"""Share of what the best dead time explains that others explain nearly as well."""
_DAMPING_RATIOS = (0.2, 0.4, 0.7)
_ZOOM_FACTORS = tuple(2.0 ** (k / 6) for k in (-2, -1, 0, 1, 2))


def filter_signal(
    u: Float[np.ndarray, " time"], by: Filter
) -> Float[np.ndarray, " time"]:
    """One signal through one filter."""
    from scipy.signal import lfilter

    if by.kind == "swing":
        period, damping = by.values
        angle = 2 * np.pi / period
        pole = np.exp(angle * (-damping + 1j * np.sqrt(1 - damping**2)))
        a1, a2 = -2 * pole.real, abs(pole) ** 2
        gain = 1 + a1 + a2
        rest = np.array([(1 - gain), -a2]) * u[0]
        return np.asarray(lfilter([gain], [1, a1, a2], u, zi=rest)[0])
    for time in by.values:
        if time > 0:
            a = np.exp(-1 / time)
            u = np.asarray(lfilter([1 - a], [1, -a], u, zi=a * u[:1])[0])
    return u


@dataclasses.dataclass(frozen=True)
class LowOrderFit:
    """A system, its dead time [samples] and its gains.

    `score` is Akaike's criterion up to a constant: the less the better. Dead times
    between the two of `range`, both included, explain nearly as much
    (`NEARLY_BEST_SHARE`).
    """

    system: System
    dead_time: int
    gains: tuple[float, ...]
    score: float
    range: tuple[int, int]

    @property
    def slowest(self) -> float:
        """The longest time constant [samples]."""
        return max(_decay(f) for f in self.system)

    def impulse(self) -> Float[np.ndarray, " lags"]:
        """The answer to a unit impulse, from lag 0 until it has died away."""
        unit = np.zeros(int(20 * self.slowest) + 10)
        unit[1] = 1.0  # filters are at rest at their first input
        answer = sum(
            g * filter_signal(unit, f)
            for g, f in zip(self.gains, self.system, strict=True)
        )
        return np.concatenate([np.zeros(self.dead_time), np.asarray(answer)[1:]])

    def answer(self, u: Float[np.ndarray, " time"]) -> Float[np.ndarray, " time"]:
        """The contribution of `u` to the output; before its beginning `u` was at
        rest."""
        late = np.concatenate([np.full(self.dead_time, u[0]), u])[: len(u)]
        parts = zip(self.gains, self.system, strict=True)
        return np.asarray(sum(g * filter_signal(late, f) for g, f in parts))


def _decay(by: Filter) -> float:
    """The longest time constant [samples]."""
    if by.kind == "lags":
        return max(by.values)
    period, damping = by.values
    return period / (2 * np.pi * damping)


def first_order(times: Iterable[float]) -> list[System]:
    """Single lags."""
    return [_lags(t) for t in times]


def second_order(times: Sequence[float], about: Iterable[float]) -> list[System]:
    """Systems worth comparing with lags of about `about` samples.

    Cascades of two lags and of three equal ones, two lags in parallel (a quick and a
    slow part, or a lead), and swings; `times` is a grid in steps of the root of two.
    """
    found: dict[System, None] = dict.fromkeys(first_order(times))
    for middle in about:
        near = [t for t in times if 0 < t and middle / 6 <= t <= 2.1 * middle + 2]
        found |= dict.fromkeys(
            [
                *first_order(middle * 2 ** (k / 6) for k in range(-6, 7)),
                *(_lags(a, b) for a in near for b in near if a <= b),
                *(_lags(t, t, t) for t in near),
            ]
        )
    swings = [t * 6 for t in times if 1 <= t <= times[-1] / 3]
    found |= dict.fromkeys(_swing(p, d) for p in swings for d in _DAMPING_RATIOS)
    parallel = itertools.combinations(times[::2], 2)
    found |= dict.fromkeys((*_lags(a), *_lags(b)) for a, b in parallel)
    return list(found)


def nearby(system: System) -> list[System]:
    """The system on a finer grid about itself; two in parallel stay as they are."""
    if len(system) > 1:
        return [system]
    kind, values = next(iter(system))
    if kind == "swing":
        period, damping = values
        each = itertools.product(_ZOOM_FACTORS, _ZOOM_FACTORS)
        return [_swing(period * a, min(damping * b, 0.95)) for a, b in each]
    if len(values) == 2:
        each = itertools.product(_ZOOM_FACTORS, _ZOOM_FACTORS)
        return [_lags(values[0] * a, values[1] * b) for a, b in each]
    return [_lags(*(v * a for v in values)) for a in _ZOOM_FACTORS]


def _lags(*times: float) -> System:
    return (Filter("lags", times),)


def _swing(period: float, damping: float) -> System:
    return (Filter("swing", (period, damping)),)


def _parameters(system: System) -> int:
    """Gains, poles; the dead time is common to all. Three equal poles count as two."""
    return sum(1 + min(len(f.values), 2) for f in system)


def fit_systems(
    systems: Sequence[System],
    inputs: Sequence[Float[np.ndarray, "_"]],
    outputs: Sequence[Float[np.ndarray, "outputs _"]],
    reach: int,
) -> list[LowOrderFit]:
    """The best of `systems` with the best dead time up to `reach`, for every output.

    `inputs` and `outputs` hold a signal each for every piece of the data. Free runs are
    compared: for every system and dead time the gains are those of least squares. Only
    rows from `reach` on count, without their mean in each piece, so that all dead times
    are judged by the same rows, and no offset matters.
    """
    filters = list(dict.fromkeys(f for s in systems for f in s))
    at = {f: i for i, f in enumerate(filters)}
    pairs = [(at[s[0]], at[s[-1]]) for s in systems]
    power, both, cross, total, rows = _moments(filters, pairs, inputs, outputs, reach)
    first, second = np.array(pairs).T
    # a second filter that is the first again, or all but that, brings nothing
    a, b = power[first], power[second]
    alone = (first == second)[:, None]
    det = np.where(alone, 1.0, a * b - both**2)
    bad = ~alone & (det <= 1e-8 * a * b)
    det = np.where(bad, 1.0, det)
    cost = 2.0 * np.array([_parameters(s) for s in systems])[:, None]
    a = np.maximum(a, 1e-9 * max(float(power.max()), 1e-300))
    fits = []
    for c, size in zip(cross, total, strict=True):
        ca, cb = c[first], c[second]
        g1 = np.where(alone, ca / a, (ca * b - cb * both) / det)
        g2 = np.where(alone, 0.0, (cb * a - ca * both) / det)
        left = 1 - (g1 * ca + g2 * cb) / max(size, 1e-300)
        score = rows * np.log(np.clip(left, 1e-12, 1.0)) + cost
        score = np.where(bad, np.inf, score)
        s, d = divmod(int(np.argmin(score)), score.shape[1])
        gains = (float(g1[s, d]), float(g2[s, d]))[: len(systems[s])]
        explained = np.where(bad, 0.0, 1 - left).max(axis=0)
        near = np.flatnonzero(explained >= NEARLY_BEST_SHARE * explained[d])
        ends = (int(min(near[0], d)), int(max(near[-1], d))) if near.size else (d, d)
        fits.append(LowOrderFit(systems[s], d, gains, float(score[s, d]), ends))
    return fits


def _moments(filters, pairs, inputs, outputs, reach):
    """Sums over rows: filtered inputs among each other and with outputs, by delay."""
    from scipy.fft import irfft, next_fast_len, rfft

    delays = reach + 1
    power = np.zeros((len(filters), delays))
    both = np.zeros((len(pairs), delays))
    cross = np.zeros((len(outputs[0]), len(filters), delays))
    total, rows = np.zeros(len(outputs[0])), 0
    for u, y in zip(inputs, outputs, strict=True):
        x = np.stack([filter_signal(u, f) for f in filters])
        late = y[:, reach:] - y[:, reach:].mean(axis=1, keepdims=True)
        count = late.shape[1]
        size = next_fast_len(y.shape[1], real=True)
        # rows before `reach` are zero, so that nothing wraps around
        spectrum = np.asarray(
            rfft(np.concatenate([0 * y[:, :reach], late], axis=1), size)
        )
        of_x = np.conj(np.asarray(rfft(x, size)))
        for o, line in enumerate(spectrum):
            cross[o] += np.asarray(irfft(of_x * line[None], size))[:, :delays]
        sums = _delayed_sums(x, reach)
        power += _delayed_sums(x**2, reach) - sums**2 / count
        for p, (i, j) in enumerate(pairs):
            if i != j:
                both[p] += _delayed_sums(x[i] * x[j], reach) - sums[i] * sums[j] / count
        total += np.sum(late**2, axis=1)
        rows += count
    return power, both, cross, total, rows


def _delayed_sums(
    x: Float[np.ndarray, "*batch time"], reach: int
) -> Float[np.ndarray, "*batch delays"]:
    """Sum of x(t - d) over t from `reach` on, for d = 0 to `reach`."""
    whole = x[..., reach:].sum(axis=-1, keepdims=True)
    came = np.cumsum(x[..., :reach][..., ::-1], axis=-1)
    left = np.cumsum(x[..., x.shape[-1] - reach :][..., ::-1], axis=-1)
    return np.concatenate([whole, whole + came - left], axis=-1)
