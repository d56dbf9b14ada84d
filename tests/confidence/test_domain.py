"""The domain of a network: layers by plain loops, borders by fresh records."""

import dataclasses

import common
import equinox as eqx
import jax
import numpy as np
import pytest

import jaxnarx as jnx
from jaxnarx.confidence.domain_fit import (
    compute_layers,
    feature_rows,
    measure_influence,
    used_inputs,
)
from jaxnarx.data import Dataset
from jaxnarx.errors import ModelFileError, SpecError
from jaxnarx.models import LAYERS
from jaxnarx.regressors import Variables

RECORDS, LENGTH = 6, 400


def drawn(seed: int, records: int = RECORDS, size: float = 1.0) -> list[np.ndarray]:
    """Two inputs that move together, and a third that does nothing."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(records):
        x = rng.normal(size=(LENGTH + 50, 3))
        for t in range(1, len(x)):
            x[t] = 0.8 * x[t - 1] + 0.6 * x[t]
        x = np.tanh(x[50:])
        both = x[:, :1] + 0.2 * x[:, 1:2]
        out.append(size * np.concatenate([both, both * 30 + 3 * x[:, 2:], x[:, 2:]], 1))
    return out


def plant(u: list[np.ndarray], pole: float = 0.9) -> Dataset:
    """y(t) = pole y(t-1) + u1(t-1) + .03 u2(t-1)^2 / 30."""
    outputs = []
    for one in u:
        y = np.zeros((len(one), 1))
        for t in range(1, len(y)):
            drive = one[t - 1, 0] + 0.001 * one[t - 1, 1] ** 2
            y[t] = pole * y[t - 1] + drive
        outputs.append(y)
    return Dataset.from_arrays(
        u, outputs, inputs=["u1", "u2", "u3"], outputs=["y"], sample_time=0.5
    )


def fitted(data: Dataset):
    pool = jnx.polynomial_pool(data.channels, input_lags=[1], output_lags=[1], degree=2)
    chosen = jnx.select(pool, data, jnx.ForwardOLS(max_terms=4)).value
    return jnx.grow(chosen, data, jnx.Global()).value


def same(one, other) -> bool:
    """Whether two networks are equal, looked at on the host."""
    on_host = [jax.tree.map(np.asarray, net) for net in (one, other)]
    return bool(eqx.tree_equal(*on_host, typematch=True))


@pytest.fixture(scope="module")
def data() -> Dataset:
    return plant(drawn(0))


@pytest.fixture(scope="module")
def known(data):
    """A network that knows its domain."""
    return jnx.confidence.fit_domain(fitted(data), data)


def test_the_network_runs_as_before(known, data):
    plain = dataclasses.replace(known, domain=None)
    a, b = (jnx.simulate(n, data).value.outputs for n in (plain, known))
    for one, other in zip(a, b, strict=True):
        np.testing.assert_array_equal(one, other)


def test_only_inputs_that_are_used_count(known):
    assert used_inputs(known) == (0, 1)
    assert jnx.domain(known, plant(drawn(1))).value.channel_names == ("u1", "u2")


def test_of_fresh_records_about_five_in_a_hundred_samples_are_outside(known):
    # 42 records of 400 samples, of which some 40 are independent: the share of five in
    # a hundred, whose border rests on 6 records, is met within a factor of two
    fresh = [plant(drawn(seed)) for seed in range(7, 14)]
    share = np.mean([jnx.domain(known, data).value.outside for data in fresh])
    assert 0.025 < share < 0.1


def test_one_program_serves_other_memories_and_lengths(known, data):
    domain = known.domain
    slower = [
        (s, d, f and dataclasses.replace(f, time_constant=2 * f.time_constant))
        for s, d, f in domain.features.entries
    ]
    other = dataclasses.replace(domain, features=Variables.of(slower))
    rows = feature_rows(domain.features, data, None)
    shorter = rows.select(np.arange(rows.x.shape[1]) < rows.x.shape[1] - 9)
    values, blamed = compute_layers(domain, rows)
    assert common.compilations(lambda: compute_layers(other, shorter)) == 0
    again = compute_layers(other, shorter)
    np.testing.assert_array_equal(again[0], values[:-9])
    np.testing.assert_array_equal(again[1], blamed[:-9])


def test_layers_are_those_of_plain_loops(known):
    fresh = plant(drawn(3, size=1.5))
    domain, found = known.domain, jnx.domain(known, fresh).value
    memory = domain.features.filters[-1].time_constant
    pole = np.exp(-fresh.sample_time / memory)
    low, high, rate = map(np.asarray, (domain.low, domain.high, domain.rate))
    for n, record in enumerate(fresh[:2]):
        u = record.u[:, :2]
        slow = np.array(u)
        for t in range(1, len(u)):
            slow[t] = pole * slow[t - 1] + (1 - pole) * u[t]
        for t in (0, 1, 50, 200):
            x = np.concatenate([u[t], slow[t]])
            unit = (x - np.asarray(domain.middle)) / np.asarray(domain.spread)
            step = np.abs(u[t] - u[t - 1]) if t else np.zeros(2)
            apart = np.asarray(domain.points) - unit * np.asarray(domain.weight)
            layers = [
                np.max(np.abs(u[t] - (high + low) / 2) / ((high - low) / 2)),
                np.max(step / rate),
                np.linalg.norm(np.asarray(domain.whiten) @ unit),
                np.linalg.norm(apart, axis=1).min(),
            ]
            layers = np.array(layers) / np.asarray(domain.border)
            # filters by another recursion
            np.testing.assert_allclose(found.index[n][t], layers.max(), rtol=1e-9)
            assert found.layer[n][t] == layers.argmax()


def test_whitened_features_of_the_training_have_a_covariance_of_one(known, data):
    domain = known.domain
    rows = feature_rows(domain.features, data, None)
    unit = (rows.x - np.asarray(domain.middle)[:, None]) / np.asarray(domain.spread)[
        :, None
    ]
    white = np.asarray(domain.whiten) @ unit
    np.testing.assert_allclose(white @ white.T / white.shape[1], np.eye(4), atol=1e-9)


@pytest.mark.parametrize(
    ("left", "inside", "change"),
    [
        ("range", (), lambda u: u * 2.5),
        ("joint", ("range", "rate"), lambda u: u * np.array([1, -1, 1])),
        ("rate", ("range",), lambda u: (-1.0) ** np.arange(len(u))[:, None] * abs(u)),
    ],
)
def test_layers_are_left_by_what_they_are_made_for(known, left, inside, change):
    data = plant([change(u) for u in drawn(5)])
    rows = feature_rows(known.domain.features, data, None)
    layers = compute_layers(known.domain, rows)[0]
    beyond = dict(zip(LAYERS, np.mean(layers > 1, axis=0), strict=True))
    assert beyond[left] > 0.2
    assert all(beyond[name] < 0.05 for name in inside)
    found = jnx.domain(known, data).value
    worst = found.excursions[0]
    assert worst.index == layers.max()
    assert f"by {worst.layer} of {worst.channel}" in found.table


def test_a_hole_within_everything_else_is_found():
    rng = np.random.default_rng(2)
    u = []
    for _ in range(6):
        angle = np.cumsum(rng.normal(0.02, 0.05, LENGTH)) + rng.uniform(0, 6)
        ring = np.stack([np.cos(angle), 30 * np.sin(angle), 0 * angle], axis=1)
        u.append(ring)
    data = plant(u, pole=0.0)
    net = jnx.confidence.fit_domain(fitted(data), data)
    inside = plant([one * 0.02 for one in u], pole=0.0)
    found = jnx.domain(net, inside).value
    assert np.all(found.index[0][20:] > 1)
    assert set(found.layer[0][20:].tolist()) == {LAYERS.index("distance")}


def test_units_do_not_matter(known, data):
    scale = np.array([1e-3, 200.0, 1.0])
    fresh = drawn(4, size=1.3)

    def other(u):
        parts = plant(u)
        moved = [
            dataclasses.replace(r, u=r.u * scale[None] + np.array([5.0, 0.0, 0.0]))
            for r in parts
        ]
        return dataclasses.replace(parts, records=tuple(moved))

    moved = other(drawn(0))
    net = jnx.confidence.fit_domain(fitted(moved), moved)
    a = jnx.domain(known, plant(fresh)).value.index[0]
    b = jnx.domain(net, other(fresh)).value.index[0]
    # offsets cost digits, and the terms that fit best are others by a little
    np.testing.assert_allclose(a, b, rtol=2e-2)


@pytest.mark.parametrize("pole", [0.5, 0.9])
def test_memory_is_that_of_the_plant(pole):
    data = plant(drawn(0), pole)
    weight, memory = measure_influence(fitted(data), data, (0, 1))
    # a change fades as pole^t: its sum is 1/(1 - pole) times its begin
    assert memory == pytest.approx(1 / (1 - pole), rel=0.15)
    assert weight.max() == 1 and weight.min() > 0


def test_a_constant_input_that_moves_is_far_outside():
    u = drawn(0)
    for one in u:
        one[:, 1] = 7.0
    data = plant(u)
    pool = jnx.polynomial_pool(data.channels, input_lags=[1], output_lags=[1], degree=1)
    net = jnx.grow(pool, data, jnx.Global()).value
    net = jnx.confidence.fit_domain(net, data)
    fresh = drawn(0)
    for one in fresh:
        one[:, 1] = 7.0
    calm = jnx.domain(net, plant(fresh)).value
    assert calm.outside < 0.2
    fresh[0][200:, 1] = 8.0
    found = jnx.domain(net, plant(fresh)).value
    assert np.all(found.index[0][200:] > 100)
    assert found.excursions[0].channel == "u2"


def test_missing_inputs_are_passed_over(known):
    data = plant(drawn(6))
    first, *rest = data.records
    valid = first.valid.copy()
    valid[100:110, 0] = False
    gappy = dataclasses.replace(
        data, records=(dataclasses.replace(first, valid=valid), *rest)
    )
    found = jnx.domain(known, gappy).value.index[0]
    assert np.all(found[100:110] == 0) and np.all(np.isfinite(found))


def test_a_file_keeps_it(known, tmp_path):
    path = tmp_path / "model.safetensors"
    jnx.save(known, path)
    again = jnx.load(path)
    fresh = plant(drawn(3, size=1.5))
    a, b = (jnx.domain(n, fresh).value.index[0] for n in (known, again))
    np.testing.assert_array_equal(a, b)


def test_a_network_of_single_precision_keeps_its_kind_and_its_file(tmp_path):
    records = [
        dataclasses.replace(r, u=r.u.astype(np.float32), y=r.y.astype(np.float32))
        for r in plant(drawn(0))
    ]
    data = dataclasses.replace(plant(drawn(0)), records=tuple(records))
    known = jnx.confidence.fit_error_model(
        jnx.confidence.fit_domain(fitted(data), data), data
    )
    kinds = {str(x.dtype) for x in jax.tree.leaves(known) if x.dtype.kind == "f"}
    assert kinds == {"float32"}
    jnx.save(known, tmp_path / "m")
    assert same(jnx.load(tmp_path / "m"), known)


def test_a_damaged_one_is_refused(known, tmp_path):
    path = tmp_path / "model.safetensors"
    border = jax.device_put(np.ones(len(LAYERS) - 1))
    bad = dataclasses.replace(known.domain, border=border)
    with pytest.raises(ModelFileError, match="the domain's border"):
        jnx.save(dataclasses.replace(known, domain=bad), path)


def test_without_a_domain_it_says_how_to_have_one(known, data):
    with pytest.raises(SpecError, match="fit_domain"):
        jnx.domain(dataclasses.replace(known, domain=None), data)
