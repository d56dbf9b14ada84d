"""A report of a real network: the contract with simulation, and its partition."""

import dataclasses
import json

import jax.numpy as jnp
import numpy as np
import pytest

from jaxnarx.data import Channel, Channels, Dataset, Record
from jaxnarx.evaluation import describe_partition, report
from jaxnarx.models import (
    Boxes,
    Compact,
    Gaussians,
    LocalModels,
    LogSigmoids,
    Network,
    OutputModel,
    SigmoidTree,
)
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
    extents = [r["speed[t-1]"] for r in got["after"]["regions"]]
    np.testing.assert_allclose([e["centre"] for e in extents], [1500, 2500], rtol=1e-12)
    np.testing.assert_allclose([e["width"] for e in extents], 400, rtol=1e-12)
    assert got["before"]["regions"] == got["after"]["regions"]
    assert got["validity"] == "Gaussians"


def test_weights_are_the_networks_own_over_the_range(network):
    phi = describe_partition(network)["NOx"]["after"]["weights"]
    z = np.linspace(0, 1, phi.shape[1])
    bells = np.exp(-0.5 * ((z - np.array([[0.25], [0.75]])) / 0.2) ** 2)
    np.testing.assert_allclose(phi, bells / bells.sum(axis=0), rtol=1e-9)


def test_before_is_shown_only_where_it_divides_the_same_space(network):
    gates = LogSigmoids(jnp.array([0.25, 0.75, 0.9]), jnp.asarray(4.0))
    other = three(network, gates, ((0, 0),))
    assert "before" not in describe_partition(network, start=other)["NOx"]
    model = network.models[0]
    alone = dataclasses.replace(model, active=jnp.array([True, False]))
    single = dataclasses.replace(network, models=(alone,))
    assert "before" not in describe_partition(network, start=single)["NOx"]
    assert describe_partition(single, start=network) == {}


def three(network, validity, scheduling=((0, 1), (1, 1))) -> Network:
    """The network with three local models, a fourth that is not active, and two
    scheduling variables: speed and the past output."""
    model = network.models[0]
    local = LocalModels(
        model.local.factor, *(jnp.repeat(a[:1], 4, axis=0) for a in parts(model.local))
    )
    dims = len(scheduling)
    offset, span = jnp.array([1000.0, 0.0])[:dims], jnp.array([2000.0, 800.0])[:dims]
    active = jnp.arange(4) < 3
    table = Variables(scheduling)
    new = OutputModel(table, offset, span, validity, active, local)
    return dataclasses.replace(network, models=(new,))


def parts(local):
    return local.index, local.used, local.coefficient


LOW = jnp.array([[0.0, 0.0], [0.5, 0.0], [0.5, 0.25], [0.3, 0.3]])
HIGH = jnp.array([[0.5, 1.0], [1.0, 0.25], [1.0, 1.0], [0.6, 0.6]])
PATH = jnp.array([[-1, 0, 0], [1, -1, 0], [1, 1, 0], [0, 0, 1]])
STEEP = jnp.full(3, 9.0)
STRAIGHT = [
    Boxes(LOW, HIGH),
    Compact(LOW, HIGH, jnp.full((4, 2), -9.0)),
    SigmoidTree(
        jnp.array([[1.0, 0.0], [0.0, 1.0], [0.3, 0.1]]),
        jnp.array([0.5, 0.25, 0.0]),
        STEEP,
        PATH,
    ),
]
"""The same three regions by every class that has borders."""


@pytest.mark.parametrize("validity", STRAIGHT, ids=lambda v: type(v).__name__)
def test_regions_are_where_the_weights_lead(network, validity):
    net = three(network, validity)
    got = describe_partition(net)["NOx"]["after"]
    speed, past = np.meshgrid(
        *(np.linspace(0, top, 161) for top in (1, 1)), indexing="ij"
    )
    point = {"speed[t-1]": 1000 + 2000 * speed, "NOx[t-1]": 800 * past}
    assert got["weights"].shape == (3, 161, 161) and len(got["regions"]) == 3
    lead = got["weights"].argmax(axis=0)
    clear = (np.abs(speed - 0.5) > 0.01) & (np.abs(past - 0.25) > 0.01)
    for m, region in enumerate(got["regions"]):
        inside = np.ones_like(clear)
        for name, extent in region.items():
            inside &= point[name] >= extent.get("above", -np.inf)
            inside &= point[name] <= extent.get("below", np.inf)
        np.testing.assert_array_equal((lead == m)[clear], inside[clear])


