"""The life of a network: it runs, is refined, saved, loaded and exported."""

import functools
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np

from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.exporters import export
from jaxnarx.models import Network, load, save
from jaxnarx.refinement import refine
from jaxnarx.regressors import Pool, polynomial_pool
from jaxnarx.settings import SimulationError
from jaxnarx.simulation import simulate


@functools.cache
def plant() -> Dataset:
    """y(t) = .6 y(t-1) + u(t-1) + .5 u(t-1)^2 + .2 v(t-1) with little noise; two
    records of 120 samples."""
    rng = np.random.default_rng(7)
    us, ys = [], []
    for _ in range(2):
        u, y = rng.uniform(-1, 1, (120, 2)), np.zeros(120)
        for t in range(1, 120):
            bent = u[t - 1, 0] + 0.5 * u[t - 1, 0] ** 2 + 0.2 * u[t - 1, 1]
            y[t] = 0.6 * y[t - 1] + bent
        us.append(u)
        ys.append(y + 0.01 * rng.normal(size=120))
    names: dict[str, Any] = {"inputs": ["u", "v"], "outputs": ["y"]}
    return Dataset.from_arrays(us, ys, sample_time=0.1, **names)


def pool(degree: int = 1) -> Pool:
    """Candidates for `plant`."""
    lags: dict[str, Any] = {"input_lags": (1, 2), "output_lags": (1,)}
    return polynomial_pool(plant().channels, degree=degree, **lags)


def lives(network: Network, folder: Path) -> None:
    """A network runs, is refined, comes back from its file with the same free run, and
    is exported, or says by a SpecError that it cannot be."""
    data = plant()
    fit = refine(network, data, SimulationError(horizons=(), max_steps=2))
    assert fit.is_okay, fit.detail
    before, after = (_error(n, data) for n in (network, fit.value))
    assert after <= before * (1 + 1e-9), "refinement made the free run worse"
    path = folder / "model.safetensors"
    save(fit.value, path)
    again = load(path)
    assert eqx.tree_equal(again, fit.value), "the model file holds another network"
    runs = (simulate(n, data).value.outputs for n in (again, fit.value))
    for one, two in zip(*runs, strict=True):
        np.testing.assert_array_equal(one, two)
    try:
        found = export(fit.value, data, to=["python"])
    except SpecError as error:
        assert "cannot be exported" in str(error)
    else:
        assert found.difference["python"] <= 1e-10


def _error(network: Network, data: Dataset) -> float:
    """Sum of squares of the free run."""
    run = simulate(network, data)
    assert run.is_okay, run.detail
    parts = zip(data, run.value.outputs, run.value.scored, strict=True)
    return float(sum(np.sum((r.y - y)[scored] ** 2) for r, y, scored in parts))
