"""What refinement promises, on random problems of a few rows.

On so few samples starts diverge, in training and in validation, and least squares fits
noise: what is never to happen happens here first.
"""

import numpy as np
import pytest

from jaxnarx.data import Dataset
from jaxnarx.models import Network
from jaxnarx.partition import grow
from jaxnarx.refinement import refine
from jaxnarx.regressors import polynomial_pool
from jaxnarx.selection import select
from jaxnarx.settings import ForwardOLS, Global, SimulationError
from jaxnarx.simulation import simulate

METHOD = SimulationError(horizons=(3,), window_steps=2, max_steps=3)


def problem(seed: int, rows: int) -> tuple[Network, Dataset, Dataset]:
    """Three quadratic terms of a first-order process, stable or not, in much noise."""
    rng = np.random.default_rng(seed)
    us, ys = [], []
    for _ in range(2):
        u, noise, pole = (
            rng.normal(size=rows),
            rng.normal(size=rows),
            rng.uniform(-1, 1.2),
        )
        y = np.zeros(rows)
        y[0] = 0.3 * noise[0]
        for t in range(1, rows):
            bent = u[t - 1] * (1 + 0.5 * u[t - 1])
            y[t] = pole * y[t - 1] + bent + 0.3 * noise[t]
        us.append(u[:, None])
        ys.append(y[:, None])
    data = Dataset.from_arrays(us, ys, inputs=["u"], outputs=["y"], sample_time=0.1)
    train, validation = data[0], data[1]
    pool = polynomial_pool(data.channels, input_lags=(0, 1), output_lags=(1,), degree=2)
    terms = select(pool, train, ForwardOLS(max_terms=3)).value
    return grow(terms, train, Global()).value, train, validation


def judged(network: Network, data: Dataset) -> tuple[bool, float]:
    """Whether the free run diverges, and its mean squared error."""
    run = simulate(network, data)
    at = run.value.scored[0]
    error = (run.value[0] - data.records[0].y)[at]
    return run.status_name == "diverged", float(np.mean(error**2))


@pytest.mark.parametrize("rows", [8, pytest.param(15, marks=pytest.mark.slow)])
def test_no_refinement_is_worse_than_its_start_on_validation(rows):
    mended = 0
    for seed in range(40):
        start, train, validation = problem(seed, rows)
        solution = refine(start, train, METHOD, validation=validation)
        before, after = (judged(n, validation) for n in (start, solution.value))
        case = f"seed {seed}: {before} -> {after}, {solution.detail}"
        # The guard sums squares in another order than this: rounding alone.
        assert after[1] <= before[1] * (1 + 1e-9), case
        assert after[0] <= before[0], case
        assert after[0] == (solution.status_name == "start_diverged"), case
        mended += before[0] and not after[0]
        for name in {row["stage"] for row in solution.stats["history"]}:
            own = [r for r in solution.stats["history"] if r["stage"] == name]
            for one, two in zip(own[:-1], own[1:], strict=True):
                if two["stage_step"] == one["stage_step"] + 1:
                    assert two["minimised"] < one["minimised"], case
    assert mended, "no start diverged"
