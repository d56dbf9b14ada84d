"""Selections in batches: equal to one by one, in one program, and the bootstrap."""

import common
import jax
import numpy as np
import pytest
from test_select import pool, record, rows_of

from jaxnarx.errors import SpecError
from jaxnarx.methods import ForwardOLS, StepwiseF
from jaxnarx.selection import (
    many,
    select,
    select_each,
    select_weighted,
    selection_frequency,
)

FORWARD = ForwardOLS(max_terms=8)
STEPWISE = StepwiseF(max_terms=12, f_in=5.0, f_out=4.0, exchange=False)


@pytest.fixture(scope="module")
def data():
    return common.from_rows(rows_of("records"))


@pytest.fixture(scope="module")
def weightings(data):
    rng = np.random.default_rng(2)
    return [[rng.random(len(r)) for r in data] for _ in range(5)]


def assert_same(one, other):
    assert one.value.names == other.value.names
    assert one.status_name == other.status_name
    size = one.value.size()
    for name in ("coefficient", "sse", "err"):
        np.testing.assert_allclose(
            getattr(one.value, name)[:, :size],
            getattr(other.value, name)[:, :size],
            rtol=1e-8,
            atol=1e-11,
        )


@pytest.mark.parametrize("method", [FORWARD, STEPWISE], ids=["forward", "stepwise"])
def test_weightings_at_once_are_one_by_one(data, weightings, method):
    together = select_weighted(pool(), data, method, weightings)
    for solution, weights in zip(together, weightings, strict=True):
        assert_same(solution, select(pool(), data, method, weights=weights))


def test_little_memory_changes_nothing(data, weightings, monkeypatch):
    whole = select_weighted(pool(), data, FORWARD, weightings)
    rows = sum(len(r) for r in data)
    # room for the directions of two lanes: three calls, the last one filled up
    monkeypatch.setattr(many, "MEMORY", 2.5 * 8 * 8 * rows)
    for a, b in zip(
        whole, select_weighted(pool(), data, FORWARD, weightings), strict=True
    ):
        assert_same(a, b)


def test_a_weighting_without_enough_rows_is_that_alone(data, weightings):
    few = [np.zeros(len(r)) for r in data]
    few[0][30:34] = 1.0
    good, bad = select_weighted(pool(), data, FORWARD, [weightings[0], few])
    assert good.is_okay
    assert bad.status_name == "too_short" and "rows with weight" in bad.detail
    assert bad.value.size() == 0


def test_engines_of_different_lengths_share_one_program():
    datasets = [
        common.from_rows([record("white", n, seed=n)]) for n in (300, 260, 300, 281)
    ]
    many_ = select_each(pool(), datasets, FORWARD)
    for solution, one in zip(many_, datasets, strict=True):
        assert_same(solution, select(pool(), one, FORWARD))
    again = lambda: select_each(pool(), datasets[::-1], FORWARD)  # noqa: E731
    assert common.compilations(again) == 0


def test_a_bad_engine_is_one_bad_entry():
    good = common.from_rows([record("white")])
    constant = record("white").copy()
    constant[:, 2] = 4.0
    bad = common.from_rows([constant])
    first, second = select_each(pool(), [bad, good], FORWARD)
    assert first.status_name == "crashed" and "constant" in first.detail
    assert first.value.terms() == []
    assert second.value.names == select(pool(), good, FORWARD).value.names


def test_the_bootstrap_draws_records(data):
    found = selection_frequency(
        pool(), data, FORWARD, key=jax.random.key(0), replicates=20, block=40
    )
    table = found.table()
    assert table["1"] == pytest.approx(1.0)
    assert table["y[t-1]"] == pytest.approx(1.0)
    # every replicate chooses eight terms
    assert sum(table.values()) == pytest.approx(8.0)
    assert list(table.values()) == sorted(table.values(), reverse=True)
    again = selection_frequency(
        pool(), data, FORWARD, key=jax.random.key(0), replicates=20, block=40
    )
    np.testing.assert_array_equal(found.share, again.share)


def test_one_record_cannot_be_drawn_anew():
    one = common.from_rows(rows_of("white"))
    with pytest.raises(SpecError, match="block"):
        selection_frequency(pool(), one, FORWARD, key=jax.random.key(0))


def test_lanes_of_several_outputs_stay_apart(data, weightings):
    both = pool(("y", "w"))
    together = select_weighted(both, data, FORWARD, weightings[:2])
    for solution, weights in zip(together, weightings, strict=False):
        alone = select(both, data, FORWARD, weights=weights).value
        for o in range(2):
            assert solution.value.terms(o) == alone.terms(o)
