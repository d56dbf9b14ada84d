"""Maps optimised over a cycle: known optima, limits, derivatives, what is refused."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from calibration_problems import PLANT, SAMPLES, TIME, cycle, network_and_cycle
from jax.flatten_util import ravel_pytree

import jaxnarx as jnx
from jaxnarx.calibration import (
    Calibratable,
    CalibrationSearch,
    CycleLimit,
    FunctionPlant,
    Measure,
)
from jaxnarx.calibration.lagrangian import evaluate_merit, lagrangian
from jaxnarx.calibration.measures import smooth_percentile
from jaxnarx.calibration.problem import begin_numbers, measure_run, run_cycle
from jaxnarx.calibration.setup import add_levels, join_plants, make_problem
from jaxnarx.errors import DataError, SpecError


def optimised(maps, objective, limits=(), plant: Any = PLANT, **search):
    return jnx.calibration.optimise(
        plant, cycle(), maps, objective, limits, search=CalibrationSearch(**search)
    )


CURVE = Calibratable(("s",), axes=((-1.0, 0.0, 1.0),), start=0.3, low=-1, high=1)


def test_a_curve_finds_the_known_optimum():
    found = optimised({"c": CURVE}, [Measure("y + 1")], smooth=0.0)
    assert found.status_name == "ok"
    np.testing.assert_allclose(found.value["c"].value, [-0.5, 0.0, 0.5], atol=1e-3)
    (row,) = found.value.objective
    assert row.value < row.start
    visits = found.value["c"].visits
    assert visits.sum() == pytest.approx(SAMPLES) and np.all(visits > 0)


def test_a_limit_is_kept_and_has_a_multiplier():
    def limited(number):
        limit = CycleLimit(Measure("heat", "peak"), at_most=number)
        return optimised({"c": CURVE}, [Measure("y + 1")], [limit], smooth=0.0)

    found, looser = limited(0.05), limited(0.052)
    (row,) = found.value.limits
    assert found.is_okay and row.kept and row.multiplier > 0
    # Peaks are smooth in the search, from above.
    assert 0.035 < found.value.outputs[0][:, 1].max() <= 0.05 * 1.001
    free = optimised({"c": CURVE}, [Measure("y + 1")], smooth=0.0)
    assert free.value.outputs[0][:, 1].max() > 0.08
    # What a looser limit gains is what the multiplier says.
    gain = found.value.objective[0].value - looser.value.objective[0].value
    told = row.multiplier * 0.04 * found.value.objective[0].start
    assert gain == pytest.approx(told, rel=0.3)


def test_limits_that_contradict_each_other_are_named():
    limits = [
        CycleLimit(Measure("heat"), at_least=0.5),
        CycleLimit(Measure("heat", "peak"), at_most=0.3),
    ]
    found = optimised({"c": CURVE}, [Measure("y + 1")], limits, rounds=4)
    assert found.status_name == "infeasible" and not found.is_okay
    assert "mean of heat at least 0.5" in found.detail
    assert "would have to give" in found.detail
    assert not found.value.kept


def test_steps_slopes_and_distance_hold():
    given = dataclasses.replace(
        CURVE, start=0.0, steps=(0.2,), falls=("s",), away=0.3, axes=((-1, -0.5, 0, 1),)
    )
    found = optimised({"c": given}, [Measure("y + 1")])
    value = found.value["c"].value
    assert np.all(np.abs(np.diff(value)) < 0.201) and np.all(np.diff(value) < 1e-3)
    assert np.all(np.abs(value) <= 0.3 + 1e-12)


def test_a_scalar_and_tracking():
    one = Calibratable(start=0.0, low=-1, high=1)
    found = optimised({"c": one}, [Measure("heat", "tracking", target="wish")])
    assert found.value["c"].value.shape == ()
    # It begins at rest with c itself, so that the wish is met all the time.
    assert float(found.value["c"].value) == pytest.approx(0.2, abs=1e-4)


def test_a_map_on_which_nothing_depends_is_named():
    def other(u):
        return u[:, :1] ** 2

    plant = FunctionPlant(
        function=other, inputs=("s", "c"), outputs=("y",), sample_time=TIME
    )
    found = optimised({"c": CURVE}, [Measure("y")], plant=plant)
    assert found.status_name == "no_improvement"
    assert found.stats["ignored"] == ["c"]
    assert "no measure depends on c" in found.detail


def problem_of(plant, maps, objective, limits=(), data=None, **search):
    """The arrays behind the verb."""
    joined, draws, network = join_plants(plant, 1)
    given = (data or cycle()), maps, objective, limits, CalibrationSearch(**search)
    problem = make_problem(joined, draws, network, *given)
    before = run_cycle(problem, tuple(m.start for m in problem.maps))
    return add_levels(problem, before)


def test_a_percentile_is_smooth_in_a_search_alone():
    x = np.random.default_rng(4).normal(size=(2, 501))
    for share in (0.0, 0.05, 0.5, 0.9):
        exact = smooth_percentile(jnp.asarray(x), share, 0.0)
        np.testing.assert_allclose(exact, np.quantile(x, share, axis=1), rtol=1e-12)
    near_it = smooth_percentile(jnp.asarray(x), 0.9, 0.02)
    np.testing.assert_allclose(near_it, np.quantile(x, 0.9, axis=1), atol=0.03)
    slope = jax.grad(lambda x: smooth_percentile(x, 0.9, 0.02).sum())(jnp.asarray(x))
    assert np.count_nonzero(np.asarray(slope)[0]) > 10
    np.testing.assert_allclose(np.asarray(slope).sum(axis=1), 1.0, rtol=1e-12)


def near(maps):
    """Free numbers off the start, so that nothing is at an edge."""

    def move(a):
        a = np.asarray(a)
        return a + 0.013 + 0.05 * np.cos(np.arange(a.size)).reshape(a.shape)

    return jax.tree.map(move, maps)


@pytest.mark.parametrize(
    "case", ["scalar and curve", "map with axes", "loop", "domain"]
)
def test_slopes_are_central_differences(case):
    network, data = network_and_cycle()
    measures = [Measure("y + 1"), Measure("heat", "total", weight=0.1)]
    limits = [
        CycleLimit(Measure("heat", "peak"), at_most=0.1),
        CycleLimit(Measure("y", "percentile", share=0.9), at_most=0.05),
    ]
    over = {
        "scalar and curve": {"c": dataclasses.replace(CURVE, steps=(0.01,))},
        "map with axes": {
            "c": Calibratable(("s", "time"), size=(3, 4), start=0.3, move_axes=True)
        },
        "loop": {"c": Calibratable(("heat", "s"), size=(3, 3), start=0.2)},
        "domain": {"c": dataclasses.replace(CURVE, low=-3, high=3, start=1.3)},
    }[case]
    index = 0.2 if case == "domain" else None
    problem = problem_of(network, over, measures, limits, data, index=index, sharp=0.05)
    free, unravel = ravel_pytree(near(begin_numbers(problem)[0]))
    merit = evaluate_merit(problem, unravel(free))
    multipliers = 0.3 + np.abs(np.asarray(merit.inequalities))
    rest = jax.device_put((multipliers, np.asarray(20.0), np.asarray(1.0)))
    free = np.asarray(free)
    slope = np.asarray(
        ravel_pytree(lagrangian(problem, unravel(jax.device_put(free)), *rest)[1])[0]
    )
    if case == "domain":
        assert float(merit.inequalities[-1]) > 0
    for n in np.argsort(-np.abs(slope))[:3].tolist():
        step = 1e-5 * np.eye(len(free))[n]
        up, down = (
            float(lagrangian(problem, unravel(jax.device_put(free + s)), *rest)[0][0])
            for s in (step, -step)
        )
        # The index has kinks, where the nearest of its points changes.
        close = 1e-3 if case == "domain" else 1e-6
        assert (up - down) / 2e-5 == pytest.approx(slope[n], rel=close, abs=1e-8)


def test_a_loop_over_an_output_of_its_own_is_simulated_sample_by_sample():
    network, data = network_and_cycle()
    curve = Calibratable(("heat",), axes=((-1.0, 1.0),), start=(0.5, -0.5))
    problem = problem_of(network, {"c": curve}, [Measure("y + 1")], data=data)
    run = run_cycle(problem, tuple(m.start for m in problem.maps))
    u, y = np.asarray(run.u)[0, 0], np.asarray(run.y)[0, 0]
    np.testing.assert_allclose(u[1:, 1], -0.5 * y[:-1, 1], atol=1e-12)
    again = np.asarray(network(jnp.asarray(u), "steady"))
    np.testing.assert_allclose(y, again, atol=1e-9)


def test_the_domain_is_kept():
    network, _ = network_and_cycle()
    wide = dataclasses.replace(CURVE, low=-3, high=3, start=0.0)
    maps, wanted = {"c": wide}, [Measure("0 - heat + 5")]
    found = optimised(maps, wanted, plant=network)
    most = np.maximum(found.value.start_index[0], 1.0)
    assert np.all(found.value.index[0] < most + 0.1)
    free = optimised(maps, wanted, plant=network, index=None)
    assert free.value["c"].value.max() > found.value["c"].value.max() + 0.5


def test_several_plants_are_calibrated_together():
    network, _ = network_and_cycle()
    plants = [
        dataclasses.replace(network, gain=network.gain * jnp.ones(4).at[3].set(g))
        for g in (1.0, 1.1, 1.2)
    ]
    limit = CycleLimit(Measure("heat"), at_most=0.1)
    maps, wanted = {"c": CURVE}, [Measure("abs(c - 0.5) + 1")]
    found = optimised(maps, wanted, [limit], plant=plants, draws=0.999)
    alone = optimised(maps, wanted, [limit], plant=plants[0])
    (row,) = found.value.limits
    assert row.kept and row.draws_kept == 1.0
    assert alone.value.limits[0].kept
    assert found.value["c"].value.mean() < alone.value["c"].value.mean()


def test_limits_of_the_start_are_those_of_every_plant_itself():
    network, _ = network_and_cycle()
    plants = [
        dataclasses.replace(network, gain=network.gain * jnp.ones(4).at[3].set(g))
        for g in (1.0, 1.1, 1.2)
    ]
    limit = CycleLimit(Measure("heat"), at_most=1.1, of_start=True)
    problem = problem_of(plants, {"c": CURVE}, [Measure("y + 1")], [limit])
    run = run_cycle(problem, tuple(m.start for m in problem.maps))
    own = measure_run(problem, run).limits
    np.testing.assert_allclose(problem.limit, 1.1 * np.asarray(own), rtol=1e-12)
    ratio = np.asarray(own)[0] / own[0, 0]
    np.testing.assert_allclose(ratio, [1.0, 1.1, 1.2], rtol=1e-9)
    assert float(problem.excess(own)[0]) < 0


def test_a_search_goes_on_where_it_was_stopped(tmp_path):
    limit = CycleLimit(Measure("heat", "peak"), at_most=0.05)
    given = PLANT, cycle(), {"c": CURVE}, [Measure("y + 1")], [limit]

    class Stopped(Exception):
        pass

    def stop(event):
        if event["round"] == 1:
            raise Stopped

    whole = jnx.calibration.optimise(*given)
    with pytest.raises(Stopped):
        jnx.calibration.optimise(*given, folder=tmp_path, progress=stop)
    again = jnx.calibration.optimise(*given, folder=tmp_path)
    assert again.stats["rounds"] == whole.stats["rounds"]
    np.testing.assert_array_equal(again.value["c"].value, whole.value["c"].value)
    with pytest.raises(SpecError, match="another calibration"):
        jnx.calibration.optimise(*given[:4], folder=tmp_path)


def test_a_tighter_limit_costs_more():
    limit = CycleLimit(Measure("heat", "peak"), at_most=0.2)
    told = []
    front = jnx.calibration.trade_off(
        *(
            PLANT,
            cycle(),
            {"c": CURVE},
            [Measure("y + 1")],
            [limit],
            (0.12, 0.08, 0.04),
        ),
        search=CalibrationSearch(smooth=0.0),
        progress=told.append,
    )
    cost = [front[n].value.objective[0].value for n in (0.12, 0.08, 0.04)]
    assert cost == sorted(cost) and all(f.is_okay for f in front.values())
    assert {row["number"] for row in told} == {0.12, 0.08, 0.04}
    alone = CycleLimit(Measure("heat", "peak"), at_most=0.04)
    one = optimised({"c": CURVE}, [Measure("y + 1")], [alone], smooth=0.0)
    assert cost[-1] == pytest.approx(one.value.objective[0].value, rel=1e-3)
    with pytest.raises(SpecError, match="one of 1 limits"):
        jnx.calibration.trade_off(
            *(PLANT, cycle(), {"c": CURVE}, [Measure("y")], [limit], (1.0,)), which=1
        )
    with pytest.raises(SpecError, match="begin has no map"):
        other = {"c": dataclasses.replace(CURVE, axes=((-1.0, 1.0),))}
        begin = front[0.12].value
        jnx.calibration.optimise(PLANT, cycle(), other, [Measure("y")], begin=begin)


def test_a_search_that_begins_at_the_optimum_stays_there():
    given = {"c": CURVE}, [Measure("y + 1")]
    search = CalibrationSearch(smooth=0.0)
    first = jnx.calibration.optimise(PLANT, cycle(), *given, search=search)
    again = jnx.calibration.optimise(
        PLANT, cycle(), *given, search=search, begin=first.value
    )
    value = again.value["c"].value
    np.testing.assert_allclose(value, first.value["c"].value, atol=1e-4)
    assert again.value.objective[0].value < again.value.objective[0].start


def test_a_kept_limit_does_not_hide_steps_that_are_not():
    given = dataclasses.replace(CURVE, start=(-0.9, 0.0, 0.9), away=0.05, steps=(0.1,))
    limit = CycleLimit(Measure("heat"), at_most=5.0)
    found = optimised({"c": given}, [Measure("y + 1")], [limit], rounds=2)
    assert found.status_name == "infeasible" and found.value.kept
    assert "steps or slopes of maps" in found.detail


def test_what_makes_no_sense_is_refused():
    def refused(match, maps=None, objective=None, data=None, **more):
        maps = {"c": CURVE} if maps is None else maps
        objective = [Measure("y")] if objective is None else objective
        with pytest.raises(SpecError, match=match):
            jnx.calibration.optimise(PLANT, data or cycle(), maps, objective, **more)

    refused("at least one map", maps={})
    refused("needs an objective", objective=[])
    refused("no signal load", maps={"c": dataclasses.replace(CURVE, over=("load",))})
    refused("none of the plant's inputs", maps={"d": CURVE})
    refused("needs bounds", maps={"c": Calibratable()})
    refused("within its bounds", maps={"c": dataclasses.replace(CURVE, start=2.0)})
    refused("formula", objective=[Measure("__import__('os')")])
    refused("sample every 1 s", data=cycle(sample_time=1.0))
    refused(
        "functions? has none|a function has none",
        maps={"c": dataclasses.replace(CURVE, over=("heat",))},
    )
    refused("does not change", maps={"c": Calibratable(("wish",), low=0, high=1)})
    refused(
        "the cycle has no s",
        data=cycle(inputs="other"),
        maps={"c": Calibratable(low=0, high=1)},
    )
    hole = cycle()
    hole.records[0].u[7] = np.nan
    with pytest.raises(DataError, match="s has no number in row 8"):
        jnx.calibration.optimise(PLANT, hole, {"c": CURVE}, [Measure("y")])
    with pytest.raises(SpecError, match="must rise"):
        Calibratable(("s",), axes=((1.0, 0.0),))
    with pytest.raises(SpecError, match="tracking needs"):
        Measure("y", "tracking")
    with pytest.raises(SpecError, match="at_most or at_least"):
        CycleLimit(Measure("y"))


def test_a_start_that_diverges_is_told():
    def wild(u):
        return jnp.exp(900 * u[:, :1]) ** 9

    plant = FunctionPlant(
        function=wild, inputs=("s", "c"), outputs=("y",), sample_time=TIME
    )
    found = optimised({"c": CURVE}, [Measure("y")], plant=plant)
    assert found.status_name == "start_diverged"
