"""The compact bed `pfi-cc` against the figures of its specification, section 2.10."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bed_figures import half_digit

from jaxnarx.engines import CrossleyCook
from jaxnarx.errors import DataError

# A bed beside the main ones.
pytestmark = pytest.mark.slow

RPM = np.pi / 30

# Throttle, speed [rad/s], P_m [bar], m_ao [g/s], m_a [g], T [Nm]; None: not printed.
TABLE = [
    (8.973, 209.0, "0.5448", "10.148", "0.1525", "25.13"),
    (11.93, 314.16, "0.4913", "15.785", None, "25.00"),
]


@pytest.fixture(scope="module")
def bed():
    return CrossleyCook()


@pytest.mark.parametrize("row", TABLE)
def test_reference_points(bed, row):
    """The load that holds the printed speed is the printed torque."""
    throttle, omega, *entries = row
    load = float(entries[-1])

    def at(load):
        state = bed.steady_state(jnp.stack([jnp.asarray(throttle), load]))
        return state[1], bed.quantities(state, jnp.stack([jnp.asarray(throttle), load]))

    # Newton's method on the load, as the printed torque is rounded.
    run = jax.jit(jax.value_and_grad(at, has_aux=True))
    load = jnp.asarray(load)
    for _ in range(4):
        (speed, q), slope = run(load)
        load = load - (speed - omega) / slope
    (speed, q), _ = run(load)
    np.testing.assert_allclose(speed, omega, rtol=1e-10)
    found = (q.pressure, q.air, q.charge, q.torque)
    for value, entry in zip(found, entries, strict=True):
        if entry is not None:
            assert abs(float(value) - float(entry)) <= half_digit(entry)
    np.testing.assert_allclose(q.torque, load, rtol=1e-9)


def test_the_published_example_starts_at_rest(bed):
    """Throttle 8.97 deg, load 25 Nm: 209 rad/s and 0.543 bar."""
    speed, pressure = bed.steady_outputs(jnp.asarray([8.97, 25.0]))
    np.testing.assert_allclose([speed * RPM, pressure], [209, 0.543], rtol=2e-3)


def test_a_charge_burns_one_event_later(bed, key):
    inputs = np.repeat([[9.0, 22.0], [10.0, 22.0]], [5, 395], axis=0)
    y = bed.simulate(inputs, key, noise=0).records[0].y
    changed = np.abs(y / y[0] - 1) > 1e-9
    # Pressure rises through event 5; the charge sampled at event 6 burns in event 7.
    assert np.argmax(changed[:, 1]) == 6 and np.argmax(changed[:, 0]) == 8
    assert y[-1, 0] > y[0, 0] + 200


def test_more_load_is_slower(bed, key):
    inputs = np.repeat([[9.0, 22.0], [9.0, 24.0]], 200, axis=0)
    y = bed.simulate(inputs, key, noise=0).records[0].y
    assert y[-1, 0] < y[0, 0] and y[-1, 1] > y[0, 1]
    # The first event of more load alone: J dN = dT dt, at constant torque.
    drop = (y[200, 0] - y[201, 0]) * RPM
    np.testing.assert_allclose(drop, 2.0 / 0.14 * 30 / y[200, 0], rtol=0.01)


def test_too_much_load_stalls(bed, key):
    inputs = np.repeat([[9.0, 22.0], [5.0, 39.0]], 200, axis=0)
    with pytest.raises(DataError, match="speed is .*450 to inf, where throttle"):
        bed.simulate(inputs, key)
    assert bed.flags(inputs)["stall"][-1]


def test_flow_through_the_throttle_is_continuous(bed):
    def flow(p):
        state = jnp.stack([p, jnp.asarray(209.0)])
        return bed.quantities(state, jnp.asarray([9.0, 20.0])).air_in

    for border in (0.5, 0.98):
        around = [float(flow(jnp.asarray(border + d))) for d in (-1e-9, 1e-9)]
        np.testing.assert_allclose(around[0], around[1], rtol=1e-6)
    assert flow(jnp.asarray(1.0)) == 0.0 and flow(jnp.asarray(1.01)) < 0
    slopes = jax.vmap(jax.grad(flow))(jnp.asarray([0.3, 0.5, 0.9, 0.98, 1.0, 1.1]))
    assert bool(jnp.isfinite(slopes).all())
