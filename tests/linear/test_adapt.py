"""Adaptation of a running network: what it converges to, and what keeps it safe."""

from typing import Any

import equinox as eqx
import numpy as np
import pytest
from adapt_problems import TIME, dataset, excitation, one_model, plant, two_models

from jaxnarx.confidence import domain, fit_domain
from jaxnarx.errors import DataError, SpecError
from jaxnarx.linear._adapt import adapt
from jaxnarx.models import Network
from jaxnarx.settings.least_squares import Recursive


def moved(network: Network, share: float) -> Network:
    """The same network, its coefficients larger by this share."""
    where = lambda n: n.models[0].local.coefficient  # noqa: E731
    return eqx.tree_at(where, network, where(network) * (1.0 + share))


def physical(network: Network) -> np.ndarray:
    """Constant, u[t-1] and y[t-1]."""
    return np.array([c for _, c in network.equations()[0]["terms"]])


@pytest.fixture(scope="module")
def steady():
    """Data of a plant that does not change, with their batch least squares."""
    u = excitation()
    data = dataset(u, plant(u, np.full(TIME, 0.5), noise=0.02))
    return data, one_model(data)


def test_a_steady_plant_leads_to_batch_least_squares(steady):
    data, batch = steady
    method = Recursive(forgetting=1.0, start=1e8, excitation=0.0, growth=1e9)
    found = adapt(moved(batch, 0.3), data, method)
    assert found.status_name == "ok"
    # The start's share is 1e-8 over 1,200 samples.
    np.testing.assert_allclose(physical(found.value), physical(batch), atol=1e-9)
    assert found.stats["samples"].tolist() == [TIME - 1]


def test_follows_a_gain_that_jumps(steady):
    u = excitation()
    gain = np.where(np.arange(TIME) < 600, 0.5, 0.8)
    data = dataset(u, plant(u, gain, noise=0.005))
    _, network = steady
    for regressors in ("measured", "simulated"):
        method = Recursive(forgetting=0.97, regressors=regressors)
        found = adapt(network, data, method)
        assert found.status_name == "ok"
        # Thirty samples of memory against noise of 0.005.
        np.testing.assert_allclose(physical(found.value)[1:], [0.8, 0.8], atol=0.02)
        windows = found.stats["rmse"][:, 0]
        assert windows[-1] < 0.2 * found.stats["rmse_start"][-1, 0]
        assert windows[5] < 2 * windows[1]


def test_a_constant_input_neither_moves_nor_winds_up(steady):
    u = excitation()
    u[300:900] = 0.4
    data = dataset(u, plant(u, np.full(TIME, 0.5), noise=0.002))
    _, network = steady
    found = adapt(network, data, Recursive(forgetting=0.98))
    gain = found.stats["history"][0][:, 0, 1]
    own = float(network.gain[0] / network.gain[1])
    # Six hundred samples of one level: windows 3 to 8. The noise allows a few percent.
    np.testing.assert_allclose(gain[2:9], 0.5 * own, rtol=0.05)
    np.testing.assert_allclose(gain[9:], 0.5 * own, rtol=0.05)
    assert found.stats["held"][0] > 100 and found.stats["restarts"][0] == 0
    # Without the bound the covariance grows by 1/0.98 a sample, 2e5 times in all.
    loose = adapt(network, data, Recursive(forgetting=0.98, largest_trace=1e12))
    wound = loose.stats["history"][0][:, 0, 1]
    assert loose.stats["held"][0] == 0
    assert np.ptp(wound) > 2 * np.ptp(gain)


def test_rests_where_nothing_is_to_be_learnt(steady):
    data, network = steady
    quiet = dataset(np.zeros(TIME), np.zeros(TIME))
    method = Recursive(forgetting=0.9, dead_zone=0.5)
    found = adapt(network, quiet, method)
    assert found.status_name == "unidentifiable"
    assert found.stats["frozen"].tolist() == [TIME - 1]
    np.testing.assert_array_equal(physical(found.value), physical(network))


def test_a_window_that_makes_the_error_grow_is_undone(steady):
    u = excitation()
    y = plant(u, np.full(TIME, 0.5))
    _, network = steady
    # A sensor that jumps for some samples at the end of window 5.
    broken = y.copy()
    broken[570:600] += 40.0 * (np.arange(30) % 2)
    data = dataset(u, broken)
    method = Recursive(forgetting=0.9, start=1e3)
    safe = adapt(network, data, method)
    assert safe.status_name == "no_improvement" and "undone" in safe.detail
    assert safe.stats["restarts"][0] >= 1
    bad = np.flatnonzero(safe.stats["undone"][:, 0])[0]
    history = safe.stats["history"][0]
    # Back to those before the window.
    np.testing.assert_allclose(history[bad], history[bad - 1])
    np.testing.assert_allclose(physical(safe.value)[1:], [0.5, 0.8], atol=1e-3)


def weighted(network, data, phi):
    """Batch least squares of one local model with its validity as the weight."""
    u, y = data.records[0].u[:, 0], data.records[0].y[:, 0]
    x = np.column_stack([np.ones(TIME - 1), u[:-1], y[:-1]])
    return np.linalg.solve(x.T @ (x * phi[:, None]), x.T @ (phi * y[1:]))


@pytest.fixture(scope="module")
def bent():
    """A plant whose gain differs by the sign of its input."""
    u = excitation(seed=4)
    gain = np.where(np.roll(u, 1) > 0, 0.8, 0.3)
    data = dataset(u, plant(u, gain, noise=0.01))
    return data, two_models(data)


