"""The `pfi` bed against the figures of its specification, sections 2.6 to 2.9.

Steady values: 0.5 % or half a unit of the last printed digit; times 3 % or 10 ms.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bed_figures import assert_finite, assert_prints, assert_slope, at
from common import reference

from jaxnarx.engines import Drive, Pfi, pfi_siso_records
from jaxnarx.engines.delays import shift
from jaxnarx.engines.flow import throttle_share
from jaxnarx.engines.integration import hold_inputs
from jaxnarx.errors import DataError, SpecError

FREE, HELD = reference("pfi_free"), reference("pfi_held")
STEP = 0.005  # s, of the continuous responses
EVENTS = 2000


def numbers(entries: list[str]) -> jax.Array:
    return jnp.asarray([float(entry) for entry in entries])


@eqx.filter_jit
def settle(engine, drives):
    def one(drive):
        state = engine.balance(drive)
        return state, engine.quantities(state, drive)

    return jax.vmap(one)(drives)


@pytest.fixture(scope="module")
def engine():
    return Pfi()


@pytest.fixture(scope="module")
def free(engine):
    entries = FREE
    return entries, *settle(engine, Drive(numbers(entries["duty"])))


@pytest.fixture(scope="module")
def at_speed(engine):
    entries = HELD
    drive = Drive(
        numbers(entries["duty"]),
        pulse=numbers(entries["pulse"]),
        speed=numbers(entries["speed"]),
    )
    return entries, *settle(engine, drive)


@pytest.mark.parametrize("name", list(FREE)[1:])
def test_free_speed_table(free, name):
    entries, _, q = free
    assert_prints(getattr(q, name), entries[name])


@pytest.mark.parametrize("name", list(HELD)[3:])
def test_held_speed_table(at_speed, name):
    entries, _, q = at_speed
    assert_prints(getattr(q, name), entries[name])


def test_nothing_changes_at_a_steady_state(free, at_speed):
    for _, state, q in (free, at_speed):
        assert np.all(np.abs(q.derivative) < 1e-6 * np.abs(state))


def test_mass_is_balanced(free, at_speed):
    for _, _, q in (free, at_speed):
        np.testing.assert_allclose(q.air_in, q.air, rtol=1e-6)
        np.testing.assert_allclose(q.air, q.ratio * 14.67 * q.fuel, rtol=1e-6)


def test_feed_forward_is_stoichiometric(free):
    np.testing.assert_allclose(free[2].ratio, 1.0, atol=1e-6)


@eqx.filter_jit
def slopes(engine, state, drive):
    """Derivatives of every quantity by every state and input."""
    return jax.vmap(jax.jacfwd(engine.quantities, argnums=(0, 1)))(state, drive)


@pytest.fixture(scope="module")
def free_slopes(engine, free):
    return slopes(engine, free[1], Drive(numbers(free[0]["duty"])))


def test_eigenvalues_at_the_middle_of_the_range(free, free_slopes):
    jacobian = free_slopes.derivative[0][free[0]["duty"].index("0.395")]
    values = np.sort_complex(np.linalg.eigvals(np.asarray(jacobian)))
    expected = [-12.5, -4.92, -1.04 - 0.05j, -1.04 + 0.05j]
    np.testing.assert_allclose(values, expected, atol=0.0051)


def test_slopes_are_finite_at_every_tabulated_point(engine, free_slopes, at_speed):
    columns = ("duty", "pulse", "speed")
    duty, pulse, speed = (numbers(at_speed[0][name]) for name in columns)
    drive = Drive(duty, pulse=pulse, speed=speed)
    for leaf in jax.tree.leaves((free_slopes, slopes(engine, at_speed[1], drive))):
        assert bool(jnp.isfinite(leaf).all())


class Response(NamedTuple):
    """One step response: a quantity, its fractions' times, its extreme and levels."""

    engine: Pfi
    before: Drive
    after: Drive
    quantity: str
    levels: tuple[float, float]
    times: dict[float, float]
    peak: tuple[float, float] | None = None
    first: float | None = None


def loaded(extra: float) -> Pfi:
    return eqx.tree_at(lambda e: e.load_constant, Pfi(), jnp.asarray(4.0 + extra))


OPEN = (Drive(0.39), Drive(0.40))
HOLD = Drive(0.42, speed=1550.0)
RESPONSES = {
    "speed after duty": Response(
        *(Pfi(), *OPEN, "speed", (1041.0, 1323.0)), {0.1: 0.35, 0.63: 1.36, 0.9: 2.65}
    ),
    "pressure after duty": Response(
        *(Pfi(), *OPEN, "pressure", (30.35, 31.96)), {}, peak=(36.68, 0.56)
    ),
    "speed after 4 Nm": Response(
        *(loaded(4), Drive(0.385), Drive(0.385), "speed", (911.0, 811.0)), {}
    ),
    "speed after 10 Nm": Response(
        *(loaded(10), Drive(0.385), Drive(0.385), "speed", (911.0, 681.0)), {}
    ),
    "lambda after pulse": Response(
        *(Pfi(), HOLD._replace(pulse=5.377), HOLD._replace(pulse=5.8447)),
        *("ratio", (1.0, 0.909), {0.63: 0.14, 0.9: 1.11}),
        first=0.95,
    ),
}


