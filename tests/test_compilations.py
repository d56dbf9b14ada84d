"""One flow, counted: a sample more and other names compile nothing anew."""

import common
import jax
import numpy as np
import pytest

import jaxnarx as jnx
from jaxnarx.arrays.sizes import bucket

BUDGET = 40
"""Programs of a first flow, from data to report."""


def records(samples: int, names: tuple[str, str, str], seed: int) -> jnx.Dataset:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, (samples // 5 + 1, 2)), 5, axis=0)[:samples]
    y = np.zeros(samples)
    for t in range(2, samples):
        y[t] = 0.7 * y[t - 1] - 0.1 * y[t - 2] + 0.3 * np.tanh(2 * u[t - 1, 0])
        y[t] += 0.2 * u[t - 2, 1] * (1 + 0.5 * u[t - 1, 0])
    y += 0.01 * rng.normal(size=samples)
    *inputs, output = names
    return jnx.Dataset.from_arrays(
        [u], [y[:, None]], inputs=inputs, outputs=[output], sample_time=0.1
    )


def flow(samples: int, names=("u", "w", "y")) -> jnx.Report:
    data, judge = records(samples, names, 0), records(samples // 2, names, 1)
    pool = jnx.polynomial_pool(
        data.channels, input_lags=(0, 1, 2), output_lags=(1, 2), degree=2
    )
    chosen = jnx.select(pool, data, jnx.ForwardOLS(max_terms=6)).value
    parts = jnx.Lolimot(scheduling=[f"{names[0]}[t-1]"], max_models=3)
    grown = jnx.grow(chosen, data, parts).value
    fine = jnx.refine(
        grown,
        data,
        jnx.SimulationError(horizons=(20,), window_steps=1, max_steps=2),
        validation=judge,
    ).value
    return jnx.report(fine, judge)


def test_a_flow_serves_others_of_about_its_size_and_of_any_name():
    jax.clear_caches()
    first = common.compilations(lambda: flow(400))
    assert 0 < first <= BUDGET
    assert common.compilations(lambda: flow(401)) == 0
    assert common.compilations(lambda: flow(490)) == 0
    assert common.compilations(lambda: flow(401, ("speed", "load", "NOx"))) == 0


def test_names_are_told_all_the_same():
    text = str(flow(401, ("speed", "load", "NOx")))
    assert "NOx" in text
    assert "y1" not in text


@pytest.mark.parametrize("size", [1, 31, 32, 33, 600, 1_000, 1_025, 70_000, 2_000_000])
def test_sizes_are_rounded_up_by_little(size):
    found = bucket(size)
    assert size <= found < size + max(32, size / (2 if size <= 1_024 else 16))
    assert bucket(found) == found
    assert bucket(size + 1) >= found


def test_padding_changes_nothing():
    """The same record, rounded to another size beside a longer one without rows."""
    data = records(600, ("u", "w", "y"), 0)
    (one,), (long,) = data.records, records(700, ("u", "w", "y"), 2).records
    beside = jnx.Dataset.from_arrays(
        [one.u, long.u],
        [one.y, np.where(np.arange(700)[:, None] < 1, long.y, np.nan)],
        inputs=("u", "w"),
        outputs=("y",),
        sample_time=0.1,
        missing="mask",
    )
    pool = jnx.polynomial_pool(
        data.channels, input_lags=(0, 1), output_lags=(1,), degree=2
    )
    method = jnx.ForwardOLS(max_terms=5)
    chosen = [jnx.select(pool, d, method).value for d in (data, beside)]
    assert chosen[0].names == chosen[1].names
    runs = [
        jnx.simulate(jnx.grow(s, d, jnx.Global()).value, data).value[0]
        for s, d in zip(chosen, (data, beside), strict=True)
    ]
    # Gains are those of other inputs, so coefficients are too; runs differ by rounding.
    np.testing.assert_allclose(runs[0], runs[1], rtol=0, atol=1e-9)
