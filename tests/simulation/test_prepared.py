"""Prepared records: the verbs take them, and the array functions can be traced."""

import dataclasses
from functools import cache

import common
import equinox as eqx
import hidden_problems
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from common import some
from kinds import EVERY, problem

import jaxnarx as jnx
from jaxnarx import solution
from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.simulation import ready, run_status

ROUNDING = 1e-11
NAMES = some(EVERY, "coupled, by own output", "filters beyond", "hidden")
QUICK = some(EVERY, "coupled, by own output", "filters beyond")


def scaled(net, factor: float):
    """With coefficients that are so many times as large."""
    where = lambda n: [m.local.coefficient for m in n.models]  # noqa: E731
    return eqx.tree_at(where, net, [c * factor for c in where(net)])


@cache
def bed(name: str):
    """A network and records of its channels, of different lengths."""
    net, data = problem(name)
    if name == "hidden":
        data = hidden_problems.truth("scheduled").data
        net = scaled(net, 0.97)  # not the truth itself, which has no error
    else:
        data = common.dataset((60, 45))
    return net, data, jnx.prepare(net, data)


def stacked(value, data: Dataset):
    """Record by record as one array, zeros behind the shorter."""
    longest = max(len(r) for r in data)
    return np.stack([np.pad(y, ((0, longest - len(y)), (0, 0))) for y in value])


# against the verbs ----------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_array_functions_give_what_the_verbs_report(name):
    net, data, runs = bed(name)
    free, ahead = jnx.simulate(net, runs), jnx.predict(net, runs, 3)
    found = eqx.filter_jit(jnx.free_run)(net, runs)
    steps = eqx.filter_jit(jnx.predict_ahead)(net, runs, jnp.asarray(3))
    count = np.asarray(ready(runs, jnp.asarray(3)))
    for n, record in enumerate(data):
        own = slice(0, len(record))
        common.assert_said(found[n, own], free.value[n], ROUNDING)
        common.assert_said(steps[n, own], ahead.value[n], ROUNDING)
        for scored, by_verb in ((runs.scored, free), (count, ahead)):
            said = np.isfinite(by_verb.value[n])
            np.testing.assert_array_equal(
                scored[n, own] & said, by_verb.value.scored[n]
            )
        columns = [data.channels.output_names.index(o) for o in net.output_names]
        np.testing.assert_array_equal(runs.measured[n, own], record.y[:, columns])
    np.testing.assert_array_equal(
        eqx.filter_jit(run_status)(net, runs), free.stats["record_status"]
    )
    # What is computed on the host is what a program computes.
    driven = runs.with_inputs(net, runs.inputs).drive
    for host, traced in zip(*map(jax.tree.leaves, (runs.drive, driven)), strict=True):
        np.testing.assert_allclose(host, traced, rtol=1e-14, atol=1e-14)
    again = jnx.simulate(net, data)
    np.testing.assert_array_equal(again.value[1], free.value[1])
    assert again.status_name == free.status_name


def test_a_run_that_leaves_its_bounds_is_diverged_in_the_array_too():
    net, _, _ = bed("by inputs")
    data = common.dataset()
    bounds = net.lower / 200, net.upper / 200
    low = eqx.tree_at(lambda n: (n.lower, n.upper), net, bounds)
    runs = jnx.prepare(low, data)
    solution = jnx.simulate(low, runs)
    assert solution.status_name == "diverged"
    np.testing.assert_array_equal(
        eqx.filter_jit(run_status)(low, runs), solution.stats["record_status"]
    )


# derivatives ----------------------------------------------------------------------


def loss(net, runs):
    y = jnx.free_run(net, runs)
    return (jnx.metrics.nrmse(runs.measured, y, runs.scored) ** 2).sum()


STEP = 5e-4
"""Of central differences of fourth order. The starts of hidden channels are found by
steps that may be rejected: smaller ones would measure that."""


def drawn(rng, leaf):
    """A direction of one leaf. What is zero stays: a gate that is open to the same
    share everywhere has no direction, and by convention no slope by it."""
    return common.device(rng.normal(size=leaf.shape) * (np.asarray(leaf) != 0))


def directions(net, runs):
    """What moves and what does not of a network, and a direction of each kind."""
    moving, fixed = eqx.partition(net, jnx.freeze(net))
    rng = np.random.default_rng(0)
    leaves, form = jax.tree.flatten(moving)
    way, other = (form.unflatten([drawn(rng, a) for a in leaves]) for _ in range(2))
    return moving, fixed, way, other, common.device(rng.normal(size=runs.inputs.shape))


def dot(one, other):
    parts = jax.tree.map(lambda a, b: jnp.sum(a * b), one, other)
    return jax.tree.reduce(jnp.add, parts)


def difference(function, at, way, step=STEP):
    """The slope along a direction by central differences of fourth order."""

    def end(h):
        return function(jax.tree.map(lambda a, d: a + h * d, at, way))

    ends = [end(n * step) for n in (-2, -1, 1, 2)]
    return jax.tree.map(lambda a, b, c, d: (a - d + 8 * (c - b)) / (12 * step), *ends)


