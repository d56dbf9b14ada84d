"""Several models at run time against a plain loop over samples."""

import dataclasses
from functools import cache
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import jaxnarx as jnx
from jaxnarx.errors import SpecError

NAMES: dict[str, Any] = {"inputs": ["u"], "outputs": ["y"], "sample_time": 1.0}
SLOPES = {"low": (0.8, 0.5), "high": (0.3, 2.0)}
"""Of y(t) = a y(t-1) + b u(t-1) on either side of u = 1."""


@cache
def part(side: str) -> jnx.Dataset:
    """Records of one side alone, u from 0 to 1 or from 1 to 2."""
    rng, (a, b) = np.random.default_rng(5), SLOPES[side]
    u = rng.uniform(0, 1, 200) + (side == "high")
    y = np.zeros(200)
    for t in range(1, 200):
        y[t] = a * y[t - 1] + b * u[t - 1]
    return jnx.Dataset.from_arrays(u, y, **NAMES)


@cache
def model(side: str) -> jnx.Network:
    """A polynomial NARX of the low side, an output-error model of the high one."""
    if side == "high":
        method = jnx.linear.OutputError(1, 1, 1, constant=False)
        return jnx.linear.fit_linear(part(side), method).value.network()
    lags: dict[str, Any] = {"input_lags": (1,), "output_lags": (1,), "degree": 1}
    pool = jnx.polynomial_pool(part(side).channels, **lags)
    return jnx.grow(pool, part(side), jnx.Global()).value


def both(rows: int = 120) -> jnx.Dataset:
    rng = np.random.default_rng(8)
    u = np.repeat(rng.uniform(0, 2, rows // 6), 6)
    return jnx.Dataset.from_arrays(u, np.zeros(rows), **NAMES)


def loop(data: jnx.Dataset, side: np.ndarray) -> np.ndarray:
    u, y = data.records[0].u[:, 0], np.zeros(len(side))
    for t in range(1, len(side)):
        a, b = SLOPES["high" if side[t] else "low"]
        y[t] = a * y[t - 1] + b * u[t - 1]
    return y


def test_the_first_valid_model_acts_and_goes_on_where_the_other_stood():
    data = both()
    found = jnx.partition.switch([model("low"), model("high")], data)
    u = data.records[0].u[:, 0]
    low, high = float(model("low").low[0]), float(model("low").high[0])
    side = (u < low) | (u > high)
    # coefficients of noise-free records, by least squares and by a search
    np.testing.assert_allclose(found.value[0][:, 0], loop(data, side), atol=1e-5)
    np.testing.assert_array_equal(found.stats["acting"][0][1:], side[1:].astype(int))
    assert found.stats["acting"][0][0] == -1
    assert found.status_name == "ok"
    np.testing.assert_allclose(found.stats["share"].sum(), 1.0)


def test_regions_and_priorities_decide():
    data = both()
    u = data.records[0].u[:, 0]
    pair = [model("high"), model("low")]
    found = jnx.partition.switch(pair, data, regions=[{"u": (1.5, 9.0)}, None])
    np.testing.assert_allclose(found.value[0][:, 0], loop(data, u >= 1.5), atol=1e-5)
    held = jnx.partition.switch(pair, data, regions=[{"u": (1.5, 9.0)}, None], hold=3)
    late = np.array([np.all(u[max(0, t - 3) : t + 1] >= 1.5) for t in range(len(u))])
    np.testing.assert_allclose(held.value[0][:, 0], loop(data, late), atol=1e-5)


def test_one_model_alone_is_its_free_run():
    data, network = part("low"), model("low")
    alone = jnx.partition.switch([network], data).value
    run = jnx.simulate(network, data).value
    np.testing.assert_allclose(alone[0], run[0], rtol=1e-12)
    np.testing.assert_array_equal(alone.scored[0], run.scored[0])


def test_the_limits_of_the_model_that_acts_hold():
    """The low side's inputs and outputs in 0.4 to 0.7 and 1 to 1.5, the other free."""
    data = both()
    low = dataclasses.replace(
        model("low"), low=jnp.array([0.4, 1.0]), high=jnp.array([0.7, 1.5])
    )
    limited = jnx.models.hold_to_range(low, 0.1, outside="hold")
    regions = [{"u": (-1.0, 1.0)}, None]
    pair = [limited, model("high")]
    found = jnx.partition.switch(pair, data, regions=regions).value
    u, y = data.records[0].u[:, 0], np.zeros(120)
    side = u > 1.0
    for t in range(1, 120):
        a, b = SLOPES["high" if side[t] else "low"]
        y[t] = a * y[t - 1] + b * (u[t - 1] if side[t] else np.clip(u[t - 1], 0.4, 0.7))
    np.testing.assert_allclose(found.computed[0][:, 0], y, atol=1e-5)
    edge = np.where(side, y, np.clip(y, 0.95, 1.55))
    edge[0] = 0.0
    np.testing.assert_allclose(found[0][:, 0], edge, atol=1e-5)
    assert found.held[0].any() and not found.held[0][side].any()
    np.testing.assert_array_equal(found.held[0], found[0] != found.computed[0])


def test_wrong_use_says_what_to_do():
    data, network = part("low"), model("low")
    with pytest.raises(SpecError, match="by priority"):
        jnx.partition.switch([], data)
    with pytest.raises(SpecError, match="no channel 'v'"):
        jnx.partition.switch([network, network], data, regions=[{"v": (0, 1)}, None])
    with pytest.raises(SpecError, match="hold"):
        jnx.partition.switch([network], data, hold=-1)
