"""What the free run owes to each input: inputs withheld, oracles by hand."""

import dataclasses
from functools import cache

import common
import jax
import numpy as np
import pytest
from common import Part

import jaxnarx as jnx
from jaxnarx.errors import SpecError
from jaxnarx.evaluation import relevance
from jaxnarx.evaluation._relevance import _permute_blocks

network = cache(common.named)
data = cache(lambda: common.dataset((150, 150)))


def held(rows: jnx.Dataset, column: int) -> jnx.Dataset:
    """By hand: that input is its mean everywhere."""
    mean = np.concatenate([r.u for r in rows]).mean(axis=0)[column]
    records = []
    for r in rows:
        u = r.u.copy()
        u[:, column] = mean
        records.append(dataclasses.replace(r, u=u))
    return dataclasses.replace(rows, records=tuple(records))


def test_an_input_held_at_its_mean_is_a_free_run_without_it():
    found = relevance(network("coupled"), data())
    first = jnx.simulate(network("coupled"), data()).value
    for i in range(2):
        run = jnx.simulate(network("coupled"), held(data(), i)).value
        for o in range(2):
            y, p, base = (
                np.concatenate([a[n][2:, o] for n in range(2)])
                for a in ([r.y for r in data()], run.outputs, first.outputs)
            )
            error = np.sqrt(np.sum((y - p) ** 2) / np.sum((y - y.mean()) ** 2))
            assert found.without[i, o] == pytest.approx(error, rel=1e-9)
            spread = np.concatenate([r.y[:, o] for r in data()]).std()
            moved = np.sqrt(np.mean((base - p) ** 2)) / spread
            assert found.moved[i, o] == pytest.approx(moved, rel=1e-9)


def test_an_input_that_no_term_holds_is_worth_nothing():
    alone = common.network(
        [Part([[((0, 1), 0.5), ((0, 3), 0.6)]])], variables=((0, 0), (1, 1), (2, 1))
    )
    found = relevance(alone, data())
    assert found.moved[1, 0] == 0 and found.without[1, 0] == found.complete[0]
    assert found.moved[0, 0] > 0.1
    assert found.order() in ([0, 1], [1, 0])
    assert found.table.splitlines()[1].split() == [
        "without",
        "NRMSE",
        "moves",
        "the",
        "run",
        "by",
    ]


def test_a_permutation_keeps_blocks_and_values():
    places = _permute_blocks(23, 5, jax.random.key(3))
    assert sorted(places.tolist()) == list(range(23))
    starts = np.flatnonzero(np.diff(places) != 1)
    assert len(starts) <= 4 and places.tolist() != list(range(23))
    one, two = (
        relevance(network("coupled"), data(), how="permuted", key=jax.random.key(k))
        for k in (0, 0)
    )
    np.testing.assert_array_equal(one.without, two.without)
    assert one.how == "permuted" and np.all(one.moved > 0)


def test_a_run_that_diverges_has_no_error():
    tight = common.named("coupled", bound=1e-3)
    found = relevance(tight, data())
    assert np.all(np.isinf(found.complete)) and "diverged" in str(found)


def test_wrong_use_is_told():
    with pytest.raises(SpecError, match="needs a key"):
        relevance(network("coupled"), data(), how="permuted")
    with pytest.raises(SpecError, match="at least one sample"):
        relevance(network("coupled"), data(), block=0.01)
    with pytest.raises(SpecError, match="how must be"):
        relevance(network("coupled"), data(), how="median")
