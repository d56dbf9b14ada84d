"""Cells of a group of variables cut into levels, and the F tests of their effects.

The model is (5.27), here for two variables: y_ijk = m + a_i + b_j + (ab)_ij + e_ijk,
with every effect summing to zero over each of its indices. An effect is the tuple of
its variables.
"""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Integer, UInt8
from scipy.special import fdtrc

Effect = tuple[int, ...]
"""Numbers of the variables in one effect, rising: places in `[1, x_1 ... x_V]`."""

LEAST_CELL_SAMPLES = 2
"""Samples per cell of a balanced test: one would leave no error to compare with."""


class FTest(NamedTuple):
    """F test of one effect in a group of variables, or in a model (group `()`).

    `squares` is the effect's sum of squares with `freedom` degrees of freedom, `spare`
    those of the error, `total` the sum of squares of the samples used. An effect that
    the cells cannot tell from others has `freedom` 0, `f` 0 and `p` 1.
    """

    effect: Effect
    group: Effect
    freedom: int
    spare: int
    squares: float
    total: float
    f: float
    p: float
    balanced: bool


def cut(
    x: Float[np.ndarray, " rows"], levels: int
) -> tuple[UInt8[np.ndarray, " rows"], int]:
    """Level 0, 1, ... of every sample, and how many levels there are.

    A sample with middle rank r of N (from 0 to N; equal values share theirs) gets level
    floor(levels r / N), so the intervals are equally frequent as far as ties allow.
    Levels nobody has are closed up; up to `levels` different values each keep their
    own. Ranks alone count, hence a rising transformation of x changes nothing.
    """
    value, place, count = np.unique(x, return_inverse=True, return_counts=True)
    if len(value) <= levels:
        return place.astype(np.uint8), len(value)
    middle = np.cumsum(count) - count / 2
    level = np.floor(levels * middle / len(x)).astype(np.int64)
    used, closed = np.unique(np.minimum(level, levels - 1), return_inverse=True)
    return closed[place].astype(np.uint8), len(used)


def list_effects(variables: Sequence[int], order: int) -> list[Effect]:
    """All effects of up to `order` of these variables, main effects first."""
    sizes = range(1, min(order, len(variables)) + 1)
    return [e for n in sizes for e in itertools.combinations(variables, n)]


def cell_numbers(
    codes: Sequence[UInt8[np.ndarray, " rows"]], shape: tuple[int, ...]
) -> Integer[np.ndarray, " rows"]:
    """Cell of every sample in the full factorial, the last variable fastest."""
    kind = np.uint16 if math.prod(shape) < 2**16 else np.int64
    cell = np.zeros(len(codes[0]), kind)
    for code, levels in zip(codes, shape, strict=True):
        cell = cell * kind(levels) + code
    return cell


def equal_cells(
    cell: Integer[np.ndarray, " rows"], count: Int[np.ndarray, " cells"]
) -> Int[np.ndarray, "cells replicates"]:
    """Draw as many samples of every cell as the smallest has.

    They are spread evenly over the cell's samples in their order in the records: no
    random numbers, and as little correlation between neighbours as can be.
    """
    size = int(count.min())
    order = np.argsort(cell, kind="stable").astype(np.int32)
    first = np.cumsum(count) - count
    step = (np.arange(size)[None] + 0.5) * count[:, None] / size
    return order[first[:, None] + np.floor(step).astype(np.int64)]


def balanced_squares(
    mean: Float[np.ndarray, "*levels"], replicates: int, axes: Sequence[int]
) -> float:
    """Sum of squares of the effect of these axes, from equally filled cells' means.

    The effect itself is the table of means, averaged over the axes it leaves out and
    with its mean taken off along those it holds; that is the least-squares estimate
    under (5.31), and the effects are orthogonal.
    """
    part = mean
    for axis in range(mean.ndim):
        average = part.mean(axis=axis, keepdims=True)
        part = part - average if axis in axes else average
    return float(replicates * (mean.size / part.size) * np.sum(part**2))


def contrasts(levels: int) -> Float[np.ndarray, "levels parameters"]:
    """Rows of a main effect's columns under the sum-to-zero constraint (5.31).

    One parameter for every level but the last, whose value is minus their sum.
    """
    return np.vstack([np.eye(levels - 1), -np.ones((1, levels - 1))])


