"""PRBS, random walk, multisine, chirp, ramps and limits against their definitions."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

from jaxnarx.errors import SpecError
from jaxnarx.excitation import (
    chirp,
    crest_factor,
    driving_cycle,
    limit_slope,
    multisine,
    prbs,
    ramps,
    random_drive,
    random_walk,
    steps,
)


def made(function, *args, **request) -> np.ndarray:
    """A signal, made in one program."""
    return np.asarray(jax.jit(lambda: function(*args, **request))())


# pseudo-random binary sequence ----------------------------------------------------


@pytest.mark.parametrize("order", [2, 3, 6, 11])
def test_the_autocorrelation_of_a_period_has_two_values(order):
    period = 2**order - 1
    x = made(prbs, period, amplitude=(-1.0, 1.0), order=order)
    assert set(x) == {-1.0, 1.0}
    found = np.fft.ifft(np.abs(np.fft.fft(x)) ** 2).real
    # Whole numbers, off by the rounding of the transform.
    np.testing.assert_allclose(found, [period] + [-1] * (period - 1), atol=1e-9)


def test_the_clock_repeats_and_the_order_follows_from_the_length():
    x = made(prbs, 300, amplitude=(2.0, 5.0), clock=5)
    # 60 clocks need order 6, whose period is 63.
    np.testing.assert_array_equal(x, np.repeat(x[::5], 5))
    expected = made(prbs, 60, amplitude=(2.0, 5.0), order=6)
    np.testing.assert_array_equal(x[::5], expected)


def test_a_shift_begins_later_in_the_same_period():
    period = made(prbs, 31, amplitude=(0.0, 1.0), order=5)
    for shift in (1, 12, 31 + 12):
        found = made(prbs, 40, amplitude=(0.0, 1.0), order=5, shift=shift)
        np.testing.assert_array_equal(found, np.resize(np.roll(period, -shift), 40))


# random walk ----------------------------------------------------------------------


def between_mirrors(start, moves, low, high):
    """Each move taken by hand, the direction turned at every mirror."""
    x, sign, path = start, 1.0, []
    for move in moves:
        x += sign * move
        while not low <= x <= high:
            x, sign = (2 * low - x if x < low else 2 * high - x), -sign
        path.append(x)
    return np.array(path)


@pytest.mark.parametrize("step", [0.3, 7.0])
def test_the_walk_is_reflected_as_light_between_mirrors(key, step):
    low, high, length = -1.0, 2.0, 2000
    found = made(random_walk, key, length, amplitude=(low, high), step=step)
    moves = np.array(jax.random.uniform(key, (length,), float, -step, step))
    moves[0] = 0
    # Rounding of a sum of 2000 numbers of at most 7.
    np.testing.assert_allclose(
        found, between_mirrors(0.5, moves, low, high), atol=1e-10
    )
    assert low <= found.min() and found.max() <= high
    assert np.abs(np.diff(found)).max() <= step


def test_the_walk_holds_starts_and_stays(key):
    x = made(random_walk, key, 10, amplitude=(0, 1.0), step=0.1, hold=3, start=0.9)
    np.testing.assert_array_equal(x[:3], 0.9)
    np.testing.assert_array_equal(x, np.repeat(x[::3], 3)[:10])
    still = made(random_walk, key, 5, amplitude=(4.0, 4.0), step=1.0)
    np.testing.assert_array_equal(still, 4.0)


# multisine ------------------------------------------------------------------------

HARMONICS = (1, 2, 3, 5, 8, 13, 21)


def lines(signal) -> np.ndarray:
    """Complex amplitudes of the cosines of a full period."""
    return 2 * np.fft.rfft(np.asarray(signal)) / len(signal)


@pytest.mark.parametrize("random", [False, True])
def test_only_the_chosen_harmonics_are_there(key, random):
    weights = [1.0, 1.0, 2.0, 1.0, 0.5, 1.0, 3.0]
    request = {"harmonics": HARMONICS, "weights": weights, "amplitude": (-3.0, 5.0)}
    x = made(multisine, 64, **request, key=key if random else None)
    size = np.abs(lines(x))[list(HARMONICS)]
    np.testing.assert_allclose(size / size[0], weights, rtol=1e-12)
    others = np.setdiff1d(np.arange(1, 33), HARMONICS)
    assert np.abs(lines(x))[others].max() < 1e-12
    # Symmetric about the middle, 1, and touching the range on one side.
    assert abs(x.mean() - 1) < 1e-12 and abs(np.abs(x - 1).max() - 4) < 1e-12


def test_phases_are_schroeders():
    count = 30
    x = made(multisine, 256, harmonics=range(1, count + 1), amplitude=(-1.0, 1.0))
    k = np.arange(1, count + 1)
    expected = np.exp(-1j * np.pi * k * (k - 1) / count)
    found = lines(x)[1 : count + 1]
    np.testing.assert_allclose(found / np.abs(found), expected, atol=1e-11)
    # In phase, the crest factor is sqrt(2 K) = 7.7; Schroeder's reaches about 1.7.
    assert made(crest_factor, jnp.asarray(x)) < 1.8
    shuffled = made(multisine, 256, harmonics=k[::-1].tolist(), amplitude=(-1.0, 1.0))
    np.testing.assert_array_equal(x, shuffled)


def test_a_multisine_repeats_after_its_period():
    x = made(multisine, 100, harmonics=[1, 4], amplitude=(0.0, 1.0), period=30)
    np.testing.assert_array_equal(x[30:], x[:70])


def test_crest_factors_of_simple_signals():
    t, factor = np.arange(64.0), jax.jit(crest_factor)
    for signal, expected in [
        (np.cos(2 * np.pi * t / 16), np.sqrt(2)),
        (np.where(t % 2 == 0, 1.0, -1.0), 1.0),
        (np.full(64, 2.0), 1.0),
    ]:
        for same in (signal, 3 - 5 * signal):
            np.testing.assert_allclose(factor(same), expected, rtol=1e-12)


# chirp ----------------------------------------------------------------------------


@pytest.mark.parametrize("sweep", ["linear", "logarithmic"])
@pytest.mark.parametrize("frequency", [(0.5, 20.0), (20.0, 0.5), (3.0, 3.0)])
def test_a_chirp_is_scipys(sweep, frequency):
    request = {"frequency": frequency, "amplitude": (1.0, 5.0), "sample_time": 0.01}
    found = chirp(1001, sweep=sweep, **request)
    t = np.arange(1001) * 0.01
    wave = scipy.signal.chirp(t, frequency[0], 10.0, frequency[1], sweep, phi=-90)
    # The phase reaches 1000 rad, which rounds to 1e-13.
    np.testing.assert_allclose(found, 3 + 2 * wave, atol=1e-11)


# limits and ramps -----------------------------------------------------------------

RATE = {"rate": 3.0, "sample_time": 0.1}


def followed(signal, move, low, high):
    aims = np.clip(signal, low, high)
    path = [aims[0]]
    for aim in aims[1:]:
        path.append(path[-1] + np.clip(aim - path[-1], -move, move))
    return np.array(path)


@jax.jit
def held(x):
    return limit_slope(x, low=-0.8, high=0.6, **RATE)


@pytest.fixture(scope="module")
def rough():
    return jax.random.normal(jax.random.key(3), (200,), float)


def test_limits_are_kept_sample_by_sample(rough):
    found = np.asarray(held(rough))
    np.testing.assert_allclose(found, followed(rough, 0.3, -0.8, 0.6), atol=1e-14)
    assert np.abs(np.diff(found)).max() <= 0.3 * (1 + 1e-12)
    np.testing.assert_array_equal(held(found), found)


def test_what_does_not_limit_changes_nothing(rough):
    np.testing.assert_array_equal(limit_slope(rough), rough)
    np.testing.assert_array_equal(limit_slope(rough, rate=1e3, sample_time=0.1), rough)
    np.testing.assert_array_equal(limit_slope(rough, low=0.0), np.maximum(rough, 0.0))


def test_the_limiter_is_differentiated_as_it_acts(rough):
    @jax.jit
    def weighted(x):
        return jnp.vdot(held(x), jnp.cos(jnp.arange(200.0)))

    here, tangent, h = np.asarray(rough), np.sin(np.arange(200.0)), 1e-6
    slope = jax.jvp(weighted, (rough,), (jax.device_put(tangent),))[1]
    ends = [float(weighted(here + s * h * tangent)) for s in (1, -1)]
    # Piecewise linear: only the rounding of the difference, about eps / h, is left.
    np.testing.assert_allclose(slope, (ends[0] - ends[1]) / (2 * h), rtol=1e-7)
    backward = np.vdot(jax.grad(weighted)(rough), tangent)
    np.testing.assert_allclose(backward, slope, rtol=1e-12)


def test_ramps_are_limited_steps():
    levels, hold = [1.0, 2.0, -0.55, -0.55, 0.0], 4
    found = np.asarray(ramps(levels, hold=hold, **RATE))
    moving = np.ceil(np.abs(np.diff(levels)) / 0.3 - 1e-9).clip(1) - 1
    stairs = np.repeat(levels, [hold, *(hold + moving.astype(int))])
    np.testing.assert_allclose(
        found, limit_slope(jnp.asarray(stairs), **RATE), atol=1e-14
    )
    # An exact multiple of the slope takes no sample more.
    assert len(ramps([0.0, 0.3], hold=1, **RATE)) == 2


def test_every_ramp_may_have_its_own_rate():
    x = ramps([0.0, 1.0, 0.0], rate=[1.0, 5.0], hold=2, sample_time=0.1)
    assert len(x) == 2 + 9 + 2 + 1 + 2
    np.testing.assert_allclose(x[2:11], np.arange(1, 10) * 0.1, rtol=1e-14)
    np.testing.assert_array_equal(ramps([2.0], rate=1, hold=3, sample_time=1), 2.0)
    np.testing.assert_array_equal(
        ramps([0.0, 1.0], rate=1e9, hold=3, sample_time=1.0), steps([0.0, 1.0], hold=3)
    )


# driving cycle --------------------------------------------------------------------


@pytest.mark.parametrize("step", [0.1, 1.0])
def test_the_european_cycle_has_its_published_length_and_distance(step):
    """1180 s, 11.0 km, 120 km/h at most and 33.6 km/h on average."""
    speed = np.asarray(driving_cycle(sample_time=step))
    assert speed.shape == (round(1180 / step) + 1,)
    assert speed.min() == 0 and speed.max() == 120
    # every corner lies on a whole second, so that trapezoids are exact
    distance = np.trapezoid(speed / 3.6, dx=step)
    assert distance == pytest.approx(11_007, abs=15)
    assert 3.6 * distance / 1180 == pytest.approx(33.6, abs=0.05)


def test_phases_follow_each_other_and_accelerations_are_those_of_the_table():
    urban = np.asarray(driving_cycle(sample_time=1, phases=["urban"]))
    extra = np.asarray(driving_cycle(sample_time=1, phases=["extra-urban"]))
    assert (len(urban), len(extra)) == (196, 401)
    whole = np.asarray(driving_cycle(sample_time=1))
    np.testing.assert_array_equal(whole, [*np.tile(urban[:-1], 4), *extra])
    # 1.04 m/s2 for the first start, 1.39 m/s2 for the last stop; two digits are given
    assert np.diff(whole).max() / 3.6 == pytest.approx(1.04, abs=0.01)
    assert np.diff(whole).min() / 3.6 == pytest.approx(-1.39, abs=0.01)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_random_drive_goes_from_town_to_the_motorway(seed):
    step, end = 0.5, 3600.0
    speed = np.asarray(
        random_drive(jax.random.key(seed), sample_time=step, duration=end)
    )
    assert speed.shape == (round(end / step) + 1,)
    assert speed[0] == speed[-1] == 0 and speed.min() == 0 and 90 < speed.max() < 145
    slope = np.abs(np.diff(speed)) / 3.6 / step
    assert slope.max() <= 1.3 + 1e-9
    town, country, motorway = np.split(speed[:-1], 3)
    # What is begun on a road is driven to its end on the next one.
    assert town.max() <= 60 and np.mean(town == 0) > 0.05
    assert np.median(country) == pytest.approx(75, abs=12)
    assert np.median(motorway) == pytest.approx(117, abs=18)
    other = random_drive(jax.random.key(seed + 7), sample_time=step, duration=end)
    assert not np.array_equal(speed, other)


# what is refused ------------------------------------------------------------------

UNIT = {"amplitude": (0.0, 1.0)}
RAMPS = {"levels": [0.0, 1.0, 0.0], "rate": 1.0, "hold": 2, "sample_time": 0.1}
WALK = UNIT | {"length": 10, "step": 0.1}
CHIRP = UNIT | {"length": 100, "frequency": (1.0, 5.0), "sample_time": 0.01}
SINES = UNIT | {"length": 64, "harmonics": [1]}


def walk(**request):
    return random_walk(jax.random.key(1), **request)


def drive(**request):
    return random_drive(jax.random.key(1), **request)


def actuator(**request):
    return limit_slope(jax.device_put(np.zeros(9)), **request)


IMPOSSIBLE: list[tuple[Callable[..., Any], dict[str, Any], dict[str, list]]] = [
    (prbs, UNIT | {"length": 9}, {"length": [0], "order": [1, 25], "clock": [0]}),
    (prbs, UNIT | {"length": 9}, {"shift": [-1], "amplitude": [(1.0, -1.0)]}),
    (walk, WALK, {"step": [0.0], "start": [2.0], "hold": [0]}),
    (multisine, SINES, {"harmonics": [[1, 32], [0], [2, 2], []], "period": [0]}),
    (multisine, SINES, {"weights": [[1.0, 2.0], [-1.0]], "amplitude": [(0.0, np.inf)]}),
    (chirp, CHIRP, {"frequency": [(1.0, 51.0), (-1.0, 5.0), (np.nan, 5.0)]}),
    (chirp, CHIRP | {"sweep": "logarithmic"}, {"frequency": [(0.0, 5.0)]}),
    (chirp, CHIRP, {"sample_time": [0.0]}),
    (actuator, {"sample_time": 0.1}, {"rate": [0.0, np.inf]}),
    (actuator, {"rate": 1.0}, {"sample_time": [None, -0.1]}),
    (actuator, {"high": 0.0}, {"low": [1.0]}),
    (actuator, {}, {"low": [np.nan]}),
    (ramps, RAMPS, {"rate": [[1.0], 0.0], "hold": [0], "levels": [[]]}),
    (ramps, RAMPS, {"sample_time": [np.nan]}),
    (driving_cycle, {}, {"sample_time": [0]}),
    (drive, {"sample_time": 1.0, "duration": 60.0}, {"duration": [0.0, np.inf]}),
    (drive, {"sample_time": 1.0, "duration": 60.0}, {"shares": [(0.0, 0.0, 0.0)]}),
]


def test_impossible_signals_are_refused_by_the_field():
    passed = []
    for function, request, wrong in IMPOSSIBLE:
        for field, value in ((f, v) for f, values in wrong.items() for v in values):
            try:
                function(**request | {field: value})
            except SpecError as error:
                if error.field == field:
                    continue
            passed.append((function.__name__, field, value))
    assert not passed
