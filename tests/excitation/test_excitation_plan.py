"""APRBS plans: the signal, its limits, its derivatives, and how plans are drawn."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from common import device

from jaxnarx.errors import SpecError
from jaxnarx.excitation import (
    AprbsPlan,
    aprbs_plan,
    check_plan,
    discrepancy,
    feasible,
    reachable,
    render,
)

LENGTH = 60
INPUTS = {"fuel": (50.0, 140.0), "egr": (0.0, 60.0), "speed": (1100.0, 1700.0)}
RATE = {"egr": 9.0, "speed": 45.0}


def by_hand(plan: AprbsPlan) -> np.ndarray:
    """Sample by sample: towards the segment's level, by at most the rate."""
    level, hold, rate = map(np.asarray, (plan.level, plan.hold, plan.rate))
    x = np.zeros((plan.length, level.shape[1]))
    for i in range(level.shape[1]):
        aims = np.repeat(level[:, i], hold[:, i])
        aims = np.append(aims, np.full(plan.length, level[-1, i]))[: plan.length]
        now = aims[0]
        for t, aim in enumerate(aims):
            gap = aim - now
            now = aim if abs(gap) <= rate[i] else now + np.sign(gap) * rate[i]
            x[t, i] = now
    return x


def plan(level, hold, *, rate=np.inf, length=LENGTH, low=-10.0, high=10.0):
    level = np.asarray(level, float)
    inputs = level.shape[1]
    ends = (np.full(inputs, end) for end in (rate, low, high))
    return AprbsPlan(
        device(level),
        device(np.asarray(hold)),
        *map(device, ends),
        length=length,
        names=tuple(f"u{i}" for i in range(inputs)),
    )


@pytest.fixture(scope="module")
def hasty():
    """Eight segments of three inputs, one free, two with steps that are not reached."""
    keys = jax.random.split(jax.random.key(8))
    level = jax.random.uniform(keys[0], (8, 3), float, -10, 10)
    made = plan(level, jax.random.randint(keys[1], (8, 3), 3, 10))
    return eqx.tree_at(lambda p: p.rate, made, device(np.array([np.inf, 1.0, 1.5])))


@pytest.fixture(scope="module")
def slow(hasty):
    """The same, in reach."""
    return reachable(hasty)


# the signal -----------------------------------------------------------------------


def test_the_signal_is_the_one_made_sample_by_sample(hasty, slow):
    # A sum of at most ten moves against one product: some ulp of 10.
    for each in (hasty, slow):
        np.testing.assert_allclose(render(each), by_hand(each), atol=1e-13)


def test_the_slope_is_limited_whatever_the_levels(hasty):
    slope = np.abs(np.diff(render(hasty), axis=0)).max(axis=0)
    assert np.all(slope <= np.asarray(hasty.rate) * (1 + 1e-12))
    np.testing.assert_allclose(slope[1:], hasty.rate[1:], rtol=1e-12)


def test_a_free_plan_is_its_levels(slow):
    free = eqx.tree_at(lambda p: p.rate, slow, device(np.full(3, np.inf)))
    expected = np.repeat(*(np.asarray(a)[:, 0] for a in (slow.level, slow.hold)))
    found = np.asarray(render(free))[:, 0][: len(expected)]
    np.testing.assert_array_equal(found, expected[: len(found)])


def test_the_last_segment_lasts_to_the_end():
    short = plan([[1.0], [2.0]], [[3], [4]], length=20)
    np.testing.assert_array_equal(np.asarray(render(short))[3:], 2.0)


def test_segments_after_the_end_have_no_effect(slow):
    hold = np.array(slow.hold)
    hold[-1] = LENGTH
    more = plan(
        np.concatenate([slow.level, np.full((4, 3), 1e6)]),
        np.concatenate([hold, np.full((4, 3), 2)]),
    )
    more = eqx.tree_at(lambda p: p.rate, more, slow.rate)
    np.testing.assert_array_equal(render(more), render(slow))
    assert feasible(more) and not np.any(np.asarray(more.used)[8:])
    check_plan(more)
    gradient = jax.jit(jax.grad(lambda level: weighted(more, level)))(more.level)
    np.testing.assert_array_equal(np.asarray(gradient)[8:], 0.0)


def weighted(plan, level):
    """A smooth number of the signal."""
    x = render(eqx.tree_at(lambda p: p.level, plan, level))
    time = jnp.arange(plan.length, dtype=x.dtype)
    return jnp.vdot(x**2, jnp.cos(time)[:, None] * jnp.ones_like(x))


