"""Partitions at samples and clusters, and grown ones that are moved at random."""

import dataclasses

import jax
import numpy as np
import problems
import pytest

from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.models import Gaussians
from jaxnarx.partition import grow
from jaxnarx.regressors import polynomial_pool
from jaxnarx.settings import ForwardOLS, Lolimot, Placed
from jaxnarx.simulation import predict

MIDDLES = np.array([[0.0, 0.0], [1.0, 0.2], [0.3, 1.0]])
EACH = 60


@pytest.fixture(scope="module")
def data() -> Dataset:
    """Three clouds of inputs, and a plane of its own over each."""
    rng = np.random.default_rng(4)
    u = np.repeat(MIDDLES, EACH, axis=0) + 0.02 * rng.normal(size=(3 * EACH, 2))
    slope = np.repeat([[1.0, 2.0], [-1.0, 0.5], [3.0, -2.0]], EACH, axis=0)
    y = np.sum(slope * u, axis=1) + np.repeat([0.0, 1.0, -1.0], EACH)
    return Dataset.from_arrays(
        u, y[:, None], inputs=["a", "b"], outputs=["y"], sample_time=1.0
    )


@pytest.fixture(scope="module")
def pool(data):
    return polynomial_pool(data.channels, input_lags=(0,), output_lags=(), degree=1)


_validity = jax.jit(lambda validity, z, active: validity(z, active))


def scaled(network, data) -> np.ndarray:
    """Scheduling variables (rows, dims), scaled."""
    model = network.models[0]
    return (data.records[0].u - np.asarray(model.offset)) / np.asarray(model.span)


def centres(network) -> np.ndarray:
    validity = network.models[0].validity
    assert isinstance(validity, Gaussians)
    return np.asarray(validity.centre)


def assert_least_squares(network, data) -> None:
    """Every local model is that of least squares weighted with its validity."""
    model = network.models[0]
    phi = np.asarray(_validity(model.validity, scaled(network, data).T, model.active))
    u, y = data.records[0].u, data.records[0].y[:, 0]
    x, expected = np.column_stack([np.ones(len(u)), u]), np.zeros(len(u))
    for weight in phi:
        root = np.sqrt(weight)
        own = np.linalg.lstsq(x * root[:, None], y * root, rcond=None)[0]
        expected += weight * (x @ own)
    found = np.asarray(predict(network, data).value[0])[:, 0]
    # columns with a ridge of 1e-12
    np.testing.assert_allclose(found, expected, atol=1e-7)


def test_clusters_are_found_and_fitted(data, pool):
    method = Placed(["a[t]", "b[t]"], max_models=3, seed=3)
    network = grow(pool, data, method).value
    means = scaled(network, data).reshape(3, EACH, 2).mean(axis=1)
    found = centres(network)
    order = [int(np.argmin(np.sum((found - m) ** 2, axis=1))) for m in means]
    assert sorted(order) == [0, 1, 2]
    np.testing.assert_allclose(found[order], means, atol=1e-12)
    assert_least_squares(network, data)


def test_samples_are_drawn_by_the_seed(data, pool):
    drawn = []
    for seed in (1, 1, 2):
        method = Placed(["a[t]", "b[t]"], max_models=3, at="samples", seed=seed)
        network = grow(pool, data, method).value
        centre, z = centres(network), scaled(network, data)
        away = np.abs(centre[:, None] - z[None]).sum(axis=2).min(axis=1)
        np.testing.assert_allclose(away, 0.0, atol=1e-12)
        drawn.append(centre)
    np.testing.assert_array_equal(drawn[0], drawn[1])
    assert np.any(drawn[0] != drawn[2])


@pytest.mark.parametrize("how", ["gaussians", "tree"])
def test_a_grown_partition_is_moved_and_fitted_anew(how):
    data, pool = problems.data(), problems.pool()
    moved = dataclasses.replace(problems.growth("tiny")[how], scatter=0.5, seed=2)
    networks = [grow(pool, data, moved).value for _ in range(2)]
    networks.insert(0, problems.fitted("tiny", how).value)
    first, second, again = (
        [np.asarray(leaf) for leaf in (n.models[0].validity.parameters)]
        for n in networks
    )
    assert all(np.any(a != b) for a, b in zip(first, second, strict=True))
    for a, b in zip(second, again, strict=True):
        np.testing.assert_array_equal(a, b)
    assert_least_squares(networks[1], data)


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: Placed(["a[t]"], max_models=0), "max_models"),
        (lambda: Placed(["a[t]"], k_sigma=0.0), "k_sigma"),
        (lambda: Placed(["a[t]"], seed=-1), "seed"),
        (lambda: Placed(["a[t]"], local=ForwardOLS()), "local"),
        (lambda: Lolimot(["a[t]"], scatter=-1.0), "scatter"),
        (lambda: Lolimot(["a[t]"], scatter=0.5, local=ForwardOLS()), "scatter"),
    ],
)
def test_wrong_settings_are_named(make, field):
    with pytest.raises(SpecError) as caught:
        make()
    assert caught.value.field == field
