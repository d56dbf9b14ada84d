"""Kernels of the fused identification one by one, against plain versions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from identify_problems import METHOD, engine, fleet_of

from jaxnarx.errors import SpecError
from jaxnarx.identification import joint_pool, make_pool, terms_of
from jaxnarx.partition.clusters import clusters
from jaxnarx.partition.stages import best_stage, choose_stage
from jaxnarx.settings import (
    Lolimot,
    Polynomial,
    PredictionError,
    SigmoidTree,
    SimulationError,
)
from jaxnarx.settings.tree import replace_at
from jaxnarx.simulation import has_diverged
from jaxnarx.simulation.trajectories import IN_A_ROW
from jaxnarx.sweep.identify.engine_data import Part
from jaxnarx.sweep.identify.refine_step import WHOLE_RECORD, schedule
from jaxnarx.sweep.identify.score import count_samples
from jaxnarx.sweep.identify.settings import shapes
from jaxnarx.sweep.identify.work import IdentificationWork


def part_of(start: list[int], end: list[int], time: int) -> Part:
    """A part of which nothing but the records' ends matters."""
    shape = len(start), time, 1
    nothing = np.zeros(shape)
    flags = nothing[..., 0].astype(bool)
    ends = np.array(start), np.array(end)
    return Part(nothing, nothing.astype(bool), *ends, flags, nothing.astype(bool))


def test_divergence_is_judged_as_of_the_record_alone():
    rng = np.random.default_rng(0)
    time, found = 400, []
    for share in (0.0, 0.02, 0.04, 0.049, 0.051, 0.06, 0.3):
        for start, end in ((0, 400), (7, 350), (390, 400), (400, 400), (400, 0)):
            limited = rng.uniform(size=(1, time)) < share
            within = count_samples(part_of([start], [end], time))
            ours = bool(has_diverged(jnp.asarray(limited), within)[0])
            assert ours == has_diverged(limited[0, start:end])
            found.append(ours)
    assert {True, False} == set(found)
    for length in (IN_A_ROW - 1, IN_A_ROW):
        limited = np.zeros((2, 2000), bool)
        limited[1, 300 : 300 + length] = True
        within = count_samples(part_of([5, 5], [2000, 2000], 2000))
        ours = np.asarray(has_diverged(jnp.asarray(limited), within))
        assert ours.tolist() == [False, length == IN_A_ROW]
        assert ours[1] == has_diverged(limited[1, 5:])


def test_clusters_find_clear_groups_and_pass_over_weightless_samples():
    rng = np.random.default_rng(1)
    middle = np.array([[0.2, 0.2], [0.8, 0.3], [0.5, 0.9]])
    z = (middle[:, None] + 0.02 * rng.normal(size=(3, 50, 2))).reshape(-1, 2)
    weight = np.ones(len(z))
    weight[::7] = 0.0
    far = np.where(weight[:, None] > 0, z, 50.0)
    start = jnp.array([[0.3, 0.1], [0.6, 0.4], [0.5, 0.6], [0.2, 0.2]])
    active = jnp.array([True, True, True, False])
    centre, spread = clusters(jnp.asarray(far.T), jnp.asarray(weight), start, active)
    for m in range(3):
        own = z[50 * m : 50 * m + 50][weight[50 * m : 50 * m + 50] > 0]
        np.testing.assert_allclose(centre[m], own.mean(axis=0), atol=1e-12)
        # The spread is a difference of squares near 0.6: eps over the deviation.
        np.testing.assert_allclose(spread[m], own.std(axis=0), atol=1e-12)
    np.testing.assert_array_equal(centre[3], start[3])


def test_cases_choose_among_the_terms_of_one_pool():
    channels = engine(1).channels
    wide = Polynomial(input_lags=(0, 2), output_lags=(1, 3), degree=1)
    few = Polynomial(input_lags={"b": (0,)}, output_lags=(1,), degree=1)
    other = Polynomial(input_lags=(1,), output_lags=(), degree=2)
    pool = joint_pool([wide, few, other], channels)
    assert pool.degree == 2
    assert pool.variable_names == [
        *("a[t]", "a[t-1]", "a[t-2]", "b[t]", "b[t-1]", "b[t-2]"),
        *("y[t-1]", "y[t-3]"),
    ]
    for method in (wide, few, other):
        own = make_pool(method, channels).names
        there = terms_of(method, pool)
        assert sorted(np.array(pool.names)[there]) == sorted(own)
    assert joint_pool([wide, wide], channels).names == make_pool(wide, channels).names
    two = Polynomial(outputs=["z"])
    with pytest.raises(SpecError, match="unknown output 'z'"):
        joint_pool([wide, two], channels)


def test_the_schedule_takes_stock_at_the_head_of_every_stage():
    turns = schedule(SimulationError(horizons=(5, 20), window_steps=2), 3)
    assert turns.horizon.tolist() == [5] * 3 + [20] * 3 + [WHOLE_RECORD] * 7
    assert turns.step.tolist() == [0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2, 3]
    # Coefficients alone, on full records too, before everything.
    assert turns.apart.tolist() == [True] * 9 + [False] * 4
    assert turns.last.tolist() == [False] * 9 + [True] * 4
    one_step = schedule(PredictionError(), 2)
    assert one_step.horizon.tolist() == [1, 1, 1]


def test_cases_that_differ_in_numbers_share_a_program():
    cases = [
        {},
        {"select.max_terms": 2, "refine.train": "joint", "grow.k_sigma": 0.5},
        {"refine": "none", "grow.max_models": 5, "pool.degree": 1},
        {"grow": "tree"},
        {"grow.criterion": "validation"},
        {"select": "stepwise"},
        {"refine.loss": "huber"},
    ]
    found = shapes([replace_at(METHOD, case) for case in cases])
    assert found[0] == found[1] == found[2] != found[3]
    assert found[4:] == [None] * 3
    shape, tree = found[0], found[3]
    assert shape is not None and tree is not None
    assert (shape.terms, shape.models, shape.steps) == (5, 5, 3)
    assert isinstance(tree.grow, SigmoidTree)


def test_the_stage_is_chosen_as_on_the_host():
    rng = np.random.default_rng(3)
    best_of = jax.jit(best_stage, static_argnames=("criterion", "patience"))
    for n in range(40):
        sse = np.sort(rng.uniform(1.0, 3.0, 6))[::-1]
        effective = 5.0 * np.arange(1, 7) + rng.uniform(size=6)
        count = np.minimum(np.arange(1, 7), 3 + n % 4)
        for criterion in ("aicc", "bic", "none"):
            method = Lolimot(["a[t]"], max_models=6, criterion=criterion)
            best, _ = choose_stage(count, sse, effective, 60.0, method)
            ours = best_of(
                *(sse, effective, count, 60.0, 6),
                criterion=criterion,
                patience=method.patience,
            )
            assert int(ours) == best, (criterion, sse)


def test_work_refuses_what_does_not_fit():
    fleet = fleet_of({"a": engine(1)})
    with pytest.raises(SpecError, match="at least one case"):
        IdentificationWork(fleet, METHOD, [])
    with pytest.raises(SpecError, match="lanes"):
        IdentificationWork(fleet, METHOD, lanes=0)
    with pytest.raises(SpecError, match="'grow.max_model'.*Did you mean"):
        IdentificationWork(fleet, METHOD, [{"grow.max_model": 2}])
    with pytest.raises(SpecError, match="'aa'.*Did you mean 'a'"):
        IdentificationWork(fleet, METHOD, [{"grow.scheduling": ["aa[t]"]}])