def eliminate(
    gram: Float[np.ndarray, "columns columns"],
    squares: Float[np.ndarray, " columns"],
    among: int,
) -> tuple[Float[np.ndarray, "columns steps"], Int[np.ndarray, " steps"]]:
    """Cholesky elimination of the first `among` columns, in order, from X'X.

    A column that is a combination of earlier ones is passed over: what is left of its
    square falls below rounding beside `squares`, the diagonal before anything was
    eliminated. Returns the steps' columns of L and which columns they are; the squares
    of a row of L are what each step explains of that row's column.
    """
    lower = np.zeros((len(gram), among))
    kept: list[int] = []
    for j in range(among):
        done = len(kept)
        column = gram[:, j] - lower[:, :done] @ lower[j, :done]
        if column[j] > 1e-10 * squares[j]:
            lower[:, done] = column / np.sqrt(column[j])
            kept.append(j)
    return lower[:, : len(kept)], np.array(kept, dtype=np.int64)


class _Cells(NamedTuple):
    """Filled cells: samples held, sums of y, columns of every effect by its axes."""

    held: Int[np.ndarray, " cells"]
    sums: Float[np.ndarray, " cells"]
    block: dict[Effect, Float[np.ndarray, "_ cells"]]


def _explained_squares(
    cells: _Cells, axes: Effect, others: Sequence[Effect]
) -> tuple[float, int]:
    """Squares and degrees of freedom of an effect beyond these others.

    By normal equations: X'X holds whole numbers and is exact.
    """
    first = np.vstack([cells.block[o] for o in others])
    design = np.vstack([first, cells.block[axes]])
    gram = (design * cells.held[None]) @ design.T
    # The moment with y rides along as a last row.
    moment = design @ cells.sums
    whole = np.block([[gram, moment[:, None]], [moment[None], np.zeros((1, 1))]])
    lower, kept = eliminate(whole, np.diag(whole), len(gram))
    own = kept >= first.shape[0]
    return float(np.sum(lower[-1, own] ** 2)), int(np.sum(own))


def judge(
    squares: float, freedom: int, error: float, spare: int, total: float
) -> tuple[float, float]:
    """F and p of a sum of squares against the error's; (0, 1) where there is no test.

    An error below rounding counts as rounding, so F stays finite.
    """
    if freedom < 1 or spare < 1 or total <= 0:
        return 0.0, 1.0
    floor = 16 * np.finfo(float).eps * total
    f = max(squares, 0.0) / freedom / (max(error, floor) / spare)
    return float(f), float(fdtrc(freedom, spare, f))


class CellLayout(NamedTuple):
    """The cells of a group of variables: `pick` if thinned to equal cells, else the
    `cell` of each sample."""

    shape: tuple[int, ...]
    pick: Int[np.ndarray, "cells replicates"] | None
    cell: Integer[np.ndarray, " rows"] | None


def lay_out(
    codes: Sequence[UInt8[np.ndarray, " rows"]],
    shape: tuple[int, ...],
    balance: float | int,
) -> CellLayout:
    """Thin to equal cells where this keeps at least the share `balance` of the samples,
    and two in every cell.
    """
    cell = cell_numbers(codes, shape)
    cells = math.prod(shape)
    if cells * LEAST_CELL_SAMPLES <= len(cell):
        count = np.bincount(cell, minlength=cells)
        if int(count.min()) >= max(LEAST_CELL_SAMPLES, balance * len(cell) / cells):
            return CellLayout(shape, equal_cells(cell, count), None)
    return CellLayout(shape, None, cell)


def group_tests(
    layout: CellLayout,
    y: Float[np.ndarray, " rows"],
    group: Effect,
    wanted: Sequence[Effect],
    *,
    order: int,
    spent: float = 0.0,
) -> list[FTest]:
    """F tests of the effects `wanted` in a group with effects of up to `order`
    variables; y is centred.

    The error is the variation within cells: it holds what the other variables do and
    what y does inside a cell. On equal cells it is the classical balanced test. On
    others each effect gets the squares it explains beyond all effects that do not
    contain it (Yates 1934; "type II"); that is the same on equal cells. If all cells
    hold single samples, the model's residual is the error. `spent` is the share of the
    degrees of freedom that y has lost before; the error loses the same.
    """
    if layout.pick is not None:
        tests = _test_balanced(y[layout.pick], layout.shape, group, wanted)
    else:
        assert layout.cell is not None
        tests = _test_unbalanced(layout.cell, y, layout.shape, group, wanted, order)
    return [_less(t, spent) for t in tests]


