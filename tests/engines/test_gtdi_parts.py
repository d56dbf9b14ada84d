"""Restrictions and the dead time of the `gtdi` bed against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxnarx.engines.delays import delay_staircase
from jaxnarx.engines.flow import Gas, orifice, tail_flow


def test_orifice_is_continuous_and_reverses():
    air, up, hot = Gas(), jnp.asarray(1e5), jnp.asarray(300.0)
    flow = lambda ratio: orifice(jnp.asarray(ratio) * up, up, hot, air)  # noqa: E731
    for border in (0.92, 1.2 ** (-1 / 0.4 * 1.4)):
        np.testing.assert_allclose(flow(border - 1e-9), flow(border + 1e-9), rtol=1e-6)
    # The choked flow function of air is sqrt(g) (2/(g+1))^((g+1)/(2(g-1))) = 0.6847.
    np.testing.assert_allclose(
        flow(0.1), 0.684731 * 1e5 / (287 * 300) ** 0.5, rtol=1e-6
    )
    assert flow(1.0) == 0.0 and flow(1.01) < 0.0
    assert all(bool(jnp.isfinite(jax.grad(flow)(r))) for r in (0.1, 0.92, 1.0, 1.2))


def test_tail_flow_reverses():
    args = [jnp.asarray(v) for v in (1e5, 300.0, 1.75e8, 1500.0)]
    flow = jax.value_and_grad(lambda p: tail_flow(p, *args))
    for drop, sign in ((-500.0, -1), (0.0, 0), (500.0, 1), (5e3, 1)):
        value, slope = flow(jnp.asarray(1e5 + drop))
        assert np.sign(value) == sign and slope > 0


def test_a_dead_time_is_kept_inside_events():
    levels, past = jnp.asarray([1.0, 2.0, 3.0, 4.0]), jnp.asarray([0.01, 0.01])
    late = delay_staircase(
        levels, past, jnp.asarray(0.0025), jnp.asarray(0.0125), steps=4
    )
    np.testing.assert_allclose(late, [2.0, 3.0, 3.0, 3.0], atol=1e-12)
    late = delay_staircase(
        levels, past, jnp.asarray(0.0025), jnp.asarray(0.00875), steps=4
    )
    np.testing.assert_allclose(late, [3.0, 3.0, 3.0, 3.5], atol=1e-12)
