"""Several effects in one model of piecewise constants (5.28), by least squares."""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int, UInt8

from jaxnarx.selection.anova.cells import (
    Effect,
    FTest,
    contrasts,
    eliminate,
    judge,
    products,
)

CHUNK_ROWS = 8192
"""Rows formed at a time."""

Codes = dict[int, UInt8[np.ndarray, " rows"]]
"""Level of every sample, by variable."""


def _blocks(
    codes: Codes, levels: dict[int, int], effects: Sequence[Effect]
) -> Iterator[tuple[slice, Float[np.ndarray, "columns chunk"]]]:
    """Columns of the constant and these effects, a chunk of rows at a time.

    float32, for all are -1, 0 or 1, and sums over a chunk are whole and hence exact.
    """
    table = {v: contrasts(n).T.astype(np.float32) for v, n in levels.items()}
    used = {v for effect in effects for v in effect}
    rows = len(next(iter(codes.values())))
    for start in range(0, rows, CHUNK_ROWS):
        part = slice(start, min(start + CHUNK_ROWS, rows))
        main = {v: np.take(table[v], codes[v][part], axis=1) for v in used}
        parts = [np.ones((1, part.stop - start), np.float32)]
        parts += [products([main[v] for v in effect]) for effect in effects]
        yield part, np.vstack(parts)


def sizes(effects: Sequence[Effect], levels: dict[int, int]) -> list[int]:
    """Columns of each effect: the product of its variables' levels, less one each."""
    return [math.prod(levels[v] - 1 for v in e) for e in effects]


def moments(
    codes: Codes,
    levels: dict[int, int],
    effects: Sequence[Effect],
    y: Float[np.ndarray, " rows"],
) -> tuple[Float[np.ndarray, "columns columns"], Float[np.ndarray, " columns"]]:
    """X'X and X'y of the constant and these effects.

    Normal equations lose nothing here: the entries of X'X are whole numbers, formed
    exactly.
    """
    columns = 1 + sum(sizes(effects, levels))
    gram, moment = np.zeros((columns, columns)), np.zeros(columns)
    for part, x in _blocks(codes, levels, effects):
        gram += x @ x.T
        moment += x.astype(np.float64) @ y[part]
    return gram, moment


def cross_moments(
    codes: Codes,
    levels: dict[int, int],
    y: Float[np.ndarray, " rows"],
    mains: Sequence[Effect],
    batch: Sequence[Effect],
) -> tuple[
    Float[np.ndarray, "mains columns"],
    Float[np.ndarray, "columns columns"],
    Float[np.ndarray, " columns"],
]:
    """X'Z, Z'Z and Z'y of main effects X and a batch of interactions Z."""
    width, columns = 1 + sum(sizes(mains, levels)), sum(sizes(batch, levels))
    cross, square = np.zeros((width, columns)), np.zeros((columns, columns))
    product = np.zeros(columns)
    for part, x in _blocks(codes, levels, [*mains, *batch]):
        main, z = x[:width], x[width:]
        cross += main @ z.T
        square += z @ z.T
        product += z.astype(np.float64) @ y[part]
    return cross, square, product


class Model(NamedTuple):
    """A least-squares model of effects, and what its parts are worth.

    A column that empty cells make a combination of earlier ones is left out: an effect
    has the degrees of freedom that earlier effects leave it. `owner` is the position of
    the effect a column belongs to, -1 for the constant; `error` is the residual sum of
    squares, `spare` its degrees of freedom.
    """

    effects: tuple[Effect, ...]
    owner: Int[np.ndarray, " columns"]
    theta: Float[np.ndarray, " columns"]
    gram: Float[np.ndarray, "columns columns"]
    inverse: Float[np.ndarray, "columns columns"]
    moment: Float[np.ndarray, " columns"]
    place: Int[np.ndarray, " columns"]
    total: float
    error: float
    spare: int

    def test(self, position: int) -> FTest:
        """Partial F test: the squares lost without the effect, theta' V^-1 theta.

        V is the effect's block of (X'X)^-1.
        """
        at = np.flatnonzero(self.owner == position)
        part = self.theta[at]
        squares = float(part @ np.linalg.solve(self.inverse[np.ix_(at, at)], part))
        f, p = judge(squares, len(at), self.error, self.spare, self.total)
        return FTest(
            self.effects[position],
            (),
            len(at),
            self.spare,
            squares,
            self.total,
            f,
            p,
            False,
        )


def fit(
    codes: Codes,
    levels: dict[int, int],
    effects: Sequence[Effect],
    y: Float[np.ndarray, " rows"],
) -> Model:
    """Least squares of the constant and these effects; y is centred."""
    gram, moment = moments(codes, levels, effects, y)
    _, own = eliminate(gram, np.diag(gram), len(gram))
    owner = np.repeat(np.arange(-1, len(effects)), [1, *sizes(effects, levels)])[own]
    gram, moment = gram[np.ix_(own, own)], moment[own]
    factor = scipy.linalg.cho_factor(gram, lower=True)
    inverse = scipy.linalg.cho_solve(factor, np.eye(len(own)))
    theta = scipy.linalg.cho_solve(factor, moment)
    total = float(np.sum(y * y))
    # What rounding leaves of a perfect fit must not look like a small error.
    error = max(total - float(theta @ moment), 16 * np.finfo(float).eps * total)
    return Model(
        tuple(effects),
        owner,
        theta,
        gram,
        inverse,
        moment,
        own,
        total,
        error,
        len(y) - len(own),
    )


def residual(
    model: Model, codes: Codes, levels: dict[int, int], y: Float[np.ndarray, " rows"]
) -> Float[np.ndarray, " rows"]:
    """The part of y that the model leaves."""
    left = y.copy()
    for part, x in _blocks(codes, levels, model.effects):
        left[part] -= model.theta @ x[model.place].astype(np.float64)
    return left