def _less(test: FTest, spent: float) -> FTest:
    """The test with fewer degrees of freedom of the error, its squares as they are."""
    spare = math.floor(test.spare * (1 - spent))
    if spare == test.spare:
        return test
    f = test.f * spare / test.spare
    p = float(fdtrc(test.freedom, spare, f)) if test.freedom and spare else 1.0
    return test._replace(spare=spare, f=f, p=p)


def _test_balanced(
    samples: Float[np.ndarray, "cells replicates"],
    shape: tuple[int, ...],
    group: Effect,
    wanted: Sequence[Effect],
) -> list[FTest]:
    cells, replicates = samples.shape
    mean = samples.mean(axis=1)
    # y is centred, so little cancels; two passes over the samples would cost double.
    squares = float(np.sum(samples * samples))
    error = max(squares - replicates * float(np.sum(mean**2)), 0.0)
    total = max(squares - samples.size * float(mean.mean()) ** 2, 0.0)
    spare = cells * (replicates - 1)
    tests = []
    for effect in wanted:
        axes = [group.index(v) for v in effect]
        squares = balanced_squares(mean.reshape(shape), replicates, axes)
        freedom = math.prod(shape[a] - 1 for a in axes)
        f, p = judge(squares, freedom, error, spare, total)
        tests.append(FTest(effect, group, freedom, spare, squares, total, f, p, True))
    return tests


def _fill_cells(
    cell: Integer[np.ndarray, " rows"],
    y: Float[np.ndarray, " rows"],
    shape: tuple[int, ...],
    order: int,
) -> _Cells:
    if math.prod(shape) <= 4 * len(y):
        count = np.bincount(cell)
        used = np.flatnonzero(count)
        count, total = count[used], np.bincount(cell, y)[used]
    else:
        used, place, count = np.unique(cell, return_inverse=True, return_counts=True)
        total = np.bincount(place, y)
    level = np.unravel_index(used, shape)
    main = [contrasts(n).T[:, at] for n, at in zip(shape, level, strict=True)]
    block: dict[Effect, np.ndarray] = {(): np.ones((1, len(used)))}
    for axes in list_effects(range(len(shape)), order):
        block[axes] = products([main[a] for a in axes])
    return _Cells(count, total, block)


def products(
    main: Sequence[Float[np.ndarray, "_ rows"]],
) -> Float[np.ndarray, "columns rows"]:
    """Columns of an interaction: all products of its variables' columns."""
    block = main[0]
    for other in main[1:]:
        block = (block[:, None] * other[None]).reshape(-1, block.shape[1])
    return block


def _test_unbalanced(
    cell: Integer[np.ndarray, " rows"],
    y: Float[np.ndarray, " rows"],
    shape: tuple[int, ...],
    group: Effect,
    wanted: Sequence[Effect],
    order: int,
) -> list[FTest]:
    cells = _fill_cells(cell, y, shape, order)
    # Not `y @ y`: for a vector this long, threads cost more than they save.
    total = float(np.sum(y * y))
    between = float(np.sum(cells.sums**2 / cells.held))
    spare = len(y) - len(cells.held)
    if spare < 1:
        constant, *effects = cells.block.values()
        whole = cells._replace(block={(): constant, (0,): np.vstack(effects)})
        between, rank = _explained_squares(whole, (0,), [()])
        spare = len(y) - 1 - rank
    tests = []
    for effect in wanted:
        axes = tuple(group.index(v) for v in effect)
        others = [a for a in cells.block if not set(axes) <= set(a)]
        squares, freedom = _explained_squares(cells, axes, others)
        f, p = judge(squares, freedom, total - between, spare, total)
        tests.append(FTest(effect, group, freedom, spare, squares, total, f, p, False))
    return tests
