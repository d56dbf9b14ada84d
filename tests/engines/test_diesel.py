"""The `diesel` bed against the figures of its specification, sections 1.4 to 1.7.

Steady values: 0.5 % or half a unit of the last printed digit; times 3 % or 10 ms.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bed_figures import assert_finite, assert_prints, assert_slope
from common import reference

from jaxnarx.engines.diesel import Diesel
from jaxnarx.engines.diesel_parts import diesel_margins

# Compilation of the stiff steady states takes the better part of a minute.
pytestmark = pytest.mark.slow


ENTRIES = reference("diesel")
OPERATING = jnp.asarray(
    [
        [float(x) for x in ENTRIES[name]]
        for name in ("fuel", "egr_valve", "vgt", "speed")
    ]
).T
STEP = 0.005  # s, of the continuous responses
SAMPLES = 600


@pytest.fixture(scope="module")
def engine():
    return Diesel()


class Response(NamedTuple):
    """A step of the inputs: expected value before, extreme with its time, value after;
    and the quantity and time [s] of 63 % of the way."""

    before: tuple[float, float, float, float]
    after: tuple[float, float, float, float]
    quantity: str
    values: tuple[str, str]
    extreme: tuple[str, float] | None
    rise: tuple[str, float] | None


RESPONSES = {
    "VGT 75 to 65": Response(
        *((110, 80, 75, 1500), (110, 80, 65, 1500), "compressor"),
        *(("0.2445", "0.2486"), ("0.2397", 0.17), ("pressure", 1.29)),
    ),
    "VGT 30 to 25": Response(
        *((110, 80, 30, 1500), (110, 80, 25, 1500), "compressor"),
        *(("0.2345", "0.2203"), ("0.2176", 0.28), None),
    ),
    "EGR 0 to 50": Response(
        *((110, 0, 50, 1500), (110, 50, 50, 1500), "pressure"),
        *(("1.860", "1.680"), ("1.899", 0.09), ("turbo", 1.24)),
    ),
    "fuel 60 to 140": Response(
        *((60, 20, 50, 1500), (140, 20, 50, 1500), "pressure"),
        *(("1.296", "2.056"), None, ("turbo", 1.42)),
    ),
}
BEFORE, AFTER = (
    jnp.asarray([getattr(case, end) for case in RESPONSES.values()], float)
    for end in ("before", "after")
)


@eqx.filter_jit
def settle(engine, inputs):
    def one(row):
        state = engine.steady_state(row)
        return state, engine.quantities(state, row)

    return jax.vmap(one)(inputs)


@pytest.fixture(scope="module")
def everywhere(engine):
    """The table, then the responses' first and last points; all in one program."""
    return settle(engine, jnp.concatenate([OPERATING, BEFORE, AFTER]))


@pytest.fixture(scope="module")
def steady(everywhere):
    return jax.tree.map(lambda x: x[: len(OPERATING)], everywhere)


@pytest.mark.parametrize("name", list(ENTRIES)[4:])
def test_steady_table(steady, name):
    assert_prints(getattr(steady[1], name), ENTRIES[name])


def test_nothing_changes_at_a_steady_state(everywhere):
    state, q = everywhere
    assert np.all(np.abs(q.derivative) <= 1e-6 * np.abs(state))


def test_mass_is_balanced(everywhere):
    q = everywhere[1]
    np.testing.assert_allclose(q.compressor + q.egr, q.air, rtol=1e-6)
    np.testing.assert_allclose(q.exhaust, q.turbine + q.egr, rtol=1e-6)
    np.testing.assert_allclose(q.turbine_power, q.compressor_power, rtol=1e-6)


def test_closing_the_turbine_changes_the_flow_either_way(steady):
    flow = steady[1].compressor
    assert flow[1] > flow[0] + 0.003  # 75 to 65 %
    assert flow[3] < flow[2] - 0.01  # 30 to 25 %


@pytest.fixture(scope="module")
def slopes(engine, everywhere):
    """Derivatives of every quantity by every state and input."""
    inputs = jnp.concatenate([OPERATING, BEFORE, AFTER])
    slope = jax.jacfwd(engine.quantities, argnums=(0, 1))
    return jax.jit(jax.vmap(slope))(everywhere[0], inputs)


def test_slopes_are_finite_at_every_tabulated_point(slopes):
    assert_finite(slopes)


def test_eigenvalues_after_the_steps(slopes):
    """The printed figures, -56 and -0.75 to -0.94, are those of EGR and fuel."""
    values = np.linalg.eigvals(slopes.derivative[0][-2:]).real
    np.testing.assert_allclose(values.min(), -56, rtol=0.01)
    np.testing.assert_allclose(values.max(axis=1), [-0.75, -0.94], atol=0.0051)


