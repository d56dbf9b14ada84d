"""Methods of one's own go wherever the package's go."""

import dataclasses
import itertools
import sys
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import jaxnarx as jnx
from jaxnarx.data import Fleet, groups
from jaxnarx.errors import DataError, SpecError
from jaxnarx.identification.candidates import CandidateSearch
from jaxnarx.models import Gaussians
from jaxnarx.partition import ClosedSearch, profile_data
from jaxnarx.partition.stages import free_run_nrmse
from jaxnarx.selection import custom_selector
from jaxnarx.settings import PARTITIONS, PRESETS
from jaxnarx.sweep import IdentificationWork


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


@pytest.fixture
def halving(monkeypatch):
    """The documented example of a partition, registered for a test."""
    folder = Path(__file__).parents[1] / "docs" / "extensions"
    monkeypatch.syspath_prepend(str(folder))
    import halving  # pyright: ignore[reportMissingImports]

    assert len((folder / "halving.py").read_text().splitlines()) <= 40
    yield halving.Halving
    del PARTITIONS["halving"]
    sys.modules.pop("halving")


def bent(rows: int, seed: int) -> jnx.Dataset:
    """y(t) = 0.5 y(t-1) + |u(t-1)|: flat and steep on either side of zero."""
    rng = np.random.default_rng(seed)
    u, y = rng.uniform(-1, 1, rows), np.zeros(rows)
    for t in range(1, rows):
        y[t] = 0.5 * y[t - 1] + max(u[t - 1], 0.0)
    names: dict[str, Any] = {"inputs": ["u"], "outputs": ["y"], "sample_time": 1.0}
    return jnx.Dataset.from_arrays(u, y, **names)


def test_a_documented_partition_is_grown_refined_swept_saved_exported_and_reported(
    halving, tmp_path
):
    train, test = bent(240, 1), bent(200, 2)
    given = jnx.Given("halving", scheduling="u[t-1]")
    grown = jnx.grow(pool(1), train, given).value
    assert len(grown.regions(0)) == halving().models
    one = jnx.grow(pool(1), train, jnx.Global()).value
    fit = jnx.refine(grown, train, jnx.SimulationError(max_steps=5)).value
    errors = [free_run_nrmse(net, test) for net in (one, grown, fit)]
    assert errors[2] < 0.5 * errors[1] < 0.5 * errors[0], errors
    jnx.save(fit, tmp_path / "halves.safetensors")
    loaded = jnx.load(tmp_path / "halves.safetensors")
    assert "y" in jnx.report(loaded, test).table
    assert not jnx.export(loaded, train, to=["python"]).failed
    fleet = Fleet.from_datasets({"a": train, "b": bent(240, 3)}, train=[0])
    method = jnx.Identification(pool=pool(1), grow=given, refine=None)
    done = jnx.run_sweep(IdentificationWork(fleet, method), tmp_path / "run")
    assert done.value.column("status").tolist() == ["ok", "ok"]
    found = jnx.identify(train, preset="quick", groups=groups(train))
    rows = [row for row in found.stats["leaderboard"] if "halving" in row.name]
    assert rows and all(row.status == "ok" for row in rows)
    (least,) = {row.free_run for row in found.stats["leaderboard"] if row.number == 1}
    assert min(row.free_run for row in rows) < 0.2 * least


def test_regions_of_a_partition_have_the_free_run_of_the_closed_form(halving):
    train = bent(240, 1)
    search = ClosedSearch(train, profile_data(train, "y"), groups(train))
    for _ in search.candidates(max_models=1, grown_roots=1):
        pass
    (root,) = search.roots
    (found,) = search.divide_by_partition("halving", halving())
    network = found.network()
    assert found.name.startswith("4 regions") and len(network.regions(0)) == 4
    assert found.free_run < root.free_run
    run = jnx.simulate(network, train).value
    expected = np.concatenate(found.stage.design.runs(found.coefficients()))
    signals = found.stage.design.signals
    scale = signals.gain[1] * signals.spread
    shift = signals.gain[1] * signals.middle
    own = np.asarray(run.computed[0])[-len(expected) :, 0]
    np.testing.assert_allclose(own[60:], shift + scale * expected[60:], atol=1e-9)
    with pytest.raises(SpecError, match="returns a validity function"):
        list(search.divide_by_partition("nothing", lambda *_: None))


def test_a_partition_that_fails_is_a_row_of_the_leaderboard(monkeypatch):
    def none(scheduling, columns, output, weight):
        return None

    monkeypatch.setitem(PARTITIONS._items, "none", none)
    train = bent(240, 1)
    own = CandidateSearch(
        train,
        profile_data(train, "y"),
        groups(train),
        PRESETS["quick"],
        partitions=PARTITIONS.added,
    )
    failed = [row for row, _ in itertools.islice(own, 40) if row.status == "failed"]
    assert [row.name for row in failed] == ["regions, none"]
    assert "returns a validity function" in failed[0].detail


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
    monkeypatch.setattr(custom_selector, "MOST_BYTES", 1)
    with pytest.raises(SpecError, match="narrow the pool first"):
        jnx.select(pool(), data(), lambda *_: [1])
