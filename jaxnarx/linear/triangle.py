"""One factorisation of all lagged columns, from which every subset is solved.

With [X y] = Q R, least squares of y by any columns of X is the same problem in the
columns of R, which has as many rows as there are columns: 10,000 samples become 31.
The R of a QR factorisation, not the Gram matrix, whose condition is the square of it.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxnarx.arrays import directions
from jaxnarx.arrays import triangle as triangle_of
from jaxnarx.data import Dataset
from jaxnarx.regressors import Variables, regression_rows


@dataclasses.dataclass(frozen=True)
class SubsetFit:
    """Least squares in some of the columns, in physical units.

    `inverse` is (X'X)^-1, by the pseudo-inverse where the rank falls short; it leaves
    out the constant. `condition` is that of the columns scaled to unit norm, `weak` the
    positions of the columns that make up the weakest direction.
    """

    theta: Float[np.ndarray, " columns"]
    sse: float
    inverse: Float[np.ndarray, "columns columns"]
    rank: int
    condition: float
    weak: tuple[int, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class Triangle:
    """R of the columns of unit norm with the target last, and what was taken off.

    `mean` is zero without a constant; with one, the means were subtracted from all
    columns, which is the same as a column of ones. A column of zeros, or one that is
    constant beside a constant, has `norm` zero.
    """

    r: Float[np.ndarray, "columns columns"]
    mean: Float[np.ndarray, " columns"]
    norm: Float[np.ndarray, " columns"]
    samples: int
    constant: bool

    @property
    def total(self) -> float:
        """Sum of squares of the target, about its mean where there is a constant."""
        return float(self.norm[-1] ** 2)

    def solve(self, use: Sequence[int]) -> SubsetFit:
        """Minimum-norm least squares of the target by the columns `use`."""
        use = list(use)
        a, b = self.r[:, use], self.r[:, -1]
        found = directions(a, rounding=self.samples * np.finfo(a.dtype).eps)
        theta = found.inverse @ (found.basis.T @ b)
        norm = np.where(self.norm > 0, self.norm, 1.0)
        unit = 1.0 / norm[use]
        weak = np.flatnonzero(np.abs(found.weakest) > 0.2)
        return SubsetFit(
            theta * unit * norm[-1],
            float(np.sum((b - a @ theta) ** 2)) * norm[-1] ** 2,
            found.inverse @ found.inverse.T * np.outer(unit, unit),
            found.rank,
            found.condition if use else 1.0,
            tuple(use[int(w)] for w in weak),
        )

    def intercept(
        self, use: Sequence[int], theta: Float[np.ndarray, " columns"]
    ) -> float:
        """The constant that belongs to the coefficients `theta` of columns `use`."""
        return float(self.mean[-1] - theta @ self.mean[list(use)])


def triangle(
    data: Dataset,
    output: int,
    rows: Sequence[tuple[int, int]],
    *,
    history: int,
    constant: bool,
    need: int,
) -> Triangle:
    """Factorise the lagged variables `rows`, (signal, lag), with the output last.

    Over all samples with `history` earlier ones in their record and only valid values
    in their window; fewer than `need` raise `DataError`.
    """
    ones = np.ones(len(data.channels.all), data.records[0].u.dtype)
    found = regression_rows(
        data,
        Variables(tuple(rows)),
        (output,),
        history=history,
        need=need,
        gain=ones,
        exact=True,
    )
    columns = np.concatenate([np.asarray(found.v)[1:], np.asarray(found.y)])
    return factorise(columns.astype(float), constant=constant)


def factorise(
    columns: Float[np.ndarray, "columns rows"], *, constant: bool
) -> Triangle:
    """The triangle of given columns, the target last."""
    width, samples = columns.shape
    mean = columns.mean(axis=1) if constant else np.zeros(width)
    size = np.abs(columns).max(axis=1)
    centred = columns - mean[:, None]
    norm = np.linalg.norm(centred, axis=1)
    # What is left of a constant channel is rounding.
    rounding = 10 * np.finfo(float).eps * size * np.sqrt(samples)
    norm = np.where(norm > rounding, norm, 0.0)
    centred *= np.where(norm > 0, 1.0 / np.where(norm > 0, norm, 1.0), 0.0)[:, None]
    r = triangle_of(centred)
    return Triangle(r, mean, norm, samples, constant)
