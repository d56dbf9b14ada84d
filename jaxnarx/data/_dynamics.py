"""How outputs answer inputs: dead time, memory, significance, for every pair."""

import dataclasses
import weakref

import numpy as np
from jaxtyping import Float

from jaxnarx.data.dataset import Dataset
from jaxnarx.data.low_order import (
    LowOrderFit,
    first_order,
    fit_systems,
    nearby,
    second_order,
)
from jaxnarx.data.pieces import Piece, pieces, usual_length

_RESPONSE_RIDGE = 1e-6
_LONGEST_RESPONSE = 1024
"""Largest lag of the first, joint response [samples]."""

LONGEST_DEAD_TIME = 500
"""Longest dead time looked for [samples]."""

_CLEAR_DEVIATIONS = 6.0
"""Standard deviations of chance above which an answer is believed.

One of 288 pairs of independent records, random walks among them, exceeded 6; answers
that explain a tenth of the variance of 4,000 rows have 16 and more.
"""

_AVERAGED_FREQUENCIES = 17
"""Frequencies over which the power of the residuals is averaged."""

_LEAST_VARIANCE_SHARE = 1e-3
"""Part of an output's variance that an answer has; less is misfit of the others."""

_STILL_DEVIATIONS = 1e-9
"""Move within a piece, in standard deviations over all, that counts as rounding."""

_LEAST_CYCLES = 3

_COARSENING_FACTOR = 8
"""Factor by which samples are averaged where time constants are long for a piece."""


@dataclasses.dataclass(frozen=True, eq=False)
class Answer:
    """The response of one output to one input, other inputs taken into account.

    `share` is the part of the output's variance, less what other inputs explain, that
    the free run explains; `clear` says whether that is more than chance. The fit counts
    in steps of `every` samples.
    """

    fit: LowOrderFit
    share: float
    clear: bool
    every: int = 1

    @property
    def dead_time(self) -> int | None:
        """Samples before the answer begins; None where none is clear."""
        return self.fit.dead_time * self.every if self.clear else None

    @property
    def dead_times(self) -> tuple[int, int] | None:
        """Least and largest number of samples that explain the output nearly as well;
        None where no answer is clear."""
        low, high = self.fit.range
        return (low * self.every, high * self.every) if self.clear else None

    @property
    def settling(self) -> int | None:
        """Lag by which 95 % of the impulse response, by magnitude, is over, or None."""
        lag = int(np.ceil(self._steps_until(0.95))) * self.every
        return lag if self.clear else None

    @property
    def rise(self) -> float:
        """Samples after the dead time until 63 % of the impulse response is over."""
        steps = self._steps_until(1 - np.exp(-1)) + 1 - self.fit.dead_time
        return max(steps * self.every, 0.5)

    @property
    def correlation(self) -> float:
        """The correlation of the response with the output, less what other inputs
        explain; signed."""
        gain = float(np.sum(self.fit.impulse()))
        return float(np.copysign(np.sqrt(max(self.share, 0.0)), gain))

    def _steps_until(self, share: float) -> float:
        """Steps until a share of the response is over, between steps."""
        part = np.cumsum(np.abs(self.fit.impulse()))
        if not part[-1] > 0:  # no response: nothing to wait for
            return float(self.fit.dead_time)
        part = part / part[-1]
        after = int(np.argmax(part >= share))
        before = part[after - 1] if after else 0.0
        return after - (part[after] - share) / (part[after] - before)


@dataclasses.dataclass(frozen=True, eq=False)
class Dynamics:
    """The answer of every output to every input, by their places.

    None where one of them is constant within every record, or records are too short.
    `reach` is the longest dead time looked for, in samples.
    """

    answers: dict[tuple[int, int], Answer]
    reach: int

    def __getitem__(self, pair: tuple[int, int]) -> Answer | None:
        """The response of (input, output)."""
        return self.answers.get(pair)


_DYNAMICS_CACHE: weakref.WeakKeyDictionary[Dataset, dict[int, Dynamics]]
_DYNAMICS_CACHE = weakref.WeakKeyDictionary()


def dynamics(data: Dataset, *, reach: int = LONGEST_DEAD_TIME) -> Dynamics:
    """Systems of low order with dead time that best explain the outputs in free run.

    Every output is a sum of answers to the inputs and a rest. Each answer is fitted to
    what the others leave, in turn, several times over: first as a lag with dead time,
    then, where that is clear, as a system of second order or three equal lags. All
    times and dead times of a grid are compared by least squares, which asks nothing of
    the input: it may move in rare steps, slowly or periodically, where whitening it
    would leave nothing but noise.

    Whether an answer is more than chance is told by its size over the standard error
    that coloured noise beside a coloured input gives,

        z = sum s^2 / sqrt(sum_k A_s(k) A_e(k)),

    with A the autocorrelations of answer and residuals (as Bartlett 1935), the latter
    smoothed over frequency; or it explains more than half of the variance.

    `reach` is cut to a quarter of the length that nine tenths of the samples have, and
    time constants up to an eighth of the longest record are seen; long data are
    represented by pieces (`pieces`). Results are kept as long as `data` is.

    Björklund 2003, "A survey and comparison of time-delay estimation methods in linear
    systems": fits with an explicit dead time are the most accurate.
    """
    known = _DYNAMICS_CACHE.setdefault(data, {})
    if reach not in known:
        known[reach] = _dynamics(data, reach)
    return known[reach]


