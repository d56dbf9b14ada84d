"""Time constants to begin with for a bank of first-order lags."""

from typing import Literal

import numpy as np
from jaxtyping import Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import triangle
from jaxnarx.checks import choice, require_known
from jaxnarx.data import Dataset, bank_times, step_times
from jaxnarx.errors import DataError, SpecError
from jaxnarx.regressors.filters import low_pass_bank
from jaxnarx.regressors.pool import polynomial_pool
from jaxnarx.regressors.rows import regression_rows

GRID_SIZE = 16
"""Time constants that a search may choose from."""

EXCHANGE_SWEEPS = 2
"""How often every chosen one may be exchanged for a better one."""


@guard_arguments
def time_constants(
    data: Dataset,
    output: str,
    *,
    count: int = 4,
    method: Literal["step", "search"] = "step",
) -> tuple[float, ...]:
    """`count` time constants [s] for first-order lags of the inputs, shortest first.

    "step" looks at the estimated step responses (`jaxnarx.data.step_times`): a
    geometric series from half the shortest rise time of any input, but not less than
    the sample time, to twice the longest. Quick, but blind to slow parts of a response
    that are small at every instant.

    "search" chooses from 16 time constants, a geometric series from the sample time to
    a quarter of the longest record: greedily the one whose lags of all inputs, beside
    the inputs themselves, a constant and those chosen before, leave the smallest sum of
    squared errors of a linear model of `output` without feedback; then each is
    exchanged for a better one, if there is one, twice over.

    Figures are rounded to two digits. Data in which no response is seen raise
    `DataError`.
    """
    known = data.channels.output_names
    require_known(output, known, "output")
    choice(method, ("step", "search"), "method")
    most = GRID_SIZE if method == "search" else 30
    if not 1 <= count <= most:
        raise SpecError(f"count must be 1 to {most}, got {count}", field="count")
    if not data.channels.inputs:
        raise DataError("there are no inputs to filter")
    found = _estimate_by_search if method == "search" else _estimate_by_step
    return tuple(sorted({_round(t) for t in found(data, output, count)}))


def _round(value: float) -> float:
    return float(f"{value:.2g}")


def _estimate_by_step(data: Dataset, output: str, count: int) -> list[float]:
    times = step_times(data, output).values()
    if not times:
        raise DataError(
            f"no response of {output!r} to any input stands clear of chance; use "
            "method='search', or longer records",
            channel=output,
        )
    return bank_times(times, count, sample_time=data.sample_time)


def _estimate_by_search(data: Dataset, output: str, count: int) -> list[float]:
    longest = max(len(r) for r in data) * data.sample_time
    top = max(longest / 4, 4 * data.sample_time)
    grid = np.geomspace(data.sample_time, top, GRID_SIZE)
    table = _triangle(data, output, grid.tolist())
    inputs = len(data.channels.inputs)
    # columns: one, inputs, then by input the lags of the grid, last the output
    start = list(range(1 + inputs))
    lags = [
        [1 + inputs + i * GRID_SIZE + g for i in range(inputs)]
        for g in range(GRID_SIZE)
    ]

    def best(kept: list[int]) -> int:
        have = start + [c for g in kept for c in lags[g]]
        errors = {g: _error(table, have + lags[g]) for g in range(GRID_SIZE)}
        return min(errors.keys() - set(kept), key=lambda g: errors[g])

    chosen: list[int] = []
    for _ in range(count):
        chosen.append(best(chosen))
    for _ in range(EXCHANGE_SWEEPS):
        for n in range(count):
            chosen[n] = best(chosen[:n] + chosen[n + 1 :])
    return [float(grid[g]) for g in chosen]


def _error(table: Float[np.ndarray, "columns columns"], use: list[int]) -> float:
    """Sum of squared errors of the last column by those in `use`."""
    a, b = table[:, use], table[:, -1]
    theta = np.linalg.lstsq(a, b, rcond=None)[0]
    return float(np.sum((b - a @ theta) ** 2))


def _triangle(
    data: Dataset, output: str, grid: list[float]
) -> Float[np.ndarray, "columns columns"]:
    """R of a QR factorisation of all columns and the output, by blocks of rows.

    Every least-squares problem in some of the columns is the same one in those of R.
    """
    pool = polynomial_pool(
        data.channels,
        outputs=[output],
        input_lags=(0,),
        output_lags=(),
        degree=1,
        filters=low_pass_bank(grid),
    )
    need = len(pool.variables) + 2
    rows = regression_rows(
        data, pool.variables, pool.outputs, history=0, need=need, exact=True
    )
    columns = np.concatenate([np.asarray(rows.v), np.asarray(rows.y)]).astype(float)
    return triangle(columns)