def validities(data):
    z = (data.records[0].u[:-1, 0] + 1.0) / 2.0
    weight = np.exp(-0.5 * ((z[:, None] - np.array([0.0, 1.0])) / 0.15) ** 2)
    return weight / weight.sum(axis=1, keepdims=True)


PLAIN: dict[str, Any] = {
    "forgetting": 1.0,
    "start": 1e6,
    "excitation": 0.0,
    "growth": 1e9,
}


def test_every_local_model_on_its_own_is_weighted_least_squares(bent):
    data, network = bent
    found = adapt(network, data, Recursive(estimation="local", **PLAIN))
    theta = np.asarray(found.value.models[0].local.coefficient)
    phi = validities(data)
    for m in range(2):
        expected = weighted(network, data, phi[:, m])
        # The start's share is 1e-6 over a hundred samples.
        np.testing.assert_allclose(theta[m], expected, atol=1e-6)


def test_chosen_models_only_and_jointly(bent):
    data, network = bent
    local: dict[str, Any] = PLAIN | {"estimation": "local"}
    alone = adapt(network, data, Recursive(models=(1,), **local)).value
    both = adapt(network, data, Recursive(**local)).value
    one, all_ = (np.asarray(n.models[0].local.coefficient) for n in (alone, both))
    np.testing.assert_array_equal(one[0], 0.0)
    np.testing.assert_allclose(one[1], all_[1], rtol=1e-9)
    joint = adapt(network, data, Recursive(**PLAIN)).value
    u, y = data.records[0].u[:, 0], data.records[0].y[:, 0]
    x = np.column_stack([np.ones(TIME - 1), u[:-1], y[:-1]])
    wide = np.concatenate([x * validities(data)[:, [m]] for m in range(2)], axis=1)
    expected = np.linalg.lstsq(wide, y[1:], rcond=None)[0]
    # The start's share is 1e-6 of the weakest direction's few samples.
    theta = np.asarray(joint.models[0].local.coefficient)
    np.testing.assert_allclose(theta.reshape(-1), expected, atol=1e-5)


def test_missing_samples_and_records_count_for_nothing(steady):
    data, network = steady
    u, y = data.records[0].u[:, 0], data.records[0].y[:, 0].copy()
    y[400:403] = np.nan
    holes = dataset([u[:600], u[600:]], [y[:600], y[600:]], missing="mask")
    found = adapt(network, holes, Recursive(**PLAIN))
    # One sample to begin each record; three missing, and the one after them.
    assert found.stats["samples"].tolist() == [TIME - 2 - 4]
    np.testing.assert_allclose(physical(found.value)[1:], [0.5, 0.8], atol=0.05)


def test_impossible_requests(steady):
    data, network = steady
    with pytest.raises(SpecError, match="no local model 3"):
        adapt(network, data, Recursive(models=(3,)))
    impossible: tuple[tuple[dict[str, Any], str], ...] = (
        ({"forgetting": 1.5}, "forgetting"),
        ({"forgetting": 0}, "forgetting"),
        ({"growth": 1.0}, "growth"),
        ({"window": 0}, "window"),
        ({"models": (0, 0)}, "models"),
        ({"start": 0.0}, "start"),
    )
    for settings, field in impossible:
        with pytest.raises(SpecError) as caught:
            Recursive(**settings)
        assert caught.value.field == field
    with pytest.raises(DataError, match="no sample can be used"):
        adapt(network, dataset(np.zeros(1), np.zeros(1)), Recursive())


def test_nothing_is_learnt_outside_of_the_domain(steady):
    data, network = steady
    network = fit_domain(network, data)
    u = excitation(seed=9)
    u[600:900] *= 3.0
    strange = dataset(u, plant(u, np.where(np.abs(u) > 1.0, 0.9, 0.5), noise=0.005))
    safe = adapt(network, strange, Recursive(start=1.0))
    beyond = np.count_nonzero(domain(network, strange).value.index[0] > 1)
    assert safe.stats["outside"] == beyond > 100
    np.testing.assert_allclose(physical(safe.value)[1:], [0.5, 0.8], atol=0.03)
    far = dataset(5.0 + u, plant(u, np.full(TIME, 0.5)))
    none = adapt(network, far, Recursive())
    assert none.status_name == "unidentifiable" and "largest_index" in none.detail
    led = adapt(network, strange, Recursive(start=1.0, largest_index=None))
    assert led.stats["outside"] == 0
    assert led.stats["rmse"].max() > 5 * safe.stats["rmse"].max()


def test_slots_without_a_term_do_not_wind_up(bent):
    """A model with fewer terms than its neighbour has slots that nothing excites: they
    count for nothing in the bound on the covariance."""
    data, network = bent
    where = lambda n: n.models[0].local.used  # noqa: E731
    fewer = eqx.tree_at(where, network, where(network).at[0, 2].set(False))
    method = Recursive(estimation="local", forgetting=0.98, start=10.0)
    found = adapt(fewer, data, method)
    theta = np.asarray(found.value.models[0].local.coefficient)
    assert theta[0, 2] == np.asarray(network.models[0].local.coefficient)[0, 2]
    assert found.stats["held"][0] < 0.5 * found.stats["samples"][0]


def test_records_of_different_length_make_no_empty_windows(steady):
    data, network = steady
    u, y = data.records[0].u[:, 0], data.records[0].y[:, 0]
    parts = dataset([u[:300], u[300:360]], [y[:300], y[300:360]])
    found = adapt(network, parts, Recursive(window=50))
    assert found.stats["rmse"].shape == (8, 1) and found.stats["window"] == 50
    assert np.all(found.stats["rmse"] > 0)