@eqx.filter_jit
def respond(engine, before, after):
    """Quantities every `STEP` seconds after the drive changes; no delays."""

    def advance(state, _):
        now = engine.quantities(state, after)
        move = lambda y: engine.derivative(y, after)  # noqa: E731
        return hold_inputs(move, state, jnp.asarray(STEP), steps=1), now

    start = Pfi().balance(before)
    return Pfi().quantities(start, before), jax.lax.scan(
        advance, start, None, length=1600
    )[1]


def traced(drive: Drive) -> Drive:
    return jax.tree.map(jnp.asarray, drive)


@pytest.mark.parametrize("name", RESPONSES)
def test_step_response(name):
    case = RESPONSES[name]
    start, after = respond(case.engine, traced(case.before), traced(case.after))
    low = float(getattr(start, case.quantity))
    y = np.asarray(getattr(after, case.quantity))
    np.testing.assert_allclose([low, y[-1]], case.levels, rtol=0.005)
    fraction = (y - low) / (y[-1] - low)
    for level, time in case.times.items():
        found = STEP * float(np.argmax(fraction >= level))
        assert abs(found - time) <= max(0.03 * time, 0.01), (level, found)
    if case.peak is not None:
        height, time = case.peak
        assert abs(y.max() - height) <= 0.005 * height
        assert abs(STEP * np.argmax(y) - time) <= max(0.03 * time, 0.01)
    elif case.times and case.quantity == "speed":
        assert np.all(fraction <= 1.0 + 1e-3)  # no overshoot
    if case.first is not None:
        np.testing.assert_allclose(y[0], case.first, rtol=0.005)


NAMES = ["displacement", "friction_scale", "valve_centre"]


@pytest.fixture(scope="module")
def gradients():
    """A sum over a run with delays, from rest: with its gradient, and its jvp."""
    duty = jnp.asarray([[0.39]] * 3 + [[0.40]] * 9)

    def loss(engine):
        y = engine.run(duty)
        return jnp.sum(y[:, 0]) / 1e3 + jnp.sum(y[:, 1] ** 2) / 1e3

    push = jax.jit(lambda v: jax.jvp(loss, (Pfi(),), (v,))[1])
    return jax.jit(jax.value_and_grad(loss)), push


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_gradients_equal_central_differences(name, gradients):
    reverse, forward = gradients
    slope = assert_slope(reverse, Pfi(), name)
    zero = jax.tree.map(jnp.zeros_like, Pfi())
    pushed = forward(eqx.tree_at(at(name), zero, jnp.asarray(1.0)))
    np.testing.assert_allclose(pushed, slope, rtol=1e-9)


def test_every_parameter_has_a_finite_gradient(gradients):
    assert_finite(gradients[0](Pfi()))


# All runs below share one shape, so that they share one compiled program.


@pytest.mark.slow
def test_records_stay_in_the_prototype_range(key):
    data = pfi_siso_records(key, (EVENTS, EVENTS), names=None, outputs=None)
    assert data.channels.input_names == ["duty"]
    assert data.channels.output_names == ["speed", "MAP"]
    assert data.sample_time == 0.03
    for record in data:
        assert np.isfinite(record.y).all() and record.valid.all()
        # The prototype had 804 to 1577 rpm; another draw differs at the ends.
        assert 760 < record.y[:, 0].min() < 1000 < 1400 < record.y[:, 0].max() < 1630
        assert 18 < record.y[:, 1].min() < record.y[:, 1].max() < 65
    repeated = pfi_siso_records(key, (EVENTS, EVENTS), names=None, outputs=None)
    np.testing.assert_array_equal(data.records[1].y, repeated.records[1].y)


def test_noise_has_the_stated_size(engine, key):
    still = np.full(EVENTS, 0.395)  # one column for short
    noisy = engine.simulate([still, still], key)
    clean = engine.simulate([still, still], key, noise=0)
    for loud, quiet in zip(noisy, clean, strict=True):
        np.testing.assert_allclose(quiet.y[:, 0], 1179.29, atol=0.01)
        # Four standard errors of a standard deviation from 2,000 draws.
        deviation = np.std(loud.y - quiet.y, axis=0)
        np.testing.assert_allclose(deviation, [2.5, 0.3], rtol=4 / np.sqrt(2 * EVENTS))
    assert not np.array_equal(noisy.records[0].y, noisy.records[1].y)


@pytest.mark.slow
def test_many_records_run_side_by_side(engine, key):
    """From eight records on in one vectorised loop: the same numbers."""
    rows = [np.repeat([d, 0.39], 20) for d in np.linspace(0.385, 0.405, 9)]
    together = engine.simulate(rows, key, noise=0)
    alone = engine.simulate(rows[:3], key, noise=0)
    for one, other in zip(together.records[:3], alone.records, strict=True):
        np.testing.assert_allclose(one.y, other.y, rtol=1e-10)


