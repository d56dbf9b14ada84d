"""Pools without feedback, by memory."""

import dataclasses

import nested_problems as problems
import numpy as np
import pytest

from jaxnarx.partition.closed_form.profile import DataProfile
from jaxnarx.partition.closed_form.terms import (
    Memory,
    choose_scheduling,
    linear_pool,
    product_pool,
)
from jaxnarx.regressors import LowPass

LOOK = DataProfile(
    "y", (None, (0.0, 1.0)), (3, 0), rise=4.0, memory=20, reach=20, every=1
)


def test_lags_begin_a_step_before_the_dead_time_and_recent_ones_stay():
    memory = Memory(2, (0, 1, 2, 4))
    assert memory.lags_behind(5) == [3, 5, 7, 11]
    assert memory.choose_lags(5) == [0, 2, 3, 5, 7, 11]
    assert memory.choose_lags(46) == [0, 2, 4, 44, 46, 48, 52]
    assert memory.choose_lags(1) == memory.choose_lags(0) == [0, 2, 4, 8]


TIMES = (2.5, 10.0, 40.0, 160.0)


def test_filters_that_records_are_long_enough_for():
    """A quarter of the longest record, of 190 samples of 0.1 s: 4.75 s."""
    data = problems.records()
    times = [f.time_constant for f in Memory(1, (0,), TIMES).filters(data)]
    assert times == [0.25, 1.0, 4.0]
    assert Memory(4, (0,), TIMES).filters(data) == [LowPass(1.0), LowPass(4.0)]
    assert Memory(1).filters(data) == []


def test_a_linear_pool_has_the_constant_lags_and_filters():
    memory = Memory(1, (0, 2), (10.0,))
    names = linear_pool(problems.records(), LOOK, memory).names
    lags = ["a[t]", "a[t-1]", "a[t-2]", "a[t-4]", "b[t]", "b[t-2]"]
    assert names == ["1", *lags, "lp(a, 1 s)[t]", "lp(b, 1 s)[t]"]


def products(profile: DataProfile, degree: int) -> list[str]:
    """Of three lags."""
    memory = Memory(1, (0, 1, 2))
    linear = linear_pool(problems.records(), profile, memory)
    pool = product_pool(linear, profile, memory, degree)
    assert pool.names[: len(linear)] == linear.names
    assert len(set(pool.names)) == len(pool)
    return pool.names[len(linear) :]


def test_products_are_of_inputs_with_many_levels_within_one_lag():
    assert products(LOOK, 2) == ["a[t-3]^2", "a[t-4]^2"]
    assert products(LOOK, 3) == ["a[t-3]^2", "a[t-4]^2", "a[t-3]^3", "a[t-4]^3"]
    both = dataclasses.replace(LOOK, levels=(None, None))
    assert set(products(both, 2)) == {
        "a[t-3]^2",
        "a[t-3]*b[t-1]",
        "b[t-1]^2",
        "a[t-4]^2",
        "a[t-4]*b[t-2]",
        "b[t-2]^2",
    }


def test_a_long_dead_time_takes_no_recent_product_away():
    late = dataclasses.replace(LOOK, dead_time=(46, 0), levels=(None, None))
    found = products(late, 2)
    assert {"a[t-46]*b[t-1]", "a[t-1]*b[t-1]", "a[t-2]^2", "b[t-1]^2"} <= set(found)


def test_binary_inputs_alone_have_no_products():
    binary = dataclasses.replace(LOOK, levels=((0.0, 1.0), (0.0, 1.0)))
    assert products(binary, 2) == []


def test_every_product_has_its_parts():
    """Else coefficients of centred variables would not be ones of the network."""
    memory = Memory(1)
    profile = dataclasses.replace(LOOK, levels=(None, None))
    linear = linear_pool(problems.records(), profile, memory)
    rows = product_pool(linear, profile, memory, 3).factor.tolist()
    known = {tuple(sorted(row)) for row in rows}
    for row in rows:
        for place in range(3):
            part = [v for n, v in enumerate(row) if n != place]
            assert tuple(sorted([0, *part])) in known


def test_scheduling_is_every_input_and_of_few_inputs_slow_ones():
    data = problems.records()
    table = choose_scheduling(data, LOOK, Memory(1, (0, 1, 2), TIMES))
    assert table.entries[:2] == ((0, 4, None), (1, 2, None))
    assert table.entries[2:] == ((0, 0, LowPass(1.0)), (0, 0, LowPass(4.0)))
    plain = choose_scheduling(data, LOOK, Memory(1, (0,)))
    assert plain.rows == ((0, 2), (1, 0)) and not plain.filters


def test_lags_end_at_the_reach():
    assert Memory.of(2, 9, 20).lags == (0, 1, 2, 3, 4)
    assert Memory.of(1, 0, 20).lags == (0, 1, 2) and Memory.of(5, 0, 20).lags == (0,)
    assert max(Memory.of(1, 1000, 20).lags) == 8


@pytest.mark.parametrize(("step", "memory"), [(1, 4), (1, 100), (4, 100), (2, 3000)])
def test_filters_cover_the_memory(step, memory):
    """A first-order lag is over after three time constants."""
    times = Memory.of(step, 10, memory).times
    assert 3 * times[-1] * step >= memory and len(times) >= 4
    assert len(times) == 4 or 3 * times[-2] * step < memory
    np.testing.assert_allclose(np.divide(times[1:], times[:-1]), 4.0)


def test_words():
    assert str(Memory(3, (0,), TIMES)) == "lags by 3, 4 filters"
    assert str(Memory(3, (0,))) == "lags by 3"
