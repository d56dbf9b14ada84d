"""Runs of networks with limits: hold the inputs by hand, run, hold the outputs."""

import dataclasses
from functools import cache

import common
import jax
import numpy as np
import oracles
import pytest
from common import A, B

from jaxnarx.models import hold_to_range, reported_range
from jaxnarx.simulation import predict, simulate

ROUNDING = 1e-10
LOW, HIGH = np.array([-1.5, -0.3, -3.0, -0.3]), np.array([1.0, 0.4, 0.5, 1.0])
KINDS = ("by inputs", "coupled, by own output")
"""Both paths of a run."""
MARGIN = 0.1


@cache
def plain(kind: str, bound: float = 50.0):
    low, high = jax.device_put((LOW, HIGH))
    return dataclasses.replace(common.named(kind, bound=bound), low=low, high=high)


def held(kind: str, bound: float = 50.0, margin: float = MARGIN):
    return hold_to_range(plain(kind, bound), margin, outside="hold")


@cache
def data():
    return common.dataset()


def rows_seen(n: int) -> np.ndarray:
    """Record n with its inputs held."""
    rows = common.rows_of(data(), n).copy()
    rows[:, [A, B]] = np.clip(rows[:, [A, B]], LOW[:2], HIGH[:2])
    return rows


@cache
def simulated(kind: str):
    return simulate(held(kind), data())


def assert_held(value, n: int, computed: np.ndarray, first: int, kind: str):
    """Outputs of record n are the computed ones, clipped where they are predicted."""
    low, high = reported_range(held(kind))
    after = slice(first, None)
    np.testing.assert_allclose(value.computed[n], computed, rtol=0, atol=ROUNDING)
    expected = np.clip(computed, low, high)
    np.testing.assert_allclose(value[n][after], expected[after], rtol=0, atol=ROUNDING)
    mask = (computed < low) | (computed > high)
    mask[:first] = False
    np.testing.assert_array_equal(value.held[n], mask)
    np.testing.assert_array_equal(value[n][:first], computed[:first])


@pytest.mark.parametrize("kind", KINDS)
def test_simulate_is_the_plain_run_of_held_inputs_with_held_outputs(kind):
    solution, net = simulated(kind), held(kind)
    for n in range(len(data())):
        run = oracles.free_run(rows_seen(n), common.to_oracle(net))
        assert_held(solution.value, n, run.outputs, net.history, kind)
    count = solution.stats["held"]
    np.testing.assert_array_equal(count, [h.sum(axis=0) for h in solution.value.held])
    assert count.sum() > 10
    assert 0 < np.concatenate(solution.value.held).mean() < 0.5


@pytest.mark.parametrize("kind", KINDS)
def test_so_is_predict(kind):
    found, net = predict(held(kind), data(), 3), held(kind)
    for n in (0, 1):
        run = oracles.k_step(rows_seen(n), common.to_oracle(net), 3)
        assert_held(found.value, n, run.outputs, net.history + 2, kind)
    assert found.stats["held"].sum() > 0
    # What leaves the range is told by what was computed.
    for mask, outside in zip(found.value.held, found.value.extrapolated, strict=True):
        assert np.all(outside[mask.any(axis=1)])


def test_measured_samples_before_the_start_are_repeated_as_they_are():
    kind = "by inputs"
    value, history = simulated(kind).value, held(kind).history
    first = np.concatenate([r.y[:history, :1] for r in data()])
    assert first.max() > HIGH[2]
    for n, record in enumerate(data()):
        np.testing.assert_array_equal(value[n][:history], record.y[:history, :1])


def test_extrapolated_tells_of_the_measured_inputs_as_without_limits():
    """Lags 0 of a, and 1 and 2 of b, leave their ranges."""
    value = simulated("by inputs").value
    for n in range(len(data())):
        rows = common.rows_of(data(), n)
        out = (rows < LOW) | (rows > HIGH)
        expected = out[:, A].copy()
        expected[1:] |= out[:-1, B]
        expected[2:] |= out[:-2, B]
        np.testing.assert_array_equal(value.extrapolated[n], expected)


def test_the_margin_has_no_part_in_what_is_fed_back_limited_or_judged():
    """The feedback bound is +-2.5 for y, +-0.75 for w."""
    kind = "coupled, by own output"
    narrow = simulate(held(kind, bound=0.25, margin=0.0), data())
    wide = simulate(held(kind, bound=0.25, margin=1e3), data())
    assert narrow.status_name == wide.status_name == "diverged"
    assert narrow.detail == wide.detail
    for name in ("computed", "limited", "extrapolated", "diverged", "scored"):
        pairs = zip(getattr(narrow.value, name), getattr(wide.value, name), strict=True)
        for a, b in pairs:
            np.testing.assert_array_equal(a, b)
    assert narrow.stats["held"].sum() > 0 == wide.stats["held"].sum()
    limited = [
        oracles.free_run(
            rows_seen(n), common.to_oracle(held(kind, bound=0.25))
        ).limited.sum(axis=0)
        for n in range(len(data()))
    ]
    np.testing.assert_array_equal(narrow.stats["limited"], limited)


def test_without_limits_nothing_is_held_and_what_is_computed_is_reported():
    solution = simulate(plain("by inputs"), data())
    assert not solution.stats["held"].any()
    for y, computed in zip(
        solution.value.outputs, solution.value.computed, strict=True
    ):
        np.testing.assert_array_equal(y, computed)
