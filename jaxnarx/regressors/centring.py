"""Centred coordinates for channels far from zero; the terms keep their meaning.

If the offset c of a variable x = c + s z is many times its spread s, a product is
nearly a multiple of its own parts: x_1 x_2 = c_1 c_2 + c_1 s_2 z_2 + c_2 s_1 z_1 + s_1
s_2 z_1 z_2, of which float64 soon keeps the constant alone. In a set of terms P that
holds such a product together with its parts, the parts can be taken off: with monomials
m of z,

    P = T_in m_in + T_out m_out ,    r = T_in^-1 P = m_in + T_in^-1 T_out m_out ,

where `in` are those of the terms themselves. The columns r span what P spans, are
formed from z without cancellation, and coefficients psi of r are theta = T_in^-T psi of
P. A set with all parts of its products, "well formulated", has no m_out: it describes
the same functions whatever the offset. J. L. Peixoto, "A property of well-formulated
polynomial regression models", The American Statistician 44 (1990).
"""

import dataclasses
import itertools
from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.data import Batch, Channels
from jaxnarx.regressors.pool import evaluate
from jaxnarx.regressors.variables import Variables

FAR_DEVIATIONS = 50.0
"""Offset in standard deviations from which a channel is treated as far from zero: from
there on greedy choices take products for their parts."""
LOST_SHARE = 1e-3
"""Share of an output's spread that rounding of its terms may reach."""

CLOSE_ROUNDINGS = 1e5
"""Spread in rounding errors of the offset below which there is nothing to centre."""

