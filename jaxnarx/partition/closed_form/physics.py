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
from collections.abc import Sequence

import numpy as np
import scipy.linalg
from jaxtyping import Bool, Float

from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.models import ranges
from jaxnarx.partition.closed_form.design_matrix import BlockDesign, weight
from jaxnarx.partition.closed_form.model import ClosedForm
from jaxnarx.partition.closed_form.profile import input_levels
from jaxnarx.partition.closed_form.rest import rest_variables
from jaxnarx.regressors import evaluate
from jaxnarx.settings import Physics

INPUT_STEP_SHARE = 0.05
"""Share of its trained range by which an input is moved to either side of an operating
point."""
OPERATING_POINTS = 1000
"""Operating points at which every sign is asked: measured samples, evenly spread. Of a
measured engine's NOx with five regions a hundred left 17 gains of 402 at other points
wrong, a thousand four, at half a second and no larger an error."""
ACTIVE_FACTOR = 30
"""Most steps of the search for the active rows, over their number."""
ROW_SLACK = 1e-6
"""Its square is what a row of unit length gives way under unit force: neighbouring
operating points have nearly the same row."""
LEAST_VIOLATION = 1e-9
"""Fall from the lower to the higher point that counts as rounding: in standard
deviations of the output, or as a share of the product of norms."""


@dataclasses.dataclass(frozen=True, eq=False)
class RestPairs:
    """Held inputs, physical units: the output at rest at `high` is not lower than that
    at `low`.

    Pairs of one input follow one another, operating point by operating point.
    """

    low: Float[np.ndarray, "pairs inputs"]
    high: Float[np.ndarray, "pairs inputs"]
    moved: tuple[str, ...]
    """The input in which the two differ, pair by pair."""

    def __len__(self) -> int:
        return len(self.low)

    def count(self, chosen: Bool[np.ndarray, " pairs"]) -> dict[str, tuple[int, int]]:
        """The numbers of chosen pairs and of all, by input."""
        moved = np.array(self.moved)
        return {
            name: (int(chosen[moved == name].sum()), int((moved == name).sum()))
            for name in dict.fromkeys(self.moved)
        }


def make_pairs(
    data: Dataset,
    physics: Physics,
    *,
    output: str,
    points: int = OPERATING_POINTS,
) -> RestPairs:
    """What physics says of an output, at measured samples that are spread evenly.

    An input with few values is moved from each to the next, others by
    `INPUT_STEP_SHARE` of their range to either side. SpecError where an input does not
    move in the data: no term of it can be trained.
    """
    names, inputs = data.channels.input_names, len(data.channels.inputs)
    least, most = (end[:inputs] for end in ranges(data))
    rows = operating_points(data, points)
    low, high, moved = [], [], []
    for name, sign in physics.signs.items():
        s = names.index(name)
        if not most[s] > least[s]:
            raise SpecError(
                f"physics of {output}: {name} does not move in the records, so no "
                "model has a term of it; leave its sign out, or add records in which "
                "it moves",
                field=f"physics.{output}",
            )
        for below, above in _steps(
            rows[:, s], input_levels(data, s), least[s], most[s]
        ):
            ends = [_with_input(rows, s, value) for value in (below, above)]
            low.append(ends[0 if sign > 0 else 1])
            high.append(ends[1 if sign > 0 else 0])
            moved += [name] * len(rows)
    return RestPairs(np.concatenate(low), np.concatenate(high), tuple(moved))


def operating_points(data: Dataset, points: int) -> Float[np.ndarray, "points inputs"]:
    """Inputs of so many samples at which all of them are valid, evenly spread."""
    inputs = len(data.channels.inputs)
    rows = [r.u[r.valid[:, :inputs].all(axis=1)] for r in data]
    every = np.concatenate(rows).astype(float)
    at = np.linspace(0, len(every) - 1, min(points, len(every)))
    return every[np.unique(at.astype(int))]


def _steps(
    here: Float[np.ndarray, " points"],
    levels: Sequence[float] | None,
    least: float,
    most: float,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Lower and upper values of an input at every point."""
    if levels is not None and len(levels) > 1:
        pairs = zip(levels, levels[1:], strict=False)
        return [(np.full(len(here), a), np.full(len(here), b)) for a, b in pairs]
    step = INPUT_STEP_SHARE * (most - least)
    return [(np.maximum(here - step, least), np.minimum(here + step, most))]


def _with_input(rows: np.ndarray, s: int, value: np.ndarray) -> np.ndarray:
    out = rows.copy()
    out[:, s] = value
    return out


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