def test_a_tree_tells_its_gates_and_paths(network):
    got = describe_partition(three(network, STRAIGHT[2]))["NOx"]["after"]
    assert got["path"] == [[-1, 0], [1, -1], [1, 1]]
    gates = [{"speed[t-1]": {"above": 2000.0}}, {"NOx[t-1]": {"above": 200.0}}]
    assert got["gates"] == gates


def test_a_gate_without_direction_tells_the_share_of_its_part(network):
    """As in a sum of networks: 30 % of the output to the leaves on its open side."""
    tree = SigmoidTree(
        jnp.array([[0.0, 0.0], [1.0, 0.0], [0.3, 0.1]]),
        jnp.array([np.log(0.7 / 0.3), 0.5, 0.0]),
        jnp.array([0.0, 9.0, 9.0]),
        PATH,
    )
    got = describe_partition(three(network, tree))["NOx"]["after"]
    share, gate = got["gates"]
    assert share == {"share": {"above": pytest.approx(0.3)}}
    assert gate == {"speed[t-1]": {"above": 2000.0}}
    np.testing.assert_allclose(got["weights"][0], 0.7, rtol=1e-12)


def test_oblique_gates_open_to_their_side(network):
    """3 - 4 r in scaled variables: opens where NOx is small."""
    tree = SigmoidTree(
        jnp.array([[0.6, -0.8], [0.0, 1.0], [0.3, 0.1]]), jnp.zeros(3), STEEP, PATH
    )
    got = describe_partition(three(network, tree))["NOx"]["after"]
    ((text, bound),) = got["gates"][0].items()
    # 0.6 (speed - 1000)/2000 - 0.8 NOx/800 > 0, divided by the largest factor.
    assert text == "-0.3 speed[t-1] + NOx[t-1]"
    assert bound == {"below": pytest.approx(-300.0)}
    first = got["weights"][0]
    assert first[0, -1] > 0.99 and first[-1, 0] < 0.01


def test_log_sigmoids_are_open_at_the_ends(network):
    validity = LogSigmoids(jnp.array([0.25, 0.75, 0.9]), jnp.asarray(4.0))
    got = describe_partition(three(network, validity, ((0, 1),)))["NOx"]["after"]
    extents = [r["speed[t-1]"] for r in got["regions"]]
    assert extents[0] == {"below": 1500.0}
    assert extents[1] == {"above": 1500.0, "below": 2500.0}
    np.testing.assert_allclose(got["weights"][:2, 100], 0.5, atol=1e-6)  # 0.25


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
        row = got.pooled_row("NOx", mode=mode)
        assert row.nrmse == pytest.approx(0, abs=1e-12) and row.status == "ok"
    assert (
        got.pooled_row("NOx", mode="10 steps").samples < got.pooled_row("NOx").samples
    )
    values = json.loads(json.dumps(got.to_dict(), allow_nan=False))
    # Two models of two linear terms: 4 multiplications; the scheduling is scaled, then
    # a scale, a square and its half for each weight; 2 to blend.
    assert values["cost"]["NOx"]["multiplications"] == 4 + (1 + 2 * 3) + 2
    # A JSON report stays small: what only figures need is left out.
    assert set(values["partition"]["NOx"]["after"]) == {"regions"}
    got.to_html(tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "speed<sub>t−1</sub> about 1500 ± 400" in page
    assert "Operating regions" in page


def test_a_report_says_whether_the_model_forgets_its_past(network, tmp_path):
    data = Dataset((record(1, "a"), record(2, "b")), CHANNELS, 0.1)
    got = report(network, {"train": data, "test": data[:1]}, horizons=())
    values = json.loads(json.dumps(got.to_dict()["stability"], allow_nan=False))
    assert values["contracts"] == got.stability.contracts
    assert f"Stability on test: {values['summary']}" in got.notes
    assert [p["model"] for p in values["poles"]] == [1, 2, None]
    # The record's samples less the history: of the main part alone.
    assert values["bounds"][-1]["of"] == len(data.records[0]) - network.history
    got.to_html(tmp_path / "r.html")
    assert ">Stability</h2>" in (tmp_path / "r.html").read_text(encoding="utf-8")
    bare = report(network, data, horizons=(), stability=False)
    assert bare.stability is None and not any("Stability" in n for n in bare.notes)