Row = tuple[int, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class Centring:
    """v = shift + spread z, for every entry of v = [1, x_1 ... x_V], all scaled.

    Shift 0 and spread 1 where a variable is not far from zero. `target` is taken off
    the outputs, in models that have a constant to give it back.
    """

    shift: Float[np.ndarray, " vars"]
    spread: Float[np.ndarray, " vars"]
    target: Float[np.ndarray, " outputs"]

    @staticmethod
    def from_ranges(
        low: Float[np.ndarray, " signals"],
        high: Float[np.ndarray, " signals"],
        gain: Float[np.ndarray, " signals"],
        variables: Variables,
        *,
        every: bool = False,
    ) -> "Centring | None":
        """Offsets from the signals' ranges alone; a quarter of one stands for the
        spread.

        With `every`, of all variables that change at all and not the far ones alone.
        """
        middle, spread = (low / gain + high / gain) / 2, (high - low) / gain / 4
        far = (spread > 0) if every else is_far(middle, spread)
        if not far[variables.signal].any():
            return None
        shift, size = np.where(far, middle, 0.0), np.where(far, spread, 1.0)
        at = variables.signal
        return Centring(
            np.concatenate([[0.0], shift[at]]),
            np.concatenate([[1.0], size[at]]),
            np.zeros(0),
        )

    def centre(self, v: Float[Array, "vars *rows"]) -> Float[Array, "vars *rows"]:
        """z of v."""
        tail = (-1,) + (1,) * (v.ndim - 1)
        shift, spread = (
            jnp.asarray(a.reshape(tail), v.dtype) for a in (self.shift, self.spread)
        )
        return (v - shift) / spread

    def _monomials(self, row: Row) -> Iterator[tuple[Row, float]]:
        """Monomials of z in a term, with their weights; some come twice."""
        choices = [
            ((i, self.spread[i]), (0, self.shift[i])) if self.shift[i] else ((i, 1.0),)
            for i in row
        ]
        for parts in itertools.product(*choices):
            yield (
                tuple(sorted(i for i, _ in parts)),
                float(np.prod([w for _, w in parts])),
            )

    def reduce(
        self, factor: Int[np.ndarray, "terms degree"]
    ) -> tuple[
        Float[np.ndarray, "terms terms"],
        Int[np.ndarray, "more degree"],
        Float[np.ndarray, "terms more"],
    ]:
        """T_in^-1, the table of m_out, and its weights T_in^-1 T_out; distinct terms.

        Row vectors of coefficients go from r to P by `psi @ T_in^-1`.
        """
        rows = [tuple(sorted(row)) for row in np.asarray(factor).tolist()]
        place = {row: n for n, row in enumerate(rows)}
        outside: dict[Row, int] = {}
        entries = [
            (n, *item) for n, row in enumerate(rows) for item in self._monomials(row)
        ]
        for _, monomial, _ in entries:
            if monomial not in place:
                outside.setdefault(monomial, len(outside))
        inner, outer = (
            np.zeros((len(rows), size)) for size in (len(rows), len(outside))
        )
        for n, monomial, weight in entries:
            if monomial in place:
                inner[n, place[monomial]] += weight
            else:
                outer[n, outside[monomial]] += weight
        order = np.argsort([np.count_nonzero(row) for row in rows], kind="stable")
        both = np.concatenate([np.eye(len(rows)), outer], axis=1)[order]
        both = scipy.linalg.solve_triangular(
            inner[np.ix_(order, order)], both, lower=True
        )
        solved = np.empty_like(both)
        solved[order] = both
        table = np.array(list(outside), np.int32).reshape(-1, factor.shape[1])
        return solved[:, : len(rows)], table, solved[:, len(rows) :]

    def columns(
        self, factor: Int[np.ndarray, "terms degree"], v: Float[Array, "vars rows"]
    ) -> tuple[Float[Array, "terms rows"], Float[np.ndarray, "terms terms"]]:
        """Columns r of the terms at rows `v`, and T_in^-1."""
        back, table, weight = self.reduce(factor)
        z = self.centre(v)
        r = jnp.asarray(evaluate(factor, z))
        if len(table):
            r = r + jnp.asarray(weight, z.dtype) @ evaluate(table, z)
        return r, back

    def parents(
        self,
        factor: Int[np.ndarray, "terms degree"],
        there: Bool[np.ndarray, " terms"],
        given: int | None = None,
    ) -> tuple[Int[np.ndarray, "terms parts"], bool]:
        """Parts of every term among the terms that are `there`, and if none lacks.

        A part is left when far variables are dropped from a product. The number of
        terms stands for no part; `given` is a part that every model has.
        """
        terms, degree = factor.shape
        key = (len(self.shift) ** np.arange(degree, dtype=np.int64))[None]
        rows = np.sort(factor, axis=1).astype(np.int64)
        own = np.sum(rows * key, axis=1)
        order = np.argsort(own)
        found, complete = [], True
        for size in range(1, degree + 1):
            for dropped in itertools.combinations(range(degree), size):
                lower = rows.copy()
                lower[:, dropped] = 0
                wanted = np.sum(np.sort(lower, axis=1) * key, axis=1)
                far = np.all(self.shift[rows[:, dropped]] != 0, axis=1)
                at = order[np.minimum(np.searchsorted(own[order], wanted), terms - 1)]
                hit = (own[at] == wanted) & (there[at] | (at == given))
                complete &= bool(np.all(hit | ~far | ~there))
                found.append(np.where(far & hit & (at != given), at, terms))
        return np.stack(found, axis=1), complete

    def warning(
        self,
        factor: Int[np.ndarray, "terms degree"],
        theta: Float[np.ndarray, "*models terms"],
        size: float,
        channels: Channels,
        variables: Variables,
    ) -> str:
        """The warning of a model whose terms cancel to less than float64 holds, or "".

        `size` is the standard deviation of the output, scaled as the terms' sum is.
        """
        of = np.abs(self.shift) + self.spread
        largest = np.max(np.abs(theta) * np.prod(of[factor], axis=1), initial=0.0)
        kind = np.finfo(theta.dtype)
        share = float(kind.eps * largest / max(size, kind.tiny))
        if share <= LOST_SHARE:
            return ""
        used = np.unique(factor)
        ratio = np.abs(self.shift[used]) / self.spread[used]
        signal, _ = variables.rows[max(int(used[np.argmax(ratio)]) - 1, 0)]
        return (
            f"the mean of {channels.names[signal]} is {ratio.max():.1e} times its "
            f"standard deviation, so that terms cancel and rounding makes {share:.1e} "
            "of the output's; take the offset off before"
        )


def is_far(
    mean: Float[np.ndarray, " signals"], spread: Float[np.ndarray, " signals"]
) -> Bool[np.ndarray, " signals"]:
    """Whether the mean is more than `FAR_DEVIATIONS` spreads from zero, and these
    are no noise."""
    size = np.abs(mean)
    return (size > FAR_DEVIATIONS * spread) & (
        spread > CLOSE_ROUNDINGS * np.finfo(mean.dtype).eps * size
    )


def far_signals(batch: Batch) -> Bool[np.ndarray, " signals"]:
    """Signals that are far from zero over all records."""
    signals = np.asarray(batch.signals)
    x = signals.reshape(-1, signals.shape[-1])
    return is_far(*_moments(x.T, batch.valid.reshape(x.shape).T))


def _moments(x: np.ndarray, counted: np.ndarray):
    """Mean and standard deviation of every row over what counts."""
    count = np.maximum(counted.sum(axis=1), 1)
    mean = np.sum(x, axis=1, where=counted) / count
    away = x - mean[:, None]
    return mean, np.sqrt(np.sum(away**2, axis=1, where=counted) / count)


def find_centring(
    batch: Batch,
    variables: Variables,
    v: Float[Array, "vars rows"],
    y: Float[Array, "outputs rows"],
    weight: Float[Array, "outputs rows"],
) -> Centring | None:
    """Offsets of what is far from zero; None where nothing is.

    `v` and `y` are scaled rows, `v` behind a row of ones.
    """
    rows, targets = np.asarray(v), np.asarray(y)
    far = np.flatnonzero(far_signals(batch)[variables.signal]) + 1
    mean, spread = _moments(targets, np.asarray(weight) > 0)
    target = np.where(is_far(mean, spread), mean, 0.0)
    if not far.size and not target.any():
        return None
    shift, size = np.zeros(len(rows)), np.ones(len(rows))
    mean, spread = rows[far].mean(axis=1), rows[far].std(axis=1)
    # a filter may have taken the offset away, or everything
    own = is_far(mean, spread)
    shift[far[own]], size[far[own]] = mean[own], spread[own]
    return Centring(shift, size, target)