@pytest.mark.parametrize("which", ["hasty", "slow"])
def test_derivatives_to_the_levels(which, request):
    made = request.getfixturevalue(which)
    if which == "slow":
        # Off the border of what is reached, where the signal has a kink.
        made = eqx.tree_at(
            lambda p: p.level, made, device(0.9 * np.asarray(made.level))
        )

    @jax.jit
    def value(level):
        return weighted(made, level)

    here, tangent, h = (
        np.asarray(made.level),
        np.sin(np.arange(24.0)).reshape(8, 3),
        1e-5,
    )
    slope = jax.jvp(value, (made.level,), (device(tangent),))[1]
    ends = [float(value(here + s * h * tangent)) for s in (1, -1)]
    # Quadratic between kinks, so the central difference is exact up to eps / h.
    np.testing.assert_allclose(slope, (ends[0] - ends[1]) / (2 * h), rtol=1e-6)
    backward = np.vdot(jax.grad(value)(made.level), tangent)
    np.testing.assert_allclose(backward, slope, rtol=1e-12)


@pytest.mark.slow
def test_plans_can_be_stacked(hasty, slow):
    stacked = jax.tree.map(lambda a, b: jnp.stack([a, b]), hasty, slow)
    together = eqx.filter_vmap(render)(stacked)
    for found, each in zip(together, (hasty, slow), strict=True):
        np.testing.assert_allclose(found, render(each), rtol=1e-14)


# limits ---------------------------------------------------------------------------


def test_reachable_levels_are_those_at_the_ends_of_the_segments(hasty, slow):
    x, ends = by_hand(hasty), np.cumsum(np.asarray(hasty.hold), axis=0) - 1
    for i in range(3):
        here = ends[:, i] < LENGTH
        level = np.asarray(slow.level)[here, i]
        np.testing.assert_allclose(level, x[ends[here, i], i], atol=1e-13)
    np.testing.assert_allclose(render(slow), render(hasty), atol=1e-13)


def test_reaching_is_a_projection(hasty, slow):
    assert not feasible(hasty) and feasible(slow)
    np.testing.assert_array_equal(reachable(slow).level, slow.level)
    ours, theirs = (np.asarray(p.level)[:, 0] for p in (slow, hasty))
    np.testing.assert_array_equal(ours, theirs)
    far = device(100 * np.asarray(hasty.level))
    tame = reachable(eqx.tree_at(lambda p: p.level, hasty, far))
    assert feasible(tame) and np.abs(tame.level).max() == 10
    assert np.abs(render(tame)).max() <= 10


@pytest.mark.parametrize(
    ("level", "rate", "fits"),
    [(6.0, 2.0, True), (6.01, 2.0, False), (-6.01, 2.0, False), (10.01, 9.0, False)],
)
def test_a_step_is_possible_if_its_hold_is_long_enough(level, rate, fits):
    # Three samples at 2 per sample reach 6.
    made = plan([[0.0], [level]], [[5], [3]], rate=rate)
    assert feasible(made) == fits
    if fits:
        check_plan(made)
        return
    with pytest.raises(SpecError, match=r"'u0'.* 1"):
        check_plan(made)


def test_what_is_impossible_is_named_with_advice():
    made = plan([[0.0, 0.0], [1.0, 5.0]], [[4, 2], [4, 2]], rate=1.0)
    with pytest.raises(SpecError) as caught:
        check_plan(made)
    assert caught.value.field == "rate"
    for part in ("'u1', segment 1", "of 5 ", "rate of 2.5", "limit is 1", "20 are eno"):
        assert part in str(caught.value)
    assert "at least 5 samples" in str(caught.value)


@pytest.mark.parametrize(
    ("where", "value", "field"),
    [
        ("level", np.nan, "level"),
        ("level", 11.0, "level"),
        ("rate", 0.0, "rate"),
        ("rate", np.nan, "rate"),
        ("low", 10.5, "u0"),
        ("high", np.inf, "u0"),
        ("hold", 0, "hold"),
    ],
)
def test_plans_that_make_no_sense_are_refused(where, value, field):
    made = plan([[0.0], [1.0]], [[4], [4]])
    there = np.asarray(getattr(made, where))
    full = device(np.full_like(there, value))
    wrong = eqx.tree_at(lambda p: getattr(p, where), made, full)
    with pytest.raises(SpecError) as caught:
        check_plan(wrong)
    assert caught.value.field == field
    with pytest.raises(SpecError, match="name for each input"):
        AprbsPlan(
            made.level, made.hold, made.rate, made.low, made.high, LENGTH, ("a", "b")
        )


