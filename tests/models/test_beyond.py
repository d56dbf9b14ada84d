"""What a network answers beyond the trained ranges of its inputs, by plain loops."""

import dataclasses
from functools import partial

import common
import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
from common import A, B

import jaxnarx as jnx
from jaxnarx.data.batch import stack_records
from jaxnarx.errors import SpecError
from jaxnarx.models import (
    FLAG,
    HOLD,
    LINEAR,
    NAN,
    advance,
    fed_back_variables,
    hold_to_range,
    report_outputs,
    run_record,
)
from jaxnarx.models.limits import overshoots
from jaxnarx.models.missing import input_memory
from jaxnarx.simulation import make_drive, run
from jaxnarx.simulation.masks import first_anchor, make_masks

LOW, HIGH = np.array([-1.5, -0.3, -4.0, -1.0]), np.array([1.0, 0.4, 5.0, 2.0])
"""Trained ranges that about a third of the inputs leave."""


def ranged(kind: str, outside: str):
    ends = dict(zip(("low", "high"), jax.device_put((LOW, HIGH)), strict=True))
    net = dataclasses.replace(common.named(kind), **ends)
    return hold_to_range(net, None, outside=outside)


def by_hand(net, rows, outside):
    """Free run of one record: every term by itself, and its slope where it is pure."""
    gain, own = np.asarray(net.gain), list(net.signals)
    seen = np.array(rows)
    if outside != FLAG:
        seen[:, [A, B]] = np.clip(rows[:, [A, B]], LOW[:2], HIGH[:2])
    lower, upper = np.asarray(net.lower), np.asarray(net.upper)
    dense = [np.asarray(model.local.dense()) for model in net.models]
    fed = {row for row, *_ in fed_back_variables(net.variables, net.signals)}
    y = np.array(rows[:, own] / gain[own])
    for t in range(net.history, len(rows)):
        now = []
        for model, theta in zip(net.models, dense, strict=True):
            x: list[float] = [1.0]
            far: list[float] = [0.0]
            for s, lag in net.variables:
                fed_back_one = s in own
                value = y[t - lag, own.index(s)] if fed_back_one else 0.0
                value = value if fed_back_one else seen[t - lag, s] / gain[s]
                x.append(float(value))
                beyond = (rows[t - lag, s] - seen[t - lag, s]) / gain[s]
                far.append(beyond if outside == LINEAR and s not in own else 0.0)
            z = [
                y[t - lag, own.index(s)] * gain[s] if s in own else seen[t - lag, s]
                for s, lag in model.scheduling
            ]
            z = (np.array(z) - np.asarray(model.offset)) / np.asarray(model.span)
            centre, width = model.validity.centre, np.exp(model.validity.log_width)
            (phi,) = oracles.validity(z[None], np.asarray(centre), np.asarray(width))
            total = 0.0
            for k, row in enumerate(np.asarray(model.local.factor).tolist()):
                value = np.prod([x[i] for i in row])
                if not any(i - 1 in fed for i in row if i):
                    for n, i in enumerate(row):
                        rest = [x[j] for m, j in enumerate(row) if m != n]
                        value += far[i] * np.prod(rest)
                total += float(phi @ theta[:, k]) * value
            now.append(total)
        y[t] = np.clip(now, lower, upper)
    return y * gain[own]


@pytest.mark.parametrize("outside", [FLAG, HOLD, LINEAR])
@pytest.mark.parametrize("kind", ["by inputs", "coupled", "coupled, by own output"])
def test_a_run_beyond_the_ranges_is_that_of_a_loop(kind, outside):
    net, data = ranged(kind, outside), common.dataset()
    run = jnx.simulate(net, data).value
    for n, made in enumerate(run.outputs):
        if len(made) > net.history:
            known = by_hand(net, common.rows_of(data, n), outside)
            # sums in another order
            np.testing.assert_allclose(made, known, rtol=1e-9, atol=1e-9)


def test_what_is_linear_in_its_inputs_goes_on_as_if_there_were_no_range():
    terms = [((0, 0), 0.1), ((0, 1), 0.5), ((0, 2), -0.4), ((0, 3), 0.6)]
    ends = dict(zip(("low", "high"), jax.device_put((LOW, HIGH)), strict=True))
    net = common.network([common.Part([terms])], variables=common.VARIABLES[:4])
    net, data = dataclasses.replace(net, **ends), common.dataset()
    free, on, held = (
        jnx.simulate(hold_to_range(net, None, outside=o), data).value.outputs
        for o in (FLAG, LINEAR, HOLD)
    )
    for a, b, c in zip(free, on, held, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)
        assert len(a) < 10 or np.abs(a - c).max() > 0.1


def test_inside_of_the_ranges_all_are_the_same():
    data = common.dataset()
    wide = [dataclasses.replace(common.named("coupled")) for _ in range(3)]
    runs = [
        jnx.simulate(hold_to_range(net, None, outside=o), data).value.outputs
        for net, o in zip(wide, (FLAG, HOLD, LINEAR), strict=True)
    ]
    for a, b, c in zip(*runs, strict=True):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_allclose(a, c, rtol=1e-14)


def test_one_step_is_a_step_of_the_run():
    net, data = ranged("coupled", LINEAR), common.dataset()
    batch = stack_records(data)
    drive = make_drive(net, batch)
    masks = make_masks(net, batch, net.window)
    y = np.asarray(run(net, drive, jax.device_put(first_anchor(masks))))[0]
    v, x = jax.tree.map(lambda a: np.asarray(a)[0], (drive.v, drive.x))
    lags = max(d for _, _, d in fed_back_variables(net.variables, net.signals)) + 1
    step = jax.jit(partial(advance, net))
    for t in (20, 40):
        history = np.stack([y[t - 1 - d] for d in range(lags)], axis=1)
        one = step(v[:, t], tuple(a[:, t] for a in x), history)
        np.testing.assert_allclose(one, y[t], rtol=1e-12)


