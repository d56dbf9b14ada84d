"""`select` with `Anova`: a smaller pool of the terms that the effects allow."""

import numpy as np
import pytest

from jaxnarx.data import Dataset
from jaxnarx.errors import DataError
from jaxnarx.regressors import polynomial_pool
from jaxnarx.selection import select
from jaxnarx.settings import Anova, StepwiseF


def record(outputs) -> Dataset:
    rng = np.random.default_rng(6)
    u = rng.uniform(-1, 1, size=(1500, 3))
    y = outputs(u, rng)
    return Dataset.from_arrays(
        u, y, inputs=["a", "b", "c"], outputs=["y"], sample_time=0.1
    )


def product(u, rng):
    """y(t) = a(t-1) b(t) + c(t) and noise: a and b act together only."""
    past = np.r_[0.0, u[:-1, 0]]
    return (past * u[:, 1] + u[:, 2] + 0.05 * rng.normal(size=len(u)))[:, None]


def pool_of(data: Dataset):
    return polynomial_pool(data.channels, input_lags=(0, 1), output_lags=(), degree=2)


def test_the_pool_shrinks_to_what_acts_and_the_terms_are_found_in_it():
    data = record(product)
    solution = select(pool_of(data), data, Anova())
    names = set(solution.value.names)
    assert {"1", "c[t]", "a[t-1]*b[t]"} <= names
    assert len(names) < len(pool_of(data)) / 2
    (table,) = solution.stats["anova"]
    assert table.of("a[t-1]", "b[t]").significant
    chosen = select(solution.value.narrow_pool(), data, StepwiseF()).value
    assert set(chosen.names) == {"1", "c[t]", "a[t-1]*b[t]"}


def test_coefficients_are_those_of_least_squares():
    data = record(product)
    value = select(pool_of(data), data, Anova()).value
    again = select(value, data, StepwiseF(f_in=0.0, f_out=0.0, exchange=False)).value
    size = value.size()
    assert again.terms()[:size] == value.terms()
    np.testing.assert_allclose(
        again.sse[0, size - 1], value.sse[0, size - 1], rtol=1e-9
    )


def test_outputs_keep_as_many_terms_as_act_on_each():
    data = record(product)
    rows = data.records[0]
    both = Dataset.from_arrays(
        rows.u,
        np.c_[rows.y, rows.u[:, 2]],
        inputs=["a", "b", "c"],
        outputs=["y", "w"],
        sample_time=0.1,
    )
    value = select(pool_of(both), both, Anova()).value
    alone = select(pool_of(data), data, Anova()).value
    assert value.names_of("y") == alone.names
    assert len(value.names_of("w")) != len(alone.names)
    assert value.sse[1, -1] < 1e-12 * value.sse[0, -1]


def test_an_output_of_noise_has_no_effects():
    data = record(lambda u, rng: rng.normal(size=(len(u), 1)))
    solution = select(pool_of(data), data, Anova())
    assert solution.value.names == ["1"]


def test_too_few_rows_are_an_error():
    data = record(product)
    short = Dataset.from_arrays(
        data.records[0].u[:4],
        data.records[0].y[:4],
        inputs=["a", "b", "c"],
        outputs=["y"],
        sample_time=0.1,
    )
    with pytest.raises(DataError):
        select(pool_of(short), short, Anova())
