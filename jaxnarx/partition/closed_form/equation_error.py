"""Least squares one step ahead (ARX)."""

import numpy as np
from jaxtyping import Float

from jaxnarx.arrays import ridge_solve
from jaxnarx.partition.closed_form.denominator import limit_poles
from jaxnarx.partition.closed_form.physics import solve_signed
from jaxnarx.partition.closed_form.signals import RunSignals
from jaxnarx.regressors import evaluate

RIDGE = 1e-9
"""Ridge, in units of the columns' own power."""


def equation_error(
    signals: RunSignals,
    order: int,
    *,
    without: int | None = None,
    signs: Float[np.ndarray, "pairs columns"] | None = None,
) -> tuple[Float[np.ndarray, " _"], Float[np.ndarray, " columns"]]:
    """A(q) and coefficients of least squares one step ahead with all terms (ARX).

    With `signs`, rows, these times the coefficients are not negative (`physics.rises`).
    Where poles are beyond what the signals allow they move there, and the other
    coefficients are those that are best with them.
    """
    size = order + len(signals.factor)
    gram, right = np.zeros((size, size)), np.zeros(size)
    parts = signals.apart.shape[1]
    trains = np.full(parts, True) if without is None else ~signals.apart[without]
    for one in signals.stretches:
        at = np.concatenate([c for c, t in zip(one.counted, trains, strict=True) if t])
        terms = np.asarray(evaluate(signals.factor, one.z[:, at]))
        rows = np.concatenate([-one.lags(one.y, order)[:, at], terms])
        gram += rows @ rows.T
        right += rows @ one.y[at]

    def solve(gram: np.ndarray, right: np.ndarray, past: int) -> np.ndarray:
        if signs is None:
            return ridge_solve(gram, right, RIDGE)
        return solve_signed(gram, right, RIDGE, np.pad(signs, ((0, 0), (past, 0))))

    found = solve(gram, right, order)
    free = np.concatenate([[1.0], found[:order]])
    a = limit_poles(free, signals.largest_pole)
    if a is free:
        return a, found[order:]
    right = right[order:] - gram[order:, :order] @ a[1:]
    return a, solve(gram[order:, order:], right, 0)
