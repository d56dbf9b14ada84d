"""Sentences about limits and policies, each beside what the model does."""

import dataclasses
import itertools
import re
from functools import cache

import common
import hidden_problems
import jax
import numpy as np
import pytest
from common import A, B, W, some

import jaxnarx as jnx
from jaxnarx.models import (
    FLAG,
    HOLD,
    LINEAR,
    MISSING,
    NAN,
    OUTSIDE,
    OUTSIDE_WORDS,
    describe_limits,
    describe_missing,
    describe_policies,
    hold_to_range,
    set_bounds,
    set_nan_policy,
)
from jaxnarx.models.policies import describe_bounds, describe_outputs, describe_start
from jaxnarx.regressors import LowPass, Variables
from jaxnarx.simulation import simulate

LOW, HIGH = np.array([-1.5, -0.3, -4.0, -1.0]), np.array([1.0, 0.4, 5.0, 2.0])
"""Trained ranges that about a third of the signals leave."""


MARGIN = 0.01
"""By which most outputs here are held: with and without one are two programs."""


def filtered(net):
    bank = (LowPass(0.5), None, None, None)
    return dataclasses.replace(net, variables=Variables(net.variables.rows, bank))


def grouped(net):
    own = jax.device_put(np.array([[True, False, False], [False, True, True]]))
    (model,) = net.models
    return dataclasses.replace(net, models=(dataclasses.replace(model, own=own),))


KINDS = {
    "one model": lambda: common.named("one model"),
    "by inputs": lambda: common.named("by inputs"),
    "filters": lambda: filtered(common.named("one model")),
    "own feedback": lambda: grouped(common.named("by inputs")),
    "hidden": lambda: hidden_problems.network(),
}


@cache
def ranged(kind: str):
    """A network of the kind, without domain, that was trained on `LOW` to `HIGH`."""
    net = KINDS[kind]()
    more = len(np.asarray(net.low)) - 4
    ends = np.append(LOW, [-9.0] * more), np.append(HIGH, [9.0] * more)
    low, high = jax.device_put(ends)
    return hold_to_range(dataclasses.replace(net, low=low, high=high), MARGIN)


def records(u):
    """One record with these inputs; outputs as measured at rest."""
    y = np.tile([0.5, 0.2], (len(u), 1))
    return common.from_rows([np.hstack([u, y])], missing="mask")


INPUTS = common.signals(60)[:, :2]
INSIDE = np.clip(INPUTS, LOW[:2], HIGH[:2])


def computed(net, u):
    return simulate(net, records(u)).value.computed[0]


def policy_of(net) -> str:
    """The policy that a network's runs show."""
    run = simulate(net, records(INPUTS)).value
    after = slice(net.before, None)
    if np.isnan(run.outputs[0][after]).any():
        gone = np.isnan(run.outputs[0][after]).all(axis=1)
        np.testing.assert_array_equal(gone, run.extrapolated[0][after])
        return NAN
    if np.allclose(run.computed[0], computed(net, INSIDE), atol=1e-12):
        return HOLD
    inputs = np.arange(len(np.asarray(net.low))) < 2
    low, high = (
        np.asarray(e) + s * 1e3 * inputs for e, s in ((net.low, -1), (net.high, 1))
    )
    low, high = jax.device_put((low, high))
    wide = dataclasses.replace(net, low=low, high=high)
    return FLAG if np.allclose(run.computed[0], computed(wide, INPUTS)) else LINEAR


CASES = tuple(itertools.product(KINDS, OUTSIDE))


@pytest.mark.parametrize(
    ("kind", "outside"),
    some(
        CASES,
        *(case for case in CASES if case[0] != "hidden" or case[1] == "hold"),
    ),
)
def test_inputs_do_what_the_sentence_says(kind, outside):
    net = hold_to_range(ranged(kind), MARGIN, outside=outside)
    found = policy_of(net)
    if outside == LINEAR and found == FLAG:
        # What is of first order everywhere goes on as it is.
        found = LINEAR
    assert describe_limits(net)[0].startswith(OUTSIDE_WORDS[found].sentence)
    others = [w.sentence for name, w in OUTSIDE_WORDS.items() if name != found]
    text = " ".join(describe_policies(net))
    assert not any(sentence in text for sentence in others)


def numbers(text):
    return [float(x) for x in re.findall(r"-?\d+\.?\d*(?:e[+-]\d+)?", text)]


def reach(net, u):
    """Shares of its range by which an output may leave it, by its sentence alone."""
    said = numbers(describe_outputs(net))
    margin, far = said[0] / 100, np.zeros(len(u))
    if len(said) > 1:
        over = np.maximum(LOW[:2] - u, u - HIGH[:2]) / (HIGH - LOW)[:2]
        over = np.maximum(over[:, [s for s in net.used if s < 2]].max(axis=1), 0)
        for t in range(len(u)):
            far[t] = max(over[t], np.exp(-1 / said[1]) * far[t - 1] if t else 0.0)
    return margin + far


@pytest.mark.parametrize("outside", OUTSIDE)
@pytest.mark.parametrize("kind", KINDS)
def test_outputs_are_held_as_the_sentence_says(kind, outside):
    net = hold_to_range(ranged(kind), MARGIN, outside=outside)
    # Ranges of outputs that are left.
    out = slice(2, 2 + len(net.modelled))
    low, high = np.asarray(net.low).copy(), np.asarray(net.high).copy()
    low[out], high[out] = low[out] / 40, high[out] / 40
    net = dataclasses.replace(net, low=jax.device_put(low), high=jax.device_put(high))
    u = np.where(np.arange(60)[:, None] % 20 < 8, INPUTS, 0.1)
    run = simulate(net, records(u)).value
    width = high - low
    wider = reach(net, u)[:, None] * width[out]
    expected = np.clip(run.computed[0], low[out] - wider, high[out] + wider)
    known = np.isfinite(run.outputs[0])
    known[: net.before] = False
    np.testing.assert_allclose(run.outputs[0][known], expected[known], rtol=1e-3)
    assert run.held[0].any()
    free = hold_to_range(net, None, outside=outside)
    assert "not held" in describe_outputs(free)
    if kind == "by inputs":
        run = simulate(free, records(u)).value
        np.testing.assert_array_equal(run.outputs[0][known], run.computed[0][known])


