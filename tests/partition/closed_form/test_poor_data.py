"""Data that no one would choose: every candidate is made, judged and has a model.

Warnings are errors, so none of them divides by zero on its way.
"""

import dataclasses
from typing import Any

import nested_problems as problems
import numpy as np
import pytest
from common import some

import jaxnarx as jnx
from jaxnarx.data import groups
from jaxnarx.partition import ClosedSearch, profile_data


def constant_input(rng, u, y):
    return u * [1.0, 0.0] + [0.0, 3.7], y


def no_input_matters(rng, u, y):
    return rng.normal(size=u.shape), rng.normal(size=y.shape)


def copied_input(rng, u, y):
    return u, u[:, 0]


def binary_output(rng, u, y):
    return u, (y > 0) * 1.0


def constant_output(rng, u, y):
    return u, np.full(len(u), 0.1)


def integrated(rng, u, y):
    return u, 0.01 * np.cumsum(u[:, 0])


def one_input_twice(rng, u, y):
    return u[:, [0, 0]], y


def binary_inputs(rng, u, y):
    return np.sign(u) > 0, y


def huge(rng, u, y):
    return 1e12 + 1e9 * u, 1e-9 * y


def outliers(rng, u, y):
    """Of a binary input, one in a hundred: levels are 0 and 1, the range is not."""
    u = u.copy()
    u[::100, 1] = 5.0
    return u, y


CASES: dict[str, dict[str, Any]] = {
    "one record": dict(lengths=(300,)),
    "100 samples": dict(lengths=(100,)),
    "two records": dict(lengths=(150, 160)),
    "too short for a start": dict(lengths=(150, 160, 155, 4)),
    "too short to judge": dict(lengths=(150, 160, 155, 12)),
} | {
    own.__name__: dict(change=own)
    for own in (
        constant_input,
        no_input_matters,
        copied_input,
        binary_output,
        constant_output,
        integrated,
        one_input_twice,
        binary_inputs,
        huge,
        outliers,
    )
}

QUICK = (
    *("too short for a start", "constant_input", "binary_output", "constant_output"),
    *("copied_input", "outliers"),
)


@pytest.mark.parametrize("case", some(CASES, *QUICK))
def test_every_candidate_is_made(case):
    data = problems.plant(**CASES[case])
    # Fewer scales of lags are fewer programs to be compiled.
    seen = profile_data(data, "y")
    seen = dataclasses.replace(seen, rise=min(seen.rise, 2.0))
    search = ClosedSearch(data, seen, groups(data, gap=seen.memory))
    every, names, network = [], [], None
    for one in search.candidates(3):
        names.append((one.family, one.name))
        assert one.count_diverged() >= 0 and np.isfinite(one.one_step())
        errors = one.losses()[one.stage.design.equations.judged > 0]
        assert np.all(np.isfinite(errors)) and np.all(errors >= 0)
        every.append(one.free_run)
        network = one.network()
        assert np.all(np.isfinite(np.asarray(network.models[0].local.coefficient)))
    # With what is held to the trained range no one does much worse than chance.
    assert every[0] <= 1.5 and np.all(np.isfinite(every)) and min(every) <= every[0]
    assert len(names) == len(set(names)) >= 13
    assert network is not None
    run = jnx.simulate(network, data).value
    assert all(np.all(np.isfinite(y)) for y in run.outputs)
    if case == "copied_input":
        assert min(every) < 0.01
    if case == "constant_output":
        assert max(every) < 1e-6


def test_levels_stand_where_the_gates_look_for_them():
    """Scaled as scheduling variables are, whatever else there was of the input."""
    data = problems.plant(outliers)
    seen = profile_data(data, "y")
    search = ClosedSearch(data, seen, groups(data, gap=seen.memory))
    signals = search.signals(search.memory(1), 1)
    own = search.levels(signals)[1]
    assert seen.levels[1] == (0.0, 1.0)
    assert own is not None and own == pytest.approx((0.0, 0.2))
    gate = problems.whole(len(signals.scheduling)).gate(1, own)
    assert gate is not None
    for one in signals.stretches:
        at = gate(one.x)
        low, high = one.x[1] < 0.01, one.x[1] > 0.19
        assert low.any() and at[low].max() < 1e-9 and at[high].min() > 1 - 1e-9