# random plans ---------------------------------------------------------------------


def request(**changes):
    return {"inputs": INPUTS, "hold": (15, 40), "rate": RATE} | changes


@pytest.mark.parametrize("placement", ["latin", "sobol", "uniform"])
def test_a_random_plan_keeps_its_limits(key, placement):
    made = aprbs_plan(key, 2000, **request(placement=placement))
    check_plan(made)
    x = np.asarray(render(made))
    assert x.shape == (2000, 3) and made.names == tuple(INPUTS)
    low, high = np.array(list(INPUTS.values())).T
    assert np.all((x >= low) & (x <= high))
    slope = np.abs(np.diff(x, axis=0)).max(axis=0)
    assert np.all(slope[1:] <= np.array([9.0, 45.0]) * (1 + 1e-12))
    assert np.all(np.asarray(made.hold) >= 15) and np.all(np.asarray(made.hold) <= 40)


def test_the_key_decides(key):
    first, again = (aprbs_plan(key, 500, **request()) for _ in range(2))
    other = aprbs_plan(jax.random.key(1), 500, **request())
    assert eqx.tree_equal(first, again) and not eqx.tree_equal(first, other)


def test_every_input_visits_each_of_its_strata_once(key):
    hold = {"fuel": (10, 20), "egr": (10, 40), "speed": (50, 90)}
    made = aprbs_plan(key, 3000, **request(hold=hold, rate=None))
    used = np.asarray(made.used)
    assert len(set(used.sum(axis=0))) == 3, "inputs differ in their segments"
    level, low, high = (np.asarray(a) for a in (made.level, made.low, made.high))
    share = (level - low) / (high - low)
    for i, n in enumerate(used.sum(axis=0)):
        stratum = np.sort(np.floor(share[:n, i] * n))
        np.testing.assert_array_equal(stratum, np.arange(n))


@pytest.mark.slow
def test_together_the_placed_combinations_are_visited(key):
    made = aprbs_plan(key, 1000, **request(rate=None, together=True))
    x = np.asarray(render(made))
    assert len(np.unique(x, axis=0)) == len(made.level) == int(made.used[:, 0].sum())
    apart = np.asarray(render(aprbs_plan(key, 1000, **request(rate=None))))
    assert len(np.unique(apart, axis=0)) > len(made.level)


def test_placed_combinations_are_more_even_than_drawn_ones():
    def mean(placement):
        plans = [
            aprbs_plan(
                jax.random.key(seed),
                1500,
                **request(hold=(25, 25), rate=None, placement=placement),
            )
            for seed in range(6)
        ]
        return np.mean([discrepancy(p.level, p.low, p.high) for p in plans])

    uniform = mean("uniform")
    # 60 points in three inputs.
    assert mean("latin") < 0.9 * uniform and mean("sobol") < 0.7 * uniform


def test_steps_too_large_are_refused_or_shortened(key):
    slow = request(rate={"speed": 10.0})
    with pytest.raises(SpecError, match="input 'speed', segment") as caught:
        aprbs_plan(key, 500, **slow)
    assert caught.value.field == "rate" and "60 are enough" in str(caught.value)
    made = aprbs_plan(key, 500, **slow, shorten=True)
    assert feasible(made)
    np.testing.assert_array_equal(reachable(made).level, made.level)


@pytest.mark.parametrize(
    ("wrong", "field", "text"),
    [
        ({"inputs": {}}, "inputs", "at least one"),
        ({"inputs": {"fuel": (2.0, 1.0)}, "rate": None}, "fuel", "low <= high"),
        ({"hold": (0, 4)}, "hold", "at least 1"),
        ({"hold": {"fuel": (1, 2)}}, "hold", "'egr'"),
        ({"rate": {"sped": 1.0}}, "rate", "'speed'"),
        ({"rate": 0.0}, "rate", "above zero"),
        ({"length": 0}, "length", "at least 1"),
        (
            {
                "hold": {"fuel": (1, 2), "egr": (1, 2), "speed": (1, 3)},
                "together": True,
            },
            "hold",
            "same hold",
        ),
    ],
)
def test_impossible_requests_are_refused(key, wrong, field, text):
    wrong = request() | {"length": 100} | wrong
    with pytest.raises(SpecError, match=text) as caught:
        aprbs_plan(key, wrong.pop("length"), **wrong)
    assert caught.value.field == field