def test_padding_and_company_change_nothing(engine, key):
    long = np.repeat([[0.39], [0.40]], EVENTS // 2, axis=0)
    short = np.repeat([[0.40], [0.385]], 300, axis=0)
    one = engine.simulate([long, short], key, noise=0, names=["long", "short"])
    two = engine.simulate([short, long], key, noise=0, names=["short", "long"])
    assert len(one.records[1]) == 600
    np.testing.assert_allclose(one.records[0].y, two.records[1].y, rtol=1e-12)
    np.testing.assert_allclose(one.records[1].y, two.records[0].y, rtol=1e-12)


def test_valve_and_torque_dead_times(engine, key):
    duty = np.repeat([[0.39], [0.40]], [10, EVENTS - 10], axis=0)
    y = engine.simulate([duty, duty], key, noise=0).records[0].y
    changed = np.abs(y / y[0] - 1) > 1e-9
    # The new duty acts in event 12 and shows at its end; the torque of that instant
    # comes two events later. Until then speed feels only pumping, a small push.
    assert np.argmax(changed[:, 1]) == 13
    change = np.diff(y[:, 0], 2)
    assert change[13] < 0.05 < 0.15 < change[14]


def test_stall_names_the_record_and_event(engine, key):
    fine = np.full((EVENTS, 1), 0.395)
    starved = np.repeat([[0.395], [0.25]], [100, EVENTS - 100], axis=0)
    with pytest.raises(DataError, match="'low': speed is .* at event") as caught:
        engine.simulate([fine, starved], key, names=["ok", "low"])
    assert caught.value.channel == "speed"
    assert caught.value.row is not None and caught.value.row > 100
    assert "where duty is 0.25" in str(caught.value)


def test_a_stall_is_flagged(engine):
    starved = np.repeat([0.395, 0.25], [100, EVENTS - 100])
    flags = engine.flags(starved)
    assert not flags["stall"][:100].any() and flags["stall"][-1]
    first = int(np.argmax(flags["stall"]))
    assert 100 < first < EVENTS and flags["stall"][first:].all()
    assert not flags["mixture"][:100].any()


WRONG = {
    "columns": np.full((5, 2), 0.4),
    "empty": np.full((0, 1), 0.4),
    "not finite": np.full((5, 1), np.nan),
    "numbers": [0.4, 0.4],
    "no record": [],
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_inputs_are_refused(engine, key, name):
    with pytest.raises(SpecError):
        engine.simulate(WRONG[name], key)


@pytest.mark.parametrize("noise", [-1.0, float("nan"), float("inf")])
def test_wrong_noise_is_refused(engine, key, noise):
    with pytest.raises(SpecError, match="noise"):
        engine.simulate(np.full((5, 1), 0.4), key, noise=noise)


def test_unknown_output_is_refused(engine, key):
    with pytest.raises(SpecError):
        engine.simulate(np.full((5, 1), 0.4), key, outputs=["sped"])
    with pytest.raises(SpecError, match="among speed, MAP"):
        engine.simulate(np.full((5, 1), 0.4), key, outputs=["duty"])
    with pytest.raises(SpecError, match="none"):
        engine.simulate(np.full((5, 1), 0.4), key, outputs=[])


@pytest.mark.slow
def test_a_family_is_a_stacked_tree(engine, key):
    family = jax.vmap(lambda k: engine.perturb(k, 0.05))(jax.random.split(key, 6))
    state = jax.jit(jax.vmap(lambda e: e.balance(Drive(0.395))))(family)
    speed = np.asarray(state[:, 3]) * 30 / np.pi
    assert np.isfinite(speed).all() and np.ptp(speed) > 50
    assert np.all((speed > 700) & (speed < 1700))
    same = engine.perturb(key, 0.0)
    assert eqx.tree_equal(same, engine)


@pytest.mark.slow
def test_arithmetic_follows_the_dtype():
    single = jax.tree.map(lambda p: p.astype(jnp.float32), Pfi())
    state, q = settle(single, Drive(jnp.asarray([0.39, 0.4], jnp.float32)))
    assert {leaf.dtype for leaf in jax.tree.leaves((state, q))} == {np.dtype("f4")}
    np.testing.assert_allclose(q.speed, [1041.1418, 1322.8265], rtol=1e-5)


def test_throttle_share_is_continuous_and_reverses():
    for border in (0.4125, 0.98):
        around = [throttle_share(jnp.asarray(border + d)) for d in (-1e-9, 1e-9)]
        np.testing.assert_allclose(around[0], around[1], atol=2e-4)
    assert throttle_share(jnp.asarray(1.0)) == 0.0
    assert throttle_share(jnp.asarray(1.01)) < 0.0
    assert jnp.isfinite(jax.grad(throttle_share)(jnp.asarray(1.01)))
    assert jax.grad(throttle_share)(jnp.asarray(0.0)) == 0.0


def test_a_delay_line_delays():
    line, out = jnp.asarray([1.0, 2.0]), []
    for value in (3.0, 4.0, 5.0):
        line, leaving = shift(line, jnp.asarray(value))
        out.append(float(leaving))
    assert out == [1.0, 2.0, 3.0]
    assert shift(jnp.zeros(0), jnp.asarray(7.0))[1] == 7.0
