"""Fixed steps against a closed form and against error control, rests, dead times."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnarx.engines import CrossleyCook, Diesel, Drive, Gtdi, Pfi, Vct
from jaxnarx.engines.delays import lag_and_delay
from jaxnarx.engines.gtdi.bed import START as GTDI_START
from jaxnarx.engines.gtdi.state import impose_columns
from jaxnarx.engines.integration import find_rest, hold_inputs, rk4, solve
from jaxnarx.engines.vct import VctDrive

# A program for every bed, twice.
pytestmark = pytest.mark.slow


def test_runge_kutta_is_of_fourth_order():
    def error(steps):
        y = rk4(
            lambda y, w: -y + w,
            jnp.asarray([1.0]),
            jnp.asarray(1 / steps),
            # Forcing t, so that y = t - 1 + 2 e^-t.
            (jnp.arange(float(steps))[:, None] + jnp.asarray([[0, 0.5, 1]]))[..., None]
            / steps,
        )
        return abs(float(y[0]) - 2 * np.exp(-1))

    assert 14 < error(4) / error(8) < 18


def test_steps_left_out_take_no_part():
    def decay(count, rate):
        nothing = jnp.full((6, 3, 1), rate)
        return rk4(
            lambda y, w: -w * y,
            *(jnp.ones(2), jnp.asarray(0.1), nothing),
            count=jnp.asarray(count),
        )[0]

    both = jax.jit(jax.value_and_grad(decay, argnums=1))
    for count in (0, 4, 6):
        value, slope = both(count, 1.5)
        np.testing.assert_allclose(value, np.exp(-0.15 * count), rtol=5e-6)
        np.testing.assert_allclose(slope, -0.1 * count * value, rtol=5e-5, atol=0)
    many = jax.vmap(decay, in_axes=(0, None))(jnp.asarray([0, 4, 6]), 1.5)
    np.testing.assert_allclose(many[1], both(4, 1.5)[0], rtol=1e-14)


def test_solve_keeps_its_tolerance():
    """A pendulum's energy, and a lag in closed form, over many time constants."""
    times = jnp.linspace(0.0, 20.0, 5)
    swing = solve(
        lambda y: jnp.stack([y[1], -jnp.sin(y[0])]), jnp.asarray([1.0, 0.0]), times
    )
    energy = swing[:, 1] ** 2 / 2 - jnp.cos(swing[:, 0])
    # The error of every step is below 1e-8; some hundred steps add up.
    np.testing.assert_allclose(energy, -np.cos(1.0), atol=1e-6)
    lag = solve(lambda y: -y, jnp.ones(1), times)[:, 0]
    np.testing.assert_allclose(lag, np.exp(-times), atol=1e-6)


def test_too_few_steps_give_nan():
    path = solve(lambda y: -y, jnp.ones(1), jnp.asarray([0.0, 50.0]), max_steps=3)
    assert bool(jnp.isnan(path[-1]).all())


def test_settled_finds_the_stable_rest_with_its_slope():
    """x' = a - x^3 and a slow follower: x = a^(1/3), dx/da = 1/(3 x^2)."""

    def rate(x, a):
        return jnp.stack([a - x[0] ** 3, 0.01 * (x[0] - x[1])])

    def rest(a):
        return find_rest(rate, jnp.asarray([0.5, 5.0]), a)[1]

    for derivative in (jax.grad(rest), jax.jacfwd(rest)):
        np.testing.assert_allclose(rest(jnp.asarray(8.0)), 2.0, rtol=1e-14)
        np.testing.assert_allclose(derivative(jnp.asarray(8.0)), 1 / 12, rtol=1e-8)


def test_settled_says_where_there_is_no_rest():
    found = find_rest(lambda x, a: a + x**2, jnp.ones(1), jnp.asarray(1.0))
    assert bool(jnp.isnan(found).all())


@pytest.mark.parametrize("delay", [0.0, 0.04, 0.1, 0.13])
def test_actuator_follows_the_delayed_command(delay):
    """Against the closed form for one step command, over several samples."""
    interval, lag = 0.1, 0.05
    commands = np.where(np.arange(12) < 4, 20.0, 60.0)
    x, found = jnp.asarray(20.0), []
    times = jnp.linspace(0.0, interval, 5)
    for k in range(2, 12):
        line = jnp.asarray(commands[k - 2 : k + 1])
        path = lag_and_delay(
            *(x, line, jnp.asarray(delay), jnp.asarray(lag), interval, times)
        )
        found.extend(np.asarray(path[:-1]))
        x = path[-1]
    t = 0.2 + 0.025 * np.arange(len(found)) - 0.4 - delay
    expected = 20 + 40 * -np.expm1(-np.maximum(t, 0) / lag)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def pfi():
    engine = Pfi()
    return engine.balance(Drive(0.39)), lambda x: engine.derivative(x, Drive(0.40))


def crossley_cook():
    engine = CrossleyCook()
    after = jnp.asarray([10.0, 20.0])
    start = engine.steady_state(jnp.asarray([9.0, 22.0]))
    return start, lambda x: engine.quantities(x, after).derivative


def diesel():
    # Exactly choked EGR and the like are passed on the way: limits are not smooth.
    engine, after = Diesel(), jnp.asarray([140.0, 20.0, 50.0, 1500.0])
    start = jnp.asarray([1.296e5, 1.38e5, 0.222, 0.13, 5226.0, 20.0, 20.0, 50.0])
    return start, lambda x: engine.derivative(x, after)


def gtdi():
    engine, after = Gtdi(), jnp.asarray([25.0, 24.0, 18.0, 2000.0])
    start = jnp.asarray([14.0, 0.0, *GTDI_START])
    return start, lambda x: engine.derivative(x, impose_columns(after))


def vct():
    engine = Vct()
    drive = VctDrive(*(jnp.asarray(v) for v in (12.0, 10.0, 1500.0, 14.64)))
    start = engine.balance(drive)
    after = drive._replace(throttle=jnp.asarray(15.0), cam=jnp.asarray(20.0))
    return start, lambda x: engine.derivative(x, after)


# The longest step each bed takes [s], and the largest error it makes then, relative to
# the largest value of a state, in the first second after a step of the inputs: about
# twice what was measured. Set by the fastest rate times the step, and by hard limits.
FIXED = {
    "pfi": (pfi, 1 / 60, 5e-6),
    "pfi-cc": (crossley_cook, 1 / 60, 2e-7),
    "vct": (vct, 0.02, 3e-6),
    "diesel": (diesel, 0.01, 5e-6),
    "gtdi": (gtdi, 0.001, 1e-7),
}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if name in ("diesel", "gtdi") else ())
        for name in FIXED
    ],
)
def test_fixed_steps_stay_near_those_under_error_control(name):
    make, step, tolerance = FIXED[name]
    start, rate = make()
    count = round(0.1 / step)

    @jax.jit
    def both(start):
        def move(x, _):
            after = hold_inputs(rate, x, jnp.asarray(count * step), steps=count)
            return after, after

        times = count * step * jnp.arange(1.0, 11.0)
        times = jnp.concatenate([jnp.zeros(1), times])
        return jax.lax.scan(move, start, None, length=10)[1], solve(rate, start, times)

    fixed, accurate = both(start)
    moved = np.abs(accurate[-1] - accurate[0]) / (np.abs(accurate[-1]) + 1e-9)
    assert moved.max() > 0.05
    scale = np.abs(accurate).max(axis=0, keepdims=True) + 1e-9
    error = np.abs(fixed - accurate[1:]) / scale
    assert error.max() < tolerance, error.max(axis=0)
