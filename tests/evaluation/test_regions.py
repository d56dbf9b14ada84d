"""A report of a real network: the contract with simulation, and its partition."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

from jaxnarx.data import Channel, Channels, Dataset, Record
from jaxnarx.evaluation import describe_partition, report
from jaxnarx.models import Gaussians, LocalModels, Network, OutputModel
from jaxnarx.regressors import Variables

CHANNELS = Channels((Channel("speed", "rpm"),), (Channel("NOx", "ppm"),))


@pytest.fixture(scope="module")
def network() -> Network:
    """y(t) = 0.5 y(t-1) + 0.1 u(t-1), in two local models that agree."""
    local = LocalModels(
        factor=jnp.array([[1], [2]]),
        index=jnp.array([[0, 1], [0, 1]]),
        used=jnp.ones((2, 2), bool),
        coefficient=jnp.array([[0.1, 0.5], [0.1, 0.5]]),
    )
    model = OutputModel(
        scheduling=Variables(((0, 1),)),
        offset=jnp.array([1000.0]),
        span=jnp.array([2000.0]),
        validity=Gaussians(jnp.array([[0.25], [0.75]]), jnp.log(jnp.full((2, 1), 0.2))),
        active=jnp.ones(2, bool),
        local=local,
    )
    return Network(
        channels=CHANNELS,
        modelled=(0,),
        variables=Variables(((0, 1), (1, 1))),
        models=(model,),
        gain=jnp.ones(2),
        lower=jnp.array([0.0]),
        upper=jnp.array([1000.0]),
        low=jnp.array([1000.0, 0.0]),
        high=jnp.array([3000.0, 800.0]),
        sample_time=jnp.asarray(0.1),
    )


def record(seed, name):
    u = np.random.default_rng(seed).uniform(1000, 3000, (40, 1))
    y = np.full((40, 1), 300.0)
    for t in range(1, 40):
        y[t] = 0.5 * y[t - 1] + 0.1 * u[t - 1]
    return Record(u, y, np.ones((40, 2), bool), name)


def test_partition_is_in_the_units_of_the_scheduling_variables(network):
    got = describe_partition(network, start=network)["NOx"]
    assert got["scheduling"] == ["speed[t-1]"] and got["ranges"] == [(1000.0, 3000.0)]
    centres = [m["centre"][0] for m in got["after"]]
    np.testing.assert_allclose(centres, [1500, 2500], rtol=1e-12)
    np.testing.assert_allclose([m["width"] for m in got["before"]], 400, rtol=1e-12)


def test_cloud_is_the_lagged_measurements_that_are_valid(network):
    one, two = record(1, "a"), record(2, "b")
    two.valid[7, 0] = False
    data = Dataset((one, two), CHANNELS, 0.1)
    cloud = describe_partition(network, data=data)["NOx"]["cloud"]
    # speed[t-1] at samples 1 to 39 of each record, less the masked one.
    expected = np.concatenate([one.u[:-1], np.delete(two.u[:-1], 7, axis=0)])
    np.testing.assert_array_equal(cloud, expected)


def test_a_true_model_scores_perfectly_in_every_mode(network, tmp_path):
    data = Dataset((record(1, "a"), record(2, "b")), CHANNELS, 0.1)
    got = report(network, data)
    for mode in got.modes:
        row = got.pooled("NOx", mode=mode)
        assert row.nrmse == pytest.approx(0, abs=1e-12) and row.status == "ok"
    assert got.pooled("NOx", mode="10 steps").samples < got.pooled("NOx").samples
    json.dumps(got.to_dict(), allow_nan=False)
    got.to_html(tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "speed<sub>t−1</sub> about 1500 ± 400" in page
    assert "Operating regions" in page


def test_a_report_says_whether_the_model_forgets_its_past(network, tmp_path):
    data = Dataset((record(1, "a"), record(2, "b")), CHANNELS, 0.1)
    got = report(network, {"train": data, "test": data[:1]}, horizons=())
    values = json.loads(json.dumps(got.to_dict()["stability"], allow_nan=False))
    assert values["contracts"] == got.stability.contracts
    assert got.notes[-1] == f"Stability on test: {values['summary']}"
    assert [p["model"] for p in values["poles"]] == [1, 2, None]
    # The record's samples less the history: of the main part alone.
    assert values["bounds"][-1]["of"] == len(data.records[0]) - network.history
    got.to_html(tmp_path / "r.html")
    assert "<h2>Stability</h2>" in (tmp_path / "r.html").read_text(encoding="utf-8")
    bare = report(network, data, horizons=(), stability=False)
    assert bare.stability is None and not any("Stability" in n for n in bare.notes)