@pytest.fixture(scope="module")
def responses(everywhere):
    """Quantities every `STEP` seconds after the inputs change; no dead times."""
    still = Diesel(
        egr_delay=jnp.asarray(0.0), vgt_delay=jnp.asarray(0.0), interval=STEP
    )
    line = still.rest(BEFORE[0])[1]

    def one(state, before, after):
        def sample(carry, _):
            return still.advance(carry, after)[0], still.quantities(carry[0], after)

        carry = state, jnp.broadcast_to(before, line.shape)
        return jax.lax.scan(sample, carry, None, length=2400)[1]

    start = everywhere[0][len(OPERATING) : len(OPERATING) + len(BEFORE)]
    return jax.jit(jax.vmap(one))(start, BEFORE, AFTER)


def risen(y, share: float) -> float:
    return STEP * float(np.argmax((y - y[0]) / (y[-1] - y[0]) >= share))


@pytest.mark.parametrize("name", RESPONSES)
def test_step_response(responses, name):
    case = RESPONSES[name]
    q = jax.tree.map(lambda x: np.asarray(x[list(RESPONSES).index(name)]), responses)
    y = getattr(q, case.quantity)
    assert_prints(y[[0, -1]], list(case.values))
    if case.extreme is not None:
        value, time = case.extreme
        k = np.argmax(y) if float(value) > y[0] else np.argmin(y)
        assert_prints(y[[k]], [value])
        assert abs(STEP * k - time) <= max(0.03 * time, 0.01)
    if case.rise is not None:
        quantity, time = case.rise
        assert abs(risen(getattr(q, quantity), 0.63) - time) <= 0.03 * time


def test_pressure_and_turbo_after_fuel(responses):
    turbo = np.asarray(responses.turbo[-1]) / 1000
    assert_prints(turbo[[0, -1]], ["49.9", "78.0"])


# Torque at the end of the run, by three parameters that reach it in different ways.
TORQUE = ["combustion", "vgt_area", "compressor_best"]
NAMES = ["combustion", "turbo_inertia", "vgt_area", "egr_delay", "egr_time"]


@pytest.fixture(scope="module")
def gradient():
    """A sum over a run with every input moving, from rest, with its gradient."""
    u = np.repeat([[110.0, 20, 60, 1500], [90.0, 40, 45, 1400]], [3, 9], axis=0)
    weight = jnp.asarray([1.0, 1.0, 5.0, 2e-3, 1.0, 5.0, 1e-5, 5.0, 1e-3])

    def loss(engine, u):
        return jnp.sum((engine.run(u) * weight[None]) ** 2)

    both = jax.jit(jax.value_and_grad(loss, argnums=(0, 1)))
    return lambda engine: both(engine, jnp.asarray(u))


@pytest.mark.parametrize("name", NAMES)
def test_gradients_equal_central_differences(gradient, name):
    def by_bed(engine):
        value, (slope, _) = gradient(engine)
        return value, slope

    assert_slope(by_bed, Diesel(), name)


@pytest.fixture(scope="module")
def torque():
    u = jnp.asarray([[110.0, 20, 60, 1500]] * 3 + [[90.0, 40, 45, 1400]] * 9)
    return jax.jit(jax.value_and_grad(lambda engine: engine.run(u)[-1, 3]))


@pytest.mark.parametrize("name", TORQUE)
def test_gradient_of_a_simulated_torque(torque, name):
    assert_slope(torque, Diesel(), name)


def test_every_parameter_and_input_has_a_finite_gradient(gradient):
    assert_finite(gradient(Diesel())[1])


# All runs below share one shape, so that they share one compiled program.


@pytest.fixture(scope="module")
def excited(engine):
    keys = jax.random.split(jax.random.key(3), 2)
    inputs = [np.asarray(engine.excite(key, SAMPLES)) for key in keys]
    return engine.simulate(inputs, jax.random.key(4), noise=0)


def test_excitation_fills_the_usual_ranges(engine, excited):
    for record in excited:
        for j, (low, high) in enumerate(engine.ranges.values()):
            u = record.u[:, j]
            assert low <= u.min() and u.max() <= high
            assert np.ptp(u) > 0.5 * (high - low)
        # The lag of 1 s limits the change of speed per 0.1 s.
        assert np.abs(np.diff(record.u[:, 3])).max() < 60


def test_records_stay_in_the_prototype_range(engine, excited):
    # The prototype ran five times as long: p_im 1.10 to 2.22, and so on.
    ranges = {
        "p_im": (1.05, 2.3),
        "torque": (200, 1120),
        "lambda_O": (1.2, 6.5),
        "x_egr": (0, 0.27),
        "turbo": (30e3, 86e3),
    }
    for record in excited:
        assert np.isfinite(record.y).all() and record.valid.all()
        for name, (low, high) in ranges.items():
            y = record.y[:, engine.channels.output_names.index(name)]
            assert low <= y.min() and y.max() <= high, name
        assert not any(broken.any() for broken in engine.flags(record.u).values())


def test_noise_has_the_stated_size(engine, excited, key):
    noisy = engine.simulate([r.u for r in excited], key)
    for loud, quiet in zip(noisy, excited, strict=True):
        # Relative to the reading, and four standard errors; an EGR valve may be shut.
        size = np.abs(quiet.y) * [[0.002, 0.002, 0.006, *[0.002] * 6]]
        error = (loud.y - quiet.y) / np.where(size > 0, size, 1.0)
        assert np.all(loud.y[size == 0] == quiet.y[size == 0])
        columns = zip(error.T, size.T, strict=True)
        deviation = np.array([np.std(e[s > 0]) for e, s in columns])
        np.testing.assert_allclose(deviation, 1, atol=4 / np.sqrt(2 * SAMPLES * 0.7))


