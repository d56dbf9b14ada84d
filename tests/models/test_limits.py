"""Networks held to their trained ranges, by clipping with NumPy."""

import dataclasses

import common
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from common import A, B, W, Y

from jaxnarx.data.batch import stack_records
from jaxnarx.errors import SpecError
from jaxnarx.models import held_inputs, hold_to_range, report_outputs, reported_range
from jaxnarx.regressors import LowPass, Variables

LOW, HIGH = np.array([-1.5, -0.3, -4.0, -1.0]), np.array([1.0, 0.4, 5.0, 2.0])
"""Trained ranges that about a third of the signals leave."""


def ranged(kind: str = "coupled", margin: float | None = 0.1):
    ends = dict(zip(("low", "high"), jax.device_put((LOW, HIGH)), strict=True))
    net = dataclasses.replace(common.named(kind), **ends)
    return hold_to_range(net, margin, outside=None if margin is None else "hold")


def clipped(rows):
    """The signals with inputs at the edge of their ranges where they go beyond."""
    out = np.array(rows)
    out[..., [A, B]] = np.clip(rows[..., [A, B]], LOW[:2], HIGH[:2])
    return out


def test_a_network_is_held_or_not_and_nothing_else_of_it_changes():
    plain = ranged(margin=None)
    held = hold_to_range(plain, outside="hold")
    assert plain.hold is None and held.hold is not None
    assert np.asarray(held.hold) == 0.02 and held.hold.dtype == held.gain.dtype
    pairs = zip(jax.tree.leaves(plain), jax.tree.leaves(held)[:-1], strict=True)
    assert all(a is b for a, b in pairs)
    again = hold_to_range(held, None)
    assert jax.tree.structure(again) == jax.tree.structure(plain)
    assert np.asarray(hold_to_range(held, 0).hold) == 0.0


@pytest.mark.parametrize("margin", [-0.1, np.inf, np.nan])
def test_a_margin_is_finite_and_not_negative(margin):
    with pytest.raises(SpecError, match="margin must be finite") as caught:
        hold_to_range(ranged(), margin)
    assert caught.value.field == "margin"


def test_inputs_are_held_and_outputs_seen_as_they_are():
    rows = common.signals(60)
    given = jax.device_put(rows)
    np.testing.assert_array_equal(ranged().hold_inputs(given), clipped(rows))
    assert np.any(clipped(rows) != rows)
    assert ranged(margin=None).hold_inputs(given) is given
    # Some signals alone, in another order.
    some = np.array([Y, B, B])
    seen = ranged().hold_inputs(given[:, some], some)
    np.testing.assert_array_equal(seen, clipped(rows)[:, some])


def test_the_slope_by_an_input_is_one_up_to_the_edge_and_zero_beyond():
    at = [LOW[A] - 1e-3, LOW[A], 0.0, HIGH[A], HIGH[A] + 1e-3]
    rows = jnp.asarray([[a, 0.0, 0.0, 0.0] for a in at])
    held = ranged()
    slope = jax.grad(lambda rows: held.hold_inputs(rows)[:, A].sum())(rows)[:, A]
    np.testing.assert_array_equal(slope, [0, 1, 1, 1, 0])


def test_the_slope_by_an_input_that_was_constant_in_training_is_zero():
    held = ranged()
    held = dataclasses.replace(held, low=held.low.at[A].set(held.high[A]))
    rows = jnp.asarray([[HIGH[A] + off, 0.0, 0.0, 0.0] for off in (-1, 0.0, 1)])
    value, slope = jax.jvp(held.hold_inputs, (rows,), (jnp.ones_like(rows),))
    np.testing.assert_array_equal(value[:, A], np.full(3, HIGH[A]))
    np.testing.assert_array_equal(slope[:, A], np.zeros(3))


def test_lags_filters_and_scheduling_are_those_of_held_inputs():
    filters = (LowPass(0.5), None, LowPass(0.3))
    table, scheduling = (
        Variables(((A, 0), (B, 2), (W, 1)), filters),
        Variables(((B, 1),)),
    )
    one = ranged("by inputs")
    model = dataclasses.replace(one.models[0], scheduling=scheduling)
    held = dataclasses.replace(one, variables=table, models=(model,))
    rows = common.signals(60)
    v, x = held.columns(jnp.asarray(rows))
    plain_v, plain_x = hold_to_range(held, None).columns(jnp.asarray(clipped(rows)))
    np.testing.assert_array_equal(v, plain_v)
    np.testing.assert_array_equal(x[0], plain_x[0])


def test_what_is_reported_stays_in_the_widened_range():
    y = np.linspace(-9, 9, 31)[:, None] * [1.0, 0.3]
    low, high = np.array([-4.9, -1.3]), np.array([5.9, 2.3])
    for found, ends in zip(reported_range(ranged()), (low, high), strict=True):
        np.testing.assert_allclose(found, ends, rtol=1e-14)
    value, mask = report_outputs(ranged(), y)
    np.testing.assert_allclose(value, np.clip(y, low, high), rtol=1e-14)
    np.testing.assert_array_equal(mask, (y < low) | (y > high))
    free, nowhere = report_outputs(ranged(margin=None), y)
    assert free is y and not nowhere.any()
    assert np.all(np.isinf(reported_range(ranged(margin=None))))


def test_the_host_holds_the_inputs_of_records_as_the_network_does():
    batch = stack_records(common.dataset())
    held = held_inputs(ranged(), batch)
    np.testing.assert_array_equal(held.signals, clipped(np.asarray(batch.signals)))
    assert held.valid is batch.valid
    assert held_inputs(ranged(margin=None), batch) is batch


def test_two_values_stay_and_a_constant_is_held_at_its_value():
    low, high = jax.device_put((np.array([0.0, 3.0, 7, 0]), np.array([1.0, 3.0, 7, 9])))
    network = dataclasses.replace(ranged(), low=low, high=high)
    rows = jnp.asarray([[0.0, 2.0, 6.0, 0.0], [1.0, 5.0, 8.0, 0.0]])
    seen = network.hold_inputs(rows)
    np.testing.assert_array_equal(seen[:, :2], [[0.0, 3.0], [1.0, 3.0]])
    value, mask = report_outputs(
        network, np.array([[6.0, 0.0], [7.0, 0.0], [8.0, 0.0]])
    )
    np.testing.assert_array_equal(value[:, 0], 7.0)
    np.testing.assert_array_equal(mask[:, 0], [True, False, True])


def test_a_held_network_says_so():
    first, second, *rest = str(ranged()).splitlines()
    assert (
        "Reported outputs stay within their trained ranges, widened by 10 %" in second
    )
    assert [first, *rest] == str(ranged(margin=None)).splitlines()
