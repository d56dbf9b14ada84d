"""Signs of gains at rest as constraints of the closed form: a quadratic program.

Under inputs u that are held for ever every lag and filter has its static value, so that
the output at rest is linear in the coefficients,

    A(1) y(u) = sum_(b,k) theta[b, k] w_b(x(u)) p_k(z(u)),   A(1) > 0 where A is stable.

That y is not lower at one point than at another is one linear inequality. With H and r,
the normal equations with their ridge, and a row of G for every pair of points,

    min theta'H theta / 2 - r'theta   so that   G theta >= 0 .

Its dual is nonnegative least squares: with H = L L' and A = L^-1 G',

    min |A lambda + L^-1 r|,  lambda >= 0;   L' theta is what remains.

C. L. Lawson, R. J. Hanson, "Solving Least Squares Problems", 1974, chapter 23.
"""

import dataclasses

import numpy as np
import scipy.linalg
from jaxtyping import Float

from jaxnarx.models import RestPairs
from jaxnarx.partition.closed_form.design_matrix import BlockDesign, weight
from jaxnarx.partition.closed_form.model import ClosedForm
from jaxnarx.partition.closed_form.rest import rest_variables
from jaxnarx.regressors import evaluate

ACTIVE_FACTOR = 30
"""Most steps of the search for the active rows, over their number."""
ROW_SLACK = 1e-6
"""Its square is what a row of unit length gives way under unit force: neighbouring
operating points have nearly the same row."""
LEAST_VIOLATION = 1e-9
"""Fall from the lower to the higher point that counts as rounding: in standard
deviations of the output, or as a share of the product of norms."""


def rest_columns(
    design: BlockDesign, inputs: Float[np.ndarray, "points inputs"]
) -> Float[np.ndarray, "points columns"]:
    """Columns of the design under held inputs, times A(1)."""
    z, x = rest_variables(design.signals, inputs)
    factor = design.signals.factor
    parts = [
        weight(block.region, x) * np.asarray(evaluate(factor[block.terms], z))
        for block in design.blocks
    ]
    return np.concatenate(parts).T


def rises(design: BlockDesign, pairs: RestPairs) -> Float[np.ndarray, "pairs columns"]:
    """G: what the columns rise from `low` to `high`, times A(1)."""
    return rest_columns(design, pairs.high) - rest_columns(design, pairs.low)


def solve_signed(
    gram: Float[np.ndarray, "columns columns"],
    right: Float[np.ndarray, " columns"],
    ridge: float,
    rows: Float[np.ndarray, "pairs columns"],
) -> Float[np.ndarray, " columns"]:
    """The solution of normal equations with `rows @ solution >= 0`, but for what active
    rows give way (`ROW_SLACK`).

    They are scaled to a unit diagonal, to which the ridge is added. Rows join as they
    are broken, until none is. LinAlgError where the search for the active ones among
    them does not end.
    """
    power = np.diagonal(gram)
    size = np.sqrt(np.where(power > 0, power, 1.0))
    scaled = gram / np.outer(size, size) + np.diag(np.where(power > 0, ridge, 1.0))
    root = np.linalg.cholesky(scaled)
    free = scipy.linalg.solve_triangular(root, right / size, lower=True)
    rows = rows / size
    length = np.linalg.norm(rows, axis=1)
    left, active = free, np.zeros(len(rows), bool)
    while True:
        theta = scipy.linalg.solve_triangular(root, left, lower=True, trans=1)
        broken = rows @ theta < -LEAST_VIOLATION * length * np.linalg.norm(theta)
        if not np.any(broken & ~active):
            return theta / size
        active |= broken
        dual = scipy.linalg.solve_triangular(root, rows[active].T, lower=True)
        left = free + _force(dual, free)


def _force(
    dual: Float[np.ndarray, "columns rows"], free: Float[np.ndarray, " columns"]
) -> Float[np.ndarray, " columns"]:
    """The least step from `free` to where no column of `dual` points against it."""
    from scipy.optimize import nnls  # it loads half of scipy

    dual = dual / np.linalg.norm(dual, axis=0)
    slack = ROW_SLACK * np.eye(dual.shape[1])
    target = np.concatenate([-free, np.zeros(len(slack))])
    most = ACTIVE_FACTOR * len(slack)
    try:
        return dual @ nnls(np.concatenate([dual, slack]), target, maxiter=most)[0]
    except RuntimeError as error:
        raise np.linalg.LinAlgError(f"signs of gains: {error}") from error


def constrain(form: ClosedForm, pairs: RestPairs) -> ClosedForm:
    """The candidate whose columns have the coefficients that are best under the signs.

    Likewise the models made without every group, by which it is judged. The columns are
    those chosen without constraints. Coefficients that are given stay: they are
    constrained where they are made.
    """
    if form.given is not None:
        return form
    stage, design = form.stage, form.stage.design
    rows = rises(design, pairs)
    least = -LEAST_VIOLATION * design.a.sum()

    def solve(group: int | None) -> Float[np.ndarray, " columns"]:
        theta = np.zeros(design.equations.columns)
        at, own = stage.choose_columns(group)
        if np.any(rows[:, at] @ own < least):
            system = design.equations.exclude_group(group)
            gram, size = system.gram[np.ix_(at, at)], system.size[at]
            own = solve_signed(gram, system.right[at], stage.ridge, rows[:, at] / size)
            own = own / size
        theta[at] = own
        return theta

    left, losses = [], []
    for g in range(len(stage.losses)):
        left.append(design.answers(g, solve(g)[None])[0])
        losses.append(design.loss(g, left[-1]))
    return dataclasses.replace(
        form,
        stage=dataclasses.replace(stage, losses=np.array(losses)),
        given=solve(None),
        left_out=left,
        unconstrained=form.free_run,
        turned=pairs.count(rows @ form.coefficients() < least),
    )