def _dynamics(data: Dataset, reach: int, every: int = 1) -> Dynamics:
    parts = pieces(data, every=every)
    longest = max((len(p) for p in parts), default=0)
    usual = usual_length(map(len, parts)) if parts else 0
    reach = max(1, min(reach, usual // 4))
    parts = [p for p in parts if len(p) > 3 * reach]
    if longest < 8:
        return Dynamics({}, reach)
    top = longest / 8
    found = _Fitting(parts, reach, [0.0, *_grid(top)]).run()
    answers = {p: dataclasses.replace(a, every=every) for p, a in found.items()}
    slow = [p for p, a in answers.items() if a.clear and a.fit.slowest > top / 2]
    if slow and max(len(r) for r in data) > _COARSENING_FACTOR * longest * every:
        coarse = _dynamics(data, reach, _COARSENING_FACTOR * every).answers
        answers |= {p: coarse[p] for p in slow if p in coarse and coarse[p].clear}
    return Dynamics(answers, reach)


def _grid(top: float) -> list[float]:
    return [
        0.5 * 2 ** (k / 2) for k in range(int(2 * np.log2(max(top, 1.0) / 0.5)) + 1)
    ]


class _Fitting:
    """The rest of the outputs while responses are fitted in turn."""

    def __init__(self, parts: list[Piece], reach: int, times: list[float]):
        # no level counts: without the pieces' own, small moves keep all their digits
        parts = [Piece(_remove_means(p.u), _remove_means(p.y)) for p in parts]
        self.parts, self.reach, self.times = parts, reach, times
        self.inputs = _moving_channels([p.u for p in parts])
        self.outputs = _moving_channels([p.y for p in parts])
        self.given = joint_response(parts, reach)
        self.left = [
            p.y - g.sum(axis=0) for p, g in zip(parts, self.given, strict=True)
        ]
        self.fits: dict[tuple[int, int], LowOrderFit] = {}
        self.refined: set[tuple[int, int]] = set()

    def run(self) -> dict[tuple[int, int], Answer]:
        if self.inputs and self.outputs:
            first = {i: self._lags(i, self.outputs) for i in self.inputs}
            for i, fits in first.items():
                self._put(i, fits)
            for _ in range(_LEAST_CYCLES if len(self.inputs) > 1 else 1):
                for i in self.inputs:
                    clear = [o for o in self.outputs if self._assess(i, o).clear]
                    faint = [o for o in self.outputs if o not in clear]
                    self._put(i, self._lags(i, faint))
                    self._put(i, self._better(i, clear))
        pairs = ((i, o) for i in self.inputs for o in self.outputs)
        return {p: self._assess(*p) for p in pairs}

    def _lags(self, i: int, outputs: list[int]) -> dict[int, LowOrderFit]:
        """The best lag with dead time for what other inputs leave of some outputs."""
        return self._fit(i, outputs, first_order(self.times))

    def _better(self, i: int, outputs: list[int]) -> dict[int, LowOrderFit]:
        """Systems of higher order; those next to the best of before when it was one."""
        new = [o for o in outputs if (i, o) not in self.refined]
        about = [self.fits[i, o].slowest for o in new]
        found = {o: self.fits[i, o] for o in outputs}
        found |= self._fit(i, new, second_order(self.times, about))
        self.refined |= {(i, o) for o in new}
        for o in outputs:
            wide = found[o].range  # of many systems; next come those about one
            found |= self._fit(i, [o], nearby(found[o].system))
            ends = (min(wide[0], found[o].range[0]), max(wide[1], found[o].range[1]))
            found[o] = dataclasses.replace(found[o], range=ends)
        return found

    def _fit(self, i: int, outputs: list[int], systems) -> dict[int, LowOrderFit]:
        if not outputs or not systems:
            return {}
        inputs = [p.u[i] for p in self.parts]
        targets = [
            (e + g[i])[outputs] for e, g in zip(self.left, self.given, strict=True)
        ]
        found = fit_systems(systems, inputs, targets, self.reach)
        return dict(zip(outputs, found, strict=True))

    def _put(self, i: int, fits: dict[int, LowOrderFit]) -> None:
        for o, fit in fits.items():
            self.fits[i, o] = fit
            for part, left, given in zip(
                self.parts, self.left, self.given, strict=True
            ):
                answer = fit.answer(part.u[i])
                left[o] += given[i, o] - answer
                given[i, o] = answer

    def _assess(self, i: int, o: int) -> Answer:
        explained = left = chance = whole = 0.0
        for part, residual, given in zip(
            self.parts, self.left, self.given, strict=True
        ):
            s, e, y = (
                x[self.reach :] - x[self.reach :].mean()
                for x in (given[i, o], residual[o], part.y[o])
            )
            explained += float(s @ s)
            left += float(e @ e)
            whole += float(y @ y)
            chance += _chance(s, e)
        clear = (
            explained > _CLEAR_DEVIATIONS * np.sqrt(chance) or explained > 0.5 * whole
        )
        share = explained / (explained + left) if explained else 0.0
        return Answer(
            self.fits[i, o],
            share,
            bool(clear and explained > _LEAST_VARIANCE_SHARE * whole),
        )


def _remove_means(x: Float[np.ndarray, "channels time"]):
    return x - x.mean(axis=1, keepdims=True)


def _moving_channels(channels: list[Float[np.ndarray, "channels _"]]) -> list[int]:
    """Channels that move within a piece: differences between pieces have no
    dynamics."""
    moves = np.max([np.abs(c).max(axis=1) for c in channels], axis=0)
    return np.flatnonzero(moves > _STILL_DEVIATIONS).tolist()


def _chance(s: Float[np.ndarray, " time"], e: Float[np.ndarray, " time"]) -> float:
    """Variance of sum s e were they independent: sum over lags of A_s A_e / rows."""
    from scipy.fft import next_fast_len, rfft
    from scipy.ndimage import uniform_filter1d

    size = int(next_fast_len(2 * len(s), real=True) or 0)
    power = [np.abs(np.asarray(rfft(x, size))) ** 2 for x in (s, e)]
    smooth = uniform_filter1d(power[1], _AVERAGED_FREQUENCIES, mode="mirror")
    return float(2 * np.sum(power[0] * smooth) / size / len(s))


def joint_response(
    parts: list[Piece], reach: int
) -> list[Float[np.ndarray, "inputs outputs _"]]:
    """The contribution of each input to each output, for every piece.

    One least-squares problem for all inputs, so that what correlated inputs have in
    common is divided among them: impulse responses that are constant between the lags
    0, 1, 2, 3, 4, 6, 8, 11, 16, ... Only rows from `reach` on count, without their mean
    in each piece. Zeros where there are fewer than ten rows for a coefficient.
    """
    edges = _edges(min(max(len(p) for p in parts) // 4, _LONGEST_RESPONSE))
    inputs, bins = len(parts[0].u), len(edges) - 1
    rows = sum(len(p) - reach for p in parts)
    if not inputs or rows < 10 * inputs * bins:
        return [np.zeros((inputs, *p.y.shape)) for p in parts]
    gram = np.zeros((inputs * bins,) * 2)
    cross = np.zeros((inputs * bins, len(parts[0].y)))
    for part in parts:
        x = _bin_lags(part.u, edges).reshape(inputs * bins, -1)[:, reach:]
        x = x - x.mean(axis=1, keepdims=True)
        gram += x @ x.T
        cross += x @ part.y[:, reach:].T
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    alive = np.diag(gram) > 1e-9 * rows
    scale = np.where(alive, 1 / scale, 0.0)
    gram = gram * scale[:, None] * scale[None] + _RESPONSE_RIDGE * np.eye(len(gram))
    theta = scale[:, None] * np.linalg.solve(gram, scale[:, None] * cross)
    theta = theta.reshape(inputs, bins, -1)
    return [np.einsum("ibo,ibt->iot", theta, _bin_lags(p.u, edges)) for p in parts]


def _edges(longest: int) -> list[int]:
    steps = (round(2 ** (k / 2)) for k in range(2, 2 * longest.bit_length()))
    return [0, 1, *dict.fromkeys(s for s in steps if s <= max(longest, 2))]


def _bin_lags(
    u: Float[np.ndarray, "inputs time"], edges: list[int]
) -> Float[np.ndarray, "inputs bins time"]:
    """Means over spans of lags; before its beginning every input was at rest."""
    longest, n = edges[-1], u.shape[1]
    begin = np.repeat(u[:, :1], longest, axis=1)
    total = np.cumsum(np.concatenate([0 * u[:, :1], begin, u], axis=1), axis=1)
    spans = zip(edges[:-1], edges[1:], strict=True)
    means = [
        (total[:, longest - a + 1 :][:, :n] - total[:, longest - b + 1 :][:, :n])
        / (b - a)
        for a, b in spans
    ]
    return np.stack(means, axis=1)