def test_the_slope_by_inputs_is_that_of_differences():
    net, rows = ranged("coupled", LINEAR), common.signals(30)
    anchor = np.arange(30) == net.history

    def end(rows):
        v, x = net.columns(rows)
        own = np.array(net.signals)
        past = rows[:, own] / net.gain[own][None]
        return run_record(net, v, x, past, jnp.asarray(anchor))[-1].sum()

    # the end, and its slope along a change of the rows
    both = jax.jit(lambda rows, to: jax.jvp(end, (rows,), (to,)))
    beyond = np.argwhere((rows[:, :2] < LOW[:2]) | (rows[:, :2] > HIGH[:2]))
    beyond = beyond[beyond[:, 0] > 22]
    assert len(beyond) > 2
    for t, s in beyond.tolist():
        to = np.zeros_like(rows)
        to[t, s] = 1.0
        up, down = (float(both(rows + h * to, to)[0]) for h in (1e-5, -1e-5))
        # central differences of 1e-5 are good to 1e-10, of sums of order one
        assert abs((up - down) / 2e-5 - both(rows, to)[1]) < 1e-6


def test_outputs_may_leave_their_range_as_far_as_inputs_have_left_theirs():
    inputs = np.array([[0.0, 0.0], [1.25, 0.0], [0.0, 0.0], [0.0, -1.7], [2.0, 0.0]])
    net = ranged("coupled", FLAG)
    # widths are 2.5 and 0.7: beyond by 0.1, then 2.0, then 0.4 of them
    fade = np.exp(-1 / input_memory(net))
    farthest = np.array([0.0, 0.1, 0.1 * fade, 2.0, 2.0 * fade])
    np.testing.assert_allclose(overshoots(net, inputs), farthest, atol=1e-12)
    assert np.all(overshoots(ranged("coupled", HOLD), inputs) == 0)
    net, y = hold_to_range(net, 0.1), np.tile([100.0, -100.0], (5, 1))
    width = np.array([9.0, 3.0])
    edge = np.array([5.0, -1.0]) + np.array([1, -1]) * width * (0.1 + farthest)[:, None]
    value, mask = report_outputs(net, y, inputs)
    np.testing.assert_allclose(value, edge, atol=1e-12)
    assert mask.all()
    np.testing.assert_allclose(report_outputs(net, y)[0], edge[:1].repeat(5, axis=0))


def test_a_spike_of_an_input_widens_the_limit_for_the_memory_only():
    """And one of an input that no term looks at does not."""
    net = hold_to_range(ranged("coupled", FLAG), 0.1)
    inputs = np.zeros((1000, 2))
    inputs[100] = 1e5
    far = overshoots(net, inputs)
    memory = input_memory(net)
    assert memory == 10 * net.history and np.all(far[:100] == 0) and far[100] > 1e4
    assert np.all(far[100 + int(25 * memory) :] < 1e-5)
    y = np.full((1000, 2), 50.0)
    edges = report_outputs(net, y, inputs)[0]
    np.testing.assert_allclose(edges[-1], edges[0], rtol=1e-9)
    assert edges[100, 0] == 50
    blind = common.network([common.Part([[((0,), 0.3)]])], variables=((A, 0),))
    inputs[:, A] = 0
    assert not overshoots(blind, inputs).any() and overshoots(net, inputs).any()


def test_of_constant_inputs_nothing_is_beyond():
    net = ranged("coupled", FLAG)
    net = dataclasses.replace(net, low=net.high)
    assert np.all(overshoots(net, np.full((3, 4, 2), 9.0)) == 0)


def test_a_file_keeps_what_inputs_do(tmp_path):
    for margin, outside in ((None, FLAG), (0.1, HOLD), (0.1, LINEAR), (None, LINEAR)):
        net = hold_to_range(ranged("coupled", FLAG), margin, outside=outside)
        jnx.save(net, tmp_path / "model.safetensors")
        again = jnx.load(tmp_path / "model.safetensors")
        assert again.outside == outside
        assert (again.hold is None) == (margin is None)


def test_another_word_is_refused():
    refused = partial(hold_to_range, ranged("coupled", FLAG), outside="nowhere")
    with pytest.raises(SpecError, match="flag, hold, linear, nan"):
        refused()


def test_it_is_told_in_print():
    assert "on to first order" in str(ranged("coupled", LINEAR))
    assert "Inputs stay at the edge of their trained ranges" in str(
        ranged("coupled", HOLD)
    )


def test_a_network_may_say_nothing_beyond_its_ranges():
    net, data = ranged("coupled", FLAG), common.dataset()
    free = jnx.simulate(net, data).value
    silent = jnx.simulate(hold_to_range(net, None, outside=NAN), data).value
    gone = 0
    for n, y in enumerate(silent.outputs):
        out = free.extrapolated[n].copy()
        out[: net.history] = False
        assert np.all(np.isnan(y) == out[:, None])
        np.testing.assert_array_equal(y[~out], free.outputs[n][~out])
        np.testing.assert_array_equal(silent.scored[n], free.scored[n] & ~out[:, None])
        np.testing.assert_array_equal(silent.computed[n], free.outputs[n])
        gone += out.sum()
    assert gone > 20
    for a, b in zip(silent.diverged, free.diverged, strict=True):
        np.testing.assert_array_equal(a, b)