@pytest.mark.parametrize("name", QUICK)
def test_slopes_are_central_differences(name):
    net, _, runs = bed(name)
    moving, fixed, way, _, drift = directions(net, runs)

    @eqx.filter_jit
    def found(moving, way, drift, runs):
        def of(moving):
            return loss(eqx.combine(moving, fixed), runs)

        def driven(u):
            return loss(net, runs.with_inputs(net, u))

        value, tangent = jax.jvp(of, (moving,), (way,))
        slopes = dot(jax.grad(of)(moving), way), tangent
        by_u = jnp.sum(jax.grad(driven)(runs.inputs) * drift)
        # Where inputs are held, slopes change at the edges of their ranges.
        step = STEP if net.hidden else 1e-6
        by_hand = difference(driven, runs.inputs, drift, step)
        return value, slopes, by_u, (difference(of, moving, way), by_hand)

    value, slopes, by_u, (first, second) = found(moving, way, drift, runs)
    assert value > 0.01 and abs(first) > 1e-4 and abs(second) > 1e-4
    np.testing.assert_allclose(slopes, [first, first], rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(by_u, second, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("name", some(EVERY, "coupled, by own output"))
def test_hessians_along_a_direction_are_central_differences(name):
    net, _, runs = bed(name)
    moving, fixed, way, other, _ = directions(net, runs)

    @eqx.filter_jit
    def found(moving, way, other, runs):
        slope = jax.grad(lambda moving: loss(eqx.combine(moving, fixed), runs))
        product = dot(jax.jvp(slope, (moving,), (way,))[1], other)
        return product, dot(difference(slope, moving, way), other)

    product, by_hand = found(moving, way, other, runs)
    assert abs(by_hand) > 1e-3
    np.testing.assert_allclose(product, by_hand, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize(
    "name", some(["coupled, by own output", "hidden"], "coupled, by own output")
)
def test_the_slope_by_the_start_is_that_of_differences(name):
    net, data, _ = bed(name)
    rows = common.rows_of(data, 0)
    u, start = rows[:, :2], rows[: net.before, [2 + o for o in net.modelled]]
    way = np.random.default_rng(1).normal(size=start.shape)

    @eqx.filter_jit
    def found(net, u, start, way):
        def end(start):
            return jnp.sum(net(u, start)[net.before :] ** 2)

        return jnp.sum(jax.grad(end)(start) * way), difference(end, start, way)

    slope, by_hand = found(net, *map(common.device, (u, start, way)))
    assert abs(by_hand) > 1e-3
    # Hidden channels begin at a minimum, which is found to 1e-9 of what they are.
    np.testing.assert_allclose(slope, by_hand, rtol=1e-6)


# many at once ---------------------------------------------------------------------


@pytest.mark.parametrize("name", some(EVERY, "own feedback"))
def test_stacked_networks_are_a_loop_over_them(name):
    net, _, runs = bed(name)
    others = [scaled(net, factor) for factor in (1.0, 0.97, 0.9)]
    fleet = jnx.stack(others)
    every = eqx.filter_vmap(jnx.free_run, in_axes=(0, None))
    found = eqx.filter_jit(every)(fleet, runs)
    one = eqx.filter_jit(jnx.free_run)
    for n, other in enumerate(others):
        np.testing.assert_allclose(found[n], one(other, runs), rtol=0, atol=1e-12)
    for one_of, other in zip(jnx.unstack(fleet), others, strict=True):
        assert eqx.tree_equal(one_of, other)


def test_only_networks_of_one_structure_are_stacked():
    one, other = common.named("one model"), common.named("by inputs")
    with pytest.raises(SpecError, match="network 2 has another structure"):
        jnx.stack([one, other])
    with pytest.raises(SpecError, match="no networks"):
        jnx.stack([])
    with pytest.raises(SpecError, match="not a stack"):
        jnx.unstack(one)


def test_a_record_alone_is_that_record_among_others():
    net, data, runs = bed("coupled, by own output")
    alone = eqx.filter_jit(jnx.free_run)(net, jnx.prepare(net, data[1:]))
    every = eqx.filter_jit(jnx.free_run)(net, runs)
    np.testing.assert_allclose(alone[0, :45], every[1, :45], rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("name", some(["coupled", "hidden"], "coupled"))
def test_a_fleet_is_a_loop_over_its_members(name):
    net, data, _ = bed(name)
    ours = data.records
    members = {"whole": data, "first": data[:1], "none": DataError("there is no file")}
    fleet = jnx.Fleet.from_datasets(members, train=slice(None), test=[0])
    others = [scaled(net, factor) for factor in (1.0, 0.97, 0.9)]
    every = jnx.prepare(jnx.stack(others), fleet)
    assert "3 members" in str(every)
    free = eqx.filter_jit(eqx.filter_vmap(jnx.free_run))(jnx.stack(others), every)
    status = eqx.filter_vmap(run_status)(jnx.stack(others), every)
    one = eqx.filter_jit(jnx.free_run)
    for n, (own, count) in enumerate(((data, len(ours)), (data[:1], 1))):
        alone = jnx.prepare(others[n], own)
        expected = one(others[n], alone)
        for r in range(count):
            same = slice(len(ours[r]))
            np.testing.assert_allclose(
                free[n, r, same], expected[r, same], rtol=0, atol=1e-12
            )
            np.testing.assert_array_equal(
                every.scored[n, r, same], alone.scored[r, same]
            )
    too_short = solution.STATUS_NAMES.index("too_short")
    np.testing.assert_array_equal(np.asarray(status)[2], [too_short] * len(ours))
    assert np.asarray(status)[0, 0] == 0 and np.asarray(status)[1, 1] == too_short
    assert np.all(np.isfinite(free)) and not every.scored[2].any()
    shared = jnx.prepare(net, fleet, part="test")
    assert shared.signals.shape[:2] == (3, 1)


def test_a_fleet_of_other_engines_is_refused():
    net, data, runs = bed("coupled")
    fleet = jnx.Fleet.from_datasets({"a": data, "b": data}, train=[0])
    channels = dataclasses.replace(data.channels, outputs=data.channels.outputs[::-1])
    other = dataclasses.replace(fleet, channels=channels)
    with pytest.raises(SpecError, match="channels are not the network's"):
        jnx.prepare(problem("sum")[0], other)
    with pytest.raises(SpecError, match="2 members needs one network, or a stack of 2"):
        jnx.prepare(jnx.stack([net] * 3), fleet)
    with pytest.raises(SpecError, match="test"):
        jnx.prepare(net, fleet, part="test")
    with pytest.raises(SpecError, match="have been through"):
        jnx.simulate(net, jnx.prepare(net, fleet))
    fleet = dataclasses.replace(fleet, sample_time=0.2)
    with pytest.raises(SpecError, match="resample"):
        jnx.prepare(net, fleet)


# elsewhere ------------------------------------------------------------------------


@pytest.mark.parametrize("platform", ["cuda", "tpu"])
def test_programs_are_lowered_for_devices_that_are_not_here(platform):
    net, _, runs = bed("coupled, by own output")
    moving, fixed = eqx.partition(net, jnx.freeze(net))

    def run(moving, runs):
        return jnx.free_run(eqx.combine(moving, fixed), runs)

    def slope(moving, runs):
        return jax.grad(lambda moving: loss(eqx.combine(moving, fixed), runs))(moving)

    for function in (run, slope):
        made = jax.export.export(jax.jit(function), platforms=[platform])(moving, runs)
        assert made.platforms == (platform,)
        assert "callback" not in made.mlir_module()


# what least squares wants ---------------------------------------------------------


def test_the_residual_is_the_loss_of_refine():
    net, _, runs = bed("coupled, by own output")
    errors = eqx.filter_jit(jnx.residual)(net, runs)
    step = jnx.SimulationError(max_steps=1, horizons=())
    history = jnx.refine(net, runs, step, validation=runs).stats["history"]
    y = np.asarray(eqx.filter_jit(jnx.free_run)(net, runs))
    nrmse = jnx.metrics.nrmse(*map(np.asarray, (runs.measured, y, runs.scored)))
    np.testing.assert_allclose(np.sum(np.asarray(errors) ** 2), np.mean(nrmse**2))
    assert history[0]["loss"] <= np.mean(nrmse**2)


def without_numbers(net):
    where = lambda n: n.models[0].local.coefficient  # noqa: E731
    return eqx.tree_at(where, net, replace_fn=lambda c: c * np.nan)


# what is refused ------------------------------------------------------------------


def test_prepared_records_belong_to_a_kind_of_networks():
    net, data, runs = bed("by inputs")
    other = common.named("one model")
    with pytest.raises(SpecError, match="prepared for another network"):
        jnx.simulate(other, runs)
    slower = dataclasses.replace(net, sample_time=2 * net.sample_time)
    with pytest.raises(SpecError, match="prepared for another network"):
        jnx.predict(slower, runs)
    with pytest.raises(SpecError, match="resample the data"):
        jnx.prepare(slower, data)
    lost = without_numbers(net)
    with pytest.raises(SpecError, match="not finite"):
        jnx.simulate(lost, runs)
    with pytest.raises(DataError, match="no record can be run"):
        jnx.prepare(net, common.dataset((2,)))
    arrays = jax.tree.map(lambda a: a, runs)
    with pytest.raises(SpecError, match="give the verbs what prepare returned"):
        jnx.simulate(net, arrays)
    assert "2 records of up to" in str(runs)


def test_parameters_that_are_not_finite_give_finite_outputs_and_a_status():
    net, _, runs = bed("by inputs")
    lost = without_numbers(net)
    y = np.asarray(eqx.filter_jit(jnx.free_run)(lost, runs))
    status = eqx.filter_jit(run_status)(lost, runs)
    assert np.all(np.isfinite(y)) and np.all(np.asarray(status) == 6)