def test_dead_times_of_the_actuators(engine, key):
    start, end = [110, 20, 60, 1500], [110, 40, 60, 1500]
    egr = np.repeat([start, end], [10, SAMPLES - 10], axis=0)
    vgt = np.where(np.arange(SAMPLES)[:, None] < 10, start, [110, 20, 50, 1500])
    runs = engine.simulate([egr, vgt], key, noise=0)
    share = runs.records[0].y[:, 5]
    # New EGR command at row 10, felt 65 ms later, seen at row 11.
    assert np.abs(share[:11] / share[0] - 1).max() < 1e-9 < share[11] - share[0]
    flow = runs.records[1].y[:, 1]
    assert np.abs(flow[:11] / flow[0] - 1).max() < 1e-9 < flow[11] - flow[0]
    # Fuel has no dead time, but is measured before it changes.
    more = np.where(np.arange(SAMPLES)[:, None] < 10, start, [120, 20, 60, 1500])
    torque = engine.simulate([more, egr], key, noise=0).records[0].y[:, 3]
    assert abs(torque[10] - torque[0]) < 1e-6 < 50 < torque[11] - torque[0]


def test_ten_milliseconds_are_fine_enough(excited, engine, key):
    """Four times as fine a step, at the same instants."""
    fine = Diesel(interval=0.0025)
    u = excited.records[0].u[:100]
    repeated = np.repeat(u, 40, axis=0)
    y = np.asarray(jax.jit(lambda u: fine.run(u))(jnp.asarray(repeated)))[::40]
    np.testing.assert_allclose(excited.records[0].y[:100], y, rtol=1e-4, atol=1e-5)


def test_limits_have_the_specified_thresholds():
    def broken(pressure=1.6, flow=0.2, ratio=2.0, turbo=6e3):
        values = (jnp.asarray(v) for v in (pressure, flow, ratio, turbo))
        margins = diesel_margins(*values, ambient=jnp.asarray(1.0))
        return {name for name, margin in margins.items() if not margin >= 0}

    assert broken() == set() and broken(flow=0.04, pressure=1.49) == set()
    assert broken(ratio=1.19) == {"smoke"} == broken(ratio=np.nan)
    assert broken(turbo=12501.0) == {"turbo"}
    assert broken(flow=0.04, pressure=1.51) == {"surge"}


def test_smoke_is_flagged_when_fuel_outruns_the_air(engine):
    """Section 1.7: more than 150 mg with more than 60 % EGR smokes in transients."""
    u = np.repeat([[60.0, 70, 50, 1500], [200.0, 70, 50, 1500]], SAMPLES // 2, axis=0)
    flags = engine.flags(u)
    assert set(flags) == {"smoke", "turbo", "surge"}
    half = SAMPLES // 2
    assert not flags["smoke"][: half + 1].any() and flags["smoke"][half + 1]
    assert not flags["turbo"].any() and not flags["surge"].any()


def test_corners_have_steady_states(engine):
    """17 of them, as the other points, so that no new program is needed."""
    corners = [[u, e, v, n] for u in (1, 250) for e in (0, 100) for v in (20, 100)
               for n in (500, 2000)]  # fmt: skip
    state, q = settle(engine, jnp.asarray([*corners, [80, 40, 20, 500]], float))
    assert bool(jnp.isfinite(state).all())
    assert np.all(np.abs(q.derivative) <= 1e-6 * np.abs(state) + 1e-12)


def test_a_family_is_a_stacked_tree(engine, key):
    keys = jax.random.split(key, 3)
    family = jax.vmap(lambda k: engine.perturb(k, 0.05))(keys)
    rows = jnp.concatenate([OPERATING, BEFORE, AFTER])
    pressures = []
    for i in range(3):  # one by one, with the program compiled for the tables
        member = jax.tree.map(lambda leaf, i=i: leaf[i], family)
        state = settle(member, rows)[0]
        assert bool(jnp.isfinite(state).all())
        pressures.append(float(state[1, 0]))
    assert 1e3 < np.ptp(pressures) < 1e5
    assert eqx.tree_equal(engine.perturb(key, 0.0), engine)


def test_arithmetic_follows_the_dtype():
    single = jax.tree.map(lambda p: p.astype(jnp.float32), Diesel())
    row = OPERATING[1].astype(jnp.float32)
    state = jnp.asarray([1.5513e5, 1.6066e5, 0.2232, 0.1157, 6454, 80, 80, 65], "f4")
    carry = state, jnp.broadcast_to(row, (2, 4))
    carry, y = eqx.filter_jit(lambda e, c, u: e.advance(c, u))(single, carry, row)
    assert {leaf.dtype for leaf in jax.tree.leaves((carry, y))} == {np.dtype("f4")}
    np.testing.assert_allclose(y[0], 1.5513, rtol=1e-5)