@pytest.mark.parametrize("nan", MISSING)
@pytest.mark.parametrize("outside", [HOLD, NAN])
@pytest.mark.parametrize("kind", ["by inputs", "filters"])
def test_missing_inputs_do_what_the_sentence_says(kind, outside, nan):
    net = hold_to_range(ranged(kind), MARGIN, outside=outside)
    net = set_nan_policy(net, nan, invalid_after=0.7)
    u = INSIDE.copy()
    u[20:40, A] = np.nan
    run = simulate(net, records(u), missing="hold").value
    text = describe_missing(net)
    gone = np.isnan(run.outputs[0][:, 0])
    said = "outputs are NaN" in text
    assert said == (NAN in (nan, outside)) == gone[20:40].all() == gone.any()
    assert ("outputs are those of the held inputs" in text) == (not said)
    held = np.where(np.isnan(u), u[19], u)
    np.testing.assert_allclose(run.computed[0], computed(net, held), atol=1e-12)
    count = int(re.findall(r"from (\d+) samples", text)[0])
    assert np.flatnonzero(run.invalid[0])[0] == 20 + count - 1
    assert 'missing="hold"' in text
    plain = simulate(net, records(u)).value
    assert not plain.scored[0][20:40].any()


@pytest.mark.parametrize("kind", KINDS)
def test_bounds_hold_what_is_computed_and_fed_back(kind):
    net = dataclasses.replace(ranged(kind), upper=0 * ranged(kind).upper + 0.04)
    said = describe_bounds(net)
    for o, name in enumerate(net.output_names):
        top = numbers(said.split(f"{name} within")[1])[1]
        y = computed(net, INPUTS)[net.before :, o]
        assert y.max() <= top * (1 + 1e-3)
        assert o or y.max() == pytest.approx(top, rel=1e-3)
    assert describe_bounds(set_bounds(net, 1e6)) == ""


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_begins_as_the_sentence_says(kind):
    net, said = ranged(kind), describe_start(ranged(kind))
    count = sum(int(n) for n in re.findall(r"with (\d+)", said))
    assert count == net.before
    data = records(INPUTS)
    run = simulate(net, data).value
    own = data.records[0].y[:, list(net.modelled)]
    np.testing.assert_array_equal(run.outputs[0][:count], own[:count])
    assert not run.scored[0][:count].any() and run.scored[0][count:].all()


def test_without_history_or_inputs_less_is_said():
    part = common.Part([[((0,), 0.3)]])
    blind = common.network([part], variables=((A, 0),))
    assert (
        describe_start(blind) == "A free run begins with the first sample of a record."
    )
    own = common.network([common.Part([[((1,), 0.3)]])], variables=((common.Y, 1),))
    assert not own.used and describe_missing(own) == ""
    assert not any("nput" in text for text in describe_policies(own)[:1])


def test_measured_outputs_that_it_looks_at_are_never_held():
    part = common.Part([[((0, 1), 0.3), ((0, 2), 0.5)]])
    net = common.network([part], variables=((A, 0), (W, 1)))
    low, high = jax.device_put((LOW, HIGH))
    net = dataclasses.replace(net, low=low, high=high)
    rows = common.signals(40)
    rows[:, B] = 0
    beyond = rows.copy()
    beyond[:, W] *= 10
    for outside in OUTSIDE:
        held = hold_to_range(net, None, outside=outside)
        runs = [simulate(held, common.from_rows([r])).value for r in (rows, beyond)]
        one, two = (r.computed[0] for r in runs)
        taken = not np.allclose(one, two)
        said = "Measured w is taken as measured" in describe_limits(held)[0]
        assert taken and said == (outside in (HOLD, LINEAR))


@pytest.mark.parametrize("outside", some(OUTSIDE, "linear"))
def test_a_report_and_its_page_say_the_same(outside):
    from jaxnarx.shell.report.html import render

    net = hold_to_range(ranged("by inputs"), None, outside=outside)
    found = jnx.report(
        net, records(INPUTS), horizons=(1,), stability=False, diagnostics=False
    )
    words = OUTSIDE_WORDS[outside]
    assert found.summary.where[0].endswith(f"{words.behind_ranges}.")
    (note,) = [n for n in found.notes if "lie outside the range" in n]
    assert words.behind_share in note
    row = found.pooled_row("y")
    share = simulate(net, records(INPUTS)).value.extrapolated[0][net.before :].mean()
    assert row.share_outside == pytest.approx(share) and share > 0.2
    inside = f"{100 * (1 - share):.3g} % of the data samples lie within"
    assert inside in found.summary.where[-1]
    page = render(found)
    assert words.sentence in page and found.to_dict()["policies"] == list(
        found.policies
    )
    others = [w.sentence for w in OUTSIDE_WORDS.values() if w != words]
    assert not any(sentence in page for sentence in others)
    # The partition's ranges are not those of the training.
    assert "Regions are laid over" in page and "Trained for" not in page
    assert "trained for a -1.5 to 1 V" in page
