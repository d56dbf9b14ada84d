"""Methods of one's own go wherever the package's go."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import jaxnarx as jnx
from jaxnarx.errors import DataError, SpecError
from jaxnarx.models import Gaussians
from jaxnarx.selection import own


@dataclasses.dataclass(frozen=True)
class Lasso:
    """The terms whose coefficient an absolute penalty leaves, the largest first.

    Coordinate descent on columns of unit norm.
    """

    penalty: float
    sweeps: int = 200

    def __call__(self, columns, output, weight):
        x = columns * np.sqrt(weight)
        x = x / np.linalg.norm(x, axis=1, keepdims=True)
        y, theta = output * np.sqrt(weight), np.zeros(len(x))
        for _ in range(self.sweeps):
            for j in range(len(x)):
                part = x[j] @ (y - theta @ x) + theta[j]
                theta[j] = np.sign(part) * max(abs(part) - self.penalty, 0.0)
        order = np.argsort(-np.abs(theta))
        return order[: np.count_nonzero(theta)]


@dataclasses.dataclass(frozen=True)
class RandomCentres:
    """Gaussians about samples drawn at random."""

    models: int
    seed: int = 0
    width: float = 0.3

    def __call__(self, scheduling, columns, output, weight):
        good = np.flatnonzero(weight > 0)
        drawn = np.random.default_rng(self.seed).choice(good, self.models, False)
        centre = jnp.asarray(scheduling[:, drawn].T)
        return Gaussians(centre, jnp.full_like(centre, np.log(self.width)))


def data(rows: int = 240) -> jnx.Dataset:
    """y(t) = 0.5 y(t-1) + u(t-1) + 0.3 u(t-1)^2 with little noise."""
    rng = np.random.default_rng(4)
    u, y = rng.uniform(-1, 1, rows), np.zeros(rows)
    for t in range(1, rows):
        y[t] = 0.5 * y[t - 1] + u[t - 1] + 0.3 * u[t - 1] ** 2
    names: dict[str, Any] = {"inputs": ["u"], "outputs": ["y"], "sample_time": 1.0}
    return jnx.Dataset.from_arrays(u, y + 0.01 * rng.normal(size=rows), **names)


def pool(degree: int = 2) -> jnx.Pool:
    lags: dict[str, Any] = {"input_lags": (1, 2, 3), "output_lags": (1, 2)}
    return jnx.polynomial_pool(data().channels, degree=degree, **lags)


def test_own_selection_and_own_partition_go_through_every_verb(tmp_path):
    chosen = jnx.select(pool(), data(), Lasso(0.4))
    assert chosen.is_okay and {"y[t-1]", "u[t-1]"} <= set(chosen.value.names)
    assert chosen.stats["candidates"] == len(pool())
    one = jnx.grow(chosen.value, data(), jnx.Global()).value
    np.testing.assert_allclose(  # one least-squares problem in two ways
        chosen.value.coefficient[0], one.models[0].local.coefficient[0], rtol=1e-8
    )
    given = jnx.Given(RandomCentres(3), scheduling="u[t-1]")
    grown = jnx.grow(chosen.value, data(), given)
    assert len(grown.value.regions(0)) == 3
    fit = jnx.refine(grown.value, data(), jnx.SimulationError(max_steps=3))
    jnx.save(fit.value, tmp_path / "own.safetensors")
    loaded = jnx.load(tmp_path / "own.safetensors")
    assert "y" in jnx.report(loaded, data()).table


def test_a_growth_goes_on_from_an_own_partition():
    start = jnx.Given(RandomCentres(2), scheduling="u[t-1]")
    method = jnx.Lolimot("u[t-1]", max_models=3, criterion="none")
    grown = jnx.grow(pool(1), data(), method, start=start)
    assert grown.stats["models"][0].tolist() == [2, 3]


def test_what_an_own_method_returns_is_checked(monkeypatch):
    with pytest.raises(DataError, match="chose no term of y"):
        jnx.select(pool(), data(), lambda columns, output, weight: [])
    for wrong in ([0.5], [-1], [10**6], [[1]]):
        with pytest.raises(SpecError, match="rows of its"):
            jnx.select(pool(), data(), lambda *_, wrong=wrong: wrong)
    nothing = jnx.Given(lambda *_: None, scheduling="u[t-1]")
    with pytest.raises(SpecError, match="returns a validity function"):
        jnx.grow(pool(1), data(), nothing)
    flat = jnx.Given(RandomCentres(2), scheduling=("u[t-1]", "u[t-2]"))
    assert len(jnx.grow(pool(1), data(), flat).value.regions(0)) == 2
    with pytest.raises(SpecError, match="not a selection"):
        few = jnx.select(pool(1), data(), lambda *_: [1]).value
        jnx.select(few, data(), lambda *_: [1])
    monkeypatch.setattr(own, "LARGEST", 1)
    with pytest.raises(SpecError, match="narrow the pool first"):
        jnx.select(pool(), data(), lambda *_: [1])
