"""Kernels of the fused identification one by one, against plain versions."""

import jax.numpy as jnp
import numpy as np
import pytest
from identify_problems import METHOD, engine, fleet_of

from jaxnarx.errors import SpecError
from jaxnarx.methods import Case, Identification
from jaxnarx.regressors import polynomial_pool
from jaxnarx.simulation import IN_A_ROW
from jaxnarx.simulation import has_diverged as on_host
from jaxnarx.sweep.identify.divide import Rows, clusters
from jaxnarx.sweep.identify.frame import make_frame, make_pool
from jaxnarx.sweep.identify.score import has_diverged
from jaxnarx.sweep.identify.settings import allowed_variables
from jaxnarx.sweep.identify.train import FULL, schedule
from jaxnarx.sweep.identify.work import IdentificationWork


def test_divergence_is_judged_as_on_the_host():
    rng = np.random.default_rng(0)
    time, found = 400, []
    for share in (0.0, 0.02, 0.04, 0.049, 0.051, 0.06, 0.3):
        for start, end in ((0, 400), (7, 350), (390, 400), (400, 400), (400, 0)):
            limited = rng.uniform(size=(1, time)) < share
            ends = jnp.array([start]), jnp.array([end])
            ours = bool(has_diverged(jnp.asarray(limited), *ends))
            assert ours == on_host(limited[0, start:end])
            found.append(ours)
    assert {True, False} == set(found)
    for length in (IN_A_ROW - 1, IN_A_ROW):
        limited = np.zeros((2, 2000), bool)
        limited[1, 300 : 300 + length] = True
        ends = jnp.array([5, 5]), jnp.array([2000, 2000])
        ours = bool(has_diverged(jnp.asarray(limited), *ends))
        assert ours == on_host(limited[1, 5:]) == (length == IN_A_ROW)


def test_clusters_find_clear_groups_and_pass_over_weightless_samples():
    rng = np.random.default_rng(1)
    middle = np.array([[0.2, 0.2], [0.8, 0.3], [0.5, 0.9]])
    z = (middle[:, None] + 0.02 * rng.normal(size=(3, 50, 2))).reshape(-1, 2)
    weight = np.ones(len(z))
    weight[::7] = 0.0
    far = np.where(weight[:, None] > 0, z, 50.0)
    y = jnp.zeros(len(z))
    rows = Rows(y[None], jnp.asarray(far.T), y, jnp.asarray(weight))
    start = jnp.array([[0.3, 0.1], [0.6, 0.4], [0.5, 0.6], [0.2, 0.2]])
    active = jnp.array([True, True, True, False])
    centre, spread = clusters(rows, start, active)
    for m in range(3):
        own = z[50 * m : 50 * m + 50][weight[50 * m : 50 * m + 50] > 0]
        np.testing.assert_allclose(centre[m], own.mean(axis=0), atol=1e-12)
        # The spread is a difference of squares near 0.6: eps over the deviation.
        np.testing.assert_allclose(spread[m], own.std(axis=0), atol=1e-12)
    np.testing.assert_array_equal(centre[3], start[3])


def test_lag_limits_narrow_the_variables():
    channels = engine(1).channels
    pool = polynomial_pool(channels, input_lags=(0, 2), output_lags=(1, 3), degree=1)
    assert pool.variable_names == [
        "a[t]",
        "a[t-2]",
        "b[t]",
        "b[t-2]",
        "y[t-1]",
        "y[t-3]",
    ]

    def kept(lags):
        allowed = allowed_variables(Case(lags=lags), pool)
        assert allowed[0]
        pairs = zip(pool.variable_names, allowed[1:], strict=True)
        return [name for name, there in pairs if there]

    assert kept(None) == pool.variable_names
    assert kept(1) == ["a[t]", "b[t]", "y[t-1]"]
    assert kept({"a": -1, "y": 2}) == ["b[t]", "b[t-2]", "y[t-1]"]
    with pytest.raises(SpecError, match="lags names 'c'"):
        kept({"c": 1})


def test_the_schedule_takes_stock_at_the_head_of_every_stage():
    turns = schedule(
        Identification(["a[t]"], horizons=(5, 20), window_steps=2, steps=3)
    )
    assert turns.horizon.tolist() == [5] * 3 + [20] * 3 + [FULL] * 7
    assert turns.step.tolist() == [0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2, 3]
    # Coefficients alone, on full records too, before everything.
    assert turns.apart.tolist() == [True] * 9 + [False] * 4
    assert turns.last.tolist() == [False] * 9 + [True] * 4
    one_step = schedule(
        Identification(["a[t]"], horizons=(5,), steps=2, objective="prediction")
    )
    assert one_step.horizon.tolist() == [1, 1, 1]


def test_one_output_is_identified_at_a_time():
    channels = engine(1).channels
    pool = make_pool(METHOD, channels)
    assert make_frame(METHOD, pool).constant == 0
    with pytest.raises(SpecError, match="unknown output 'z'"):
        make_pool(Identification(["a[t]"], output="z"), channels)


def test_work_refuses_what_does_not_fit():
    fleet = fleet_of({"a": engine(1)})
    with pytest.raises(SpecError, match="max_terms"):
        IdentificationWork(fleet, METHOD, [Case(terms=6)])
    with pytest.raises(SpecError, match="at least one case"):
        IdentificationWork(fleet, METHOD, [])
    with pytest.raises(SpecError, match="lanes"):
        IdentificationWork(fleet, METHOD, lanes=0)
    with pytest.raises(SpecError, match="'aa'.*Did you mean 'a'"):
        IdentificationWork(fleet, Identification(["aa[t]"]))
