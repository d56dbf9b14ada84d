"""Networks by leaving groups out, against least squares of the remaining rows."""

import dataclasses
from functools import cache

import common
import numpy as np
import pytest
from common import A, B, Y

import jaxnarx as jnx
from jaxnarx.confidence import _jackknife as module
from jaxnarx.data import Groups, groups
from jaxnarx.errors import DataError
from jaxnarx.models import Network

TRUE = (0.2, 0.6, -0.2)


@cache
def data():
    return common.dataset()


@cache
def network() -> Network:
    """y(t) = constant, a(t), b(t-1), of all records."""
    terms = [((0, k), value) for k, value in enumerate(TRUE)]
    start = common.network([common.Part([terms])], variables=((A, 0), (B, 1)))
    rules = jnx.SimulationError(train="coefficients", horizons=(), ridge=0.0)
    return jnx.refine(start, data(), rules).value


def coefficients(of: Network) -> np.ndarray:
    return np.asarray(of.models[0].local.coefficient).ravel()[: len(TRUE)]


def least_squares(records) -> np.ndarray:
    """Of scaled signals."""
    gain = np.asarray(network().gain)
    rows = [common.rows_of(data(), n) / gain for n in records]
    phi = [np.column_stack([np.ones(len(r) - 1), r[1:, A], r[:-1, B]]) for r in rows]
    y = [r[1:, Y] for r in rows]
    return np.linalg.lstsq(np.concatenate(phi), np.concatenate(y), rcond=None)[0]


def test_they_scatter_as_the_jackknife_says():
    count = len(data())
    own = Groups(
        tuple(data().names),
        tuple(np.full(len(r), n) for n, r in enumerate(data())),
        True,
    )
    heard = []
    fit = jnx.confidence.jackknife(network(), data(), groups=own, progress=heard.append)
    assert fit.status_name == "ok" and fit.stats["shares"] == [1.0] * count
    assert heard == [{"group": n + 1, "of": count} for n in range(count)]
    every = range(count)
    whole = least_squares(every)
    np.testing.assert_allclose(coefficients(network()), whole, rtol=1e-5)
    for n, one in enumerate(fit.value):
        without = least_squares([k for k in every if k != n])
        expected = whole + np.sqrt(count - 1) * (without - whole)
        np.testing.assert_allclose(coefficients(one), expected, rtol=1e-3, atol=1e-5)
        assert one.channels == network().channels
    jnx.stack([network(), *fit.value])  # of one structure


def test_one_that_would_diverge_stays_nearer(monkeypatch):
    """Feedback of .9 whose training without a group ends at 1.05: the whole move, and
    three halves of it, leave the bounds."""
    terms = [((0, 1), 0.9), ((0, 2), 0.1)]
    stable = common.network([common.Part([terms])], variables=((Y, 1), (A, 0)))

    def wilder(one, *_):
        (model,) = one.models
        local = model.local
        local = dataclasses.replace(local, coefficient=local.coefficient * (1.05 / 0.9))
        model = dataclasses.replace(model, local=local)
        return jnx.Solution(
            dataclasses.replace(one, models=(model,)), jnx.RESULTS.ok, {}
        )

    monkeypatch.setattr(module, "refine", wilder)
    fit = jnx.confidence.jackknife(stable, data())
    assert all(0 < share < 1 for share in fit.stats["shares"])
    assert all(jnx.simulate(one, data()).is_okay for one in fit.value)
    monkeypatch.setattr(module, "HALVINGS", 0)
    lost = jnx.confidence.jackknife(stable, data())
    assert lost.status_name == "diverged" and "without" in lost.detail
    assert all(
        np.array_equal(coefficients(one), coefficients(stable)) for one in lost.value
    )


def test_a_training_that_fails_is_told(monkeypatch):
    def fail(one, *_):
        return jnx.Solution(one, jnx.RESULTS.start_diverged, {})

    monkeypatch.setattr(module, "refine", fail)
    fit = jnx.confidence.jackknife(network(), data())
    assert fit.status_name == "start_diverged" and not any(fit.stats["shares"])
    assert "the training fails without" in fit.detail


def test_one_group_alone_cannot_be_left_out():
    one = Groups(("all",), tuple(np.zeros(len(r), int) for r in data()), True)
    with pytest.raises(DataError, match="none can be left out"):
        jnx.confidence.jackknife(network(), data(), groups=one)
    assert len(groups(data())) > 1
