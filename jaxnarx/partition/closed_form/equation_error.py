"""Least squares one step ahead (ARX)."""

import numpy as np
from jaxtyping import Float

from jaxnarx.arrays import ridge_solve
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
    if signs is None:
        found = ridge_solve(gram, right, RIDGE)
    else:
        signs = np.pad(signs, ((0, 0), (order, 0)))
        found = solve_signed(gram, right, RIDGE, signs)
    return np.concatenate([[1.0], found[:order]]), found[order:]
