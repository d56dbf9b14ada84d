"""The cascade: equal to a plain loop, to its two networks alone, and within limits."""

import dataclasses
import re

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from inverse_problems import (
    exact,
    linear,
    plant,
    polynomial_inverse,
    recorded,
    widened,
)

from jaxnarx import plot
from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.inverse import cascade, inverse_data
from jaxnarx.inverse.loop import connect
from jaxnarx.models import Network, hold_to_range
from jaxnarx.partition import grow
from jaxnarx.regressors import polynomial_pool
from jaxnarx.settings import Global, Lolimot
from jaxnarx.settings.inverse import ActuatorLimits
from jaxnarx.simulation import predict, simulate

FREE = ((-np.inf, np.inf), (-np.inf, np.inf))
LIMITS = ActuatorLimits(range={"u": (-0.5, 0.6)}, rate={"u": 3.0})
"""0.3 per sample of 0.1 s."""


FACTOR = re.compile(r"^(.+)\[t(?:-(\d+))?\](?:\^(\d+))?$")


def terms(network: Network) -> list[tuple[list[tuple[str, int]], float]]:
    """Factors (channel, lag) and coefficient of every term, from its text."""
    (row,) = network.equations()
    out = []
    for text, coefficient in row["terms"]:
        factors = []
        for part in text.split("*") if text != "1" else []:
            match = FACTOR.match(part)
            assert match is not None
            name, lag, power = match.groups()
            factors += [(name, int(lag or 0))] * int(power or 1)
        out.append((factors, coefficient))
    return out


def plain(inverse: Network, record, limits: ActuatorLimits | None, ends=FREE):
    """The cascade on the true plant, sample by sample; `ends` are those of the range
    to which u and d are held in the plant."""
    table = terms(inverse)
    u, d, r = record.u[:, 0].copy(), record.u[:, 1], record.y[:, 0]
    seen = np.clip(d, *ends[1])
    y, last = r.copy(), len(r) - 1
    for t in range(2, len(r)):
        raw = 0.0
        for factors, coefficient in table:
            product = coefficient
            for name, lag in factors:
                product *= {
                    "y_ahead2": r[min(t - lag + 2, last)],
                    "d": d[t - lag],
                    "u": u[t - lag],
                }[name]
            raw += product
        if limits is not None:
            low, high = limits.range["u"]
            move = limits.rate["u"] * 0.1
            raw = min(max(raw, low), high)
            raw = min(max(raw, u[t - 1] - move), u[t - 1] + move)
        u[t] = raw
        a = np.clip(u[t - 2], *ends[0])
        y[t] = 0.6 * y[t - 1] + 0.4 * (a + 0.3 * a**2 - 0.1 * a**3) + 0.1 * seen[t - 2]
    return u, y


@pytest.mark.parametrize("limits", [None, LIMITS])
def test_equals_a_plain_loop(clean, forward, inverse, limits):
    solution = cascade(inverse, forward, clean, limits)
    assert solution.status_name == "ok"
    for n, record in enumerate(clean):
        u, y = plain(inverse, record, limits)
        # The fitted coefficients of the plant are exact to rounding.
        np.testing.assert_allclose(solution.value.commands[n][:, 0], u, atol=1e-9)
        np.testing.assert_allclose(solution.value.outputs[n][:, 0], y, atol=1e-9)


def test_a_figure_has_a_panel_for_every_target_and_command(clean, forward, inverse):
    ways = {"bold": None, "careful": LIMITS}
    found = {n: cascade(inverse, forward, clean, kept) for n, kept in ways.items()}
    figure = plot.tracking(found, clean, record=1)
    assert [ax.get_ylabel() for ax in figure.axes] == ["y", "u"]
    drawn = {line.get_label(): line.get_ydata() for line in figure.axes[1].get_lines()}
    for name, way in found.items():
        np.testing.assert_array_equal(drawn[name], way.value.commands[1][:, 0])
    alone = plot.tracking(found["bold"], clean).axes[1]
    assert alone.get_legend_handles_labels()[1] == ["inverse"]
    with pytest.raises(SpecError, match="record must be from 0"):
        plot.tracking(found, clean, record=len(clean))


def test_a_forward_network_with_limits_sees_what_it_was_trained_on(
    clean, forward, inverse
):
    """Commands stay within its range, which bounds them as actuator limits do; recorded
    ones before the start, and the other input, are held where they go beyond."""
    ends = jnp.array([-0.5, -0.4, -0.5]), jnp.array([0.6, 0.3, 0.6])
    narrow = dataclasses.replace(forward, low=ends[0], high=ends[1])
    solution = cascade(inverse, hold_to_range(narrow, 0.1, outside="hold"), clean)
    value, first = solution.value, forward.history
    assert max(abs(record.u[:first, 0]).max() for record in clean) > 0.6
    for n, record in enumerate(clean):
        wide = dataclasses.replace(LIMITS, rate={"u": 1e9})
        u, y = plain(inverse, record, wide, ((-0.5, 0.6), (-0.4, 0.3)))
        np.testing.assert_allclose(value.commands[n][:, 0], u, atol=1e-9)
        edge = np.clip(y, -0.61, 0.71)
        np.testing.assert_allclose(value.outputs[n][3:, 0], edge[3:], atol=1e-9)
        np.testing.assert_array_equal(value.held[n][3:, 0], edge[3:] != y[3:])
        assert value.at_range[n].any()
    np.testing.assert_array_equal(
        solution.stats["held"], [m.sum(axis=0) for m in value.held]
    )
    assert solution.stats["held"].sum() > 0


@pytest.mark.parametrize("outside", ["flag", "linear"])
def test_commands_keep_to_the_range_of_a_network_with_limits_of_any_kind(
    clean, forward, inverse, outside
):
    ends = jnp.array([-0.5, -9.0, -9.0]), jnp.array([0.6, 9.0, 9.0])
    narrow = dataclasses.replace(forward, low=ends[0], high=ends[1])
    found = connect(inverse, hold_to_range(narrow, 0.1, outside=outside))
    free = connect(inverse, narrow)
    assert found.low[0] == -0.5 and found.high[0] == 0.6
    assert free.low[0] < -0.5 and free.high[0] > 0.6


def test_an_inverse_with_limits_sees_what_it_was_trained_on(clean, forward, inverse):
    """The reference seen ahead, and d; its own past commands are outputs."""
    ends = jnp.array([-0.5, -0.4, -9.0]), jnp.array([0.6, 0.3, 9.0])
    narrow = dataclasses.replace(inverse, low=ends[0], high=ends[1])
    found = cascade(hold_to_range(narrow, outside="hold"), forward, clean).value
    u, y = [r.u.copy() for r in clean], [r.y.copy() for r in clean]
    for v, r in zip(u, y, strict=True):
        v[:, 1] = np.clip(v[:, 1], -0.4, 0.3)
        r[4:] = np.clip(r[4:], -0.5, 0.6)
    names = {"inputs": clean.channels.inputs, "outputs": clean.channels.outputs}
    by_hand = Dataset.from_arrays(u, y, sample_time=0.1, **names)
    expected = cascade(inverse, forward, by_hand).value
    for a, b in zip(found.commands, expected.commands, strict=True):
        np.testing.assert_allclose(a[5:], b[5:], atol=1e-9)


def test_limits_hold_and_are_marked(clean, forward, inverse):
    found = cascade(inverse, forward, clean, LIMITS)
    assert found.stats["at_range"].max() > 0.05 and found.stats["at_rate"].max() > 0.05
    for u, at_range, at_rate in zip(
        found.value.commands, found.value.at_range, found.value.at_rate, strict=True
    ):
        moved = np.abs(np.diff(u[1:, 0]))
        assert moved.max() <= 0.3 + 1e-12
        # Recorded commands may start outside; from there the rate brings them back.
        assert u[6:].max() <= 0.6 + 1e-12 and u[6:].min() >= -0.5 - 1e-12
        np.testing.assert_array_equal(
            at_rate[3:, 0], np.abs(np.diff(u[2:, 0])) > 0.3 - 1e-9
        )
        free = ~at_range[6:, 0]
        assert np.all((u[6:, 0][free] < 0.6) & (u[6:, 0][free] > -0.5))


def test_a_command_leaves_its_limit_at_once(clean, forward):
    """An inverse that integrates: u(t) = u(t-1) + y_ahead2(t). The reference pushes
    upwards for 40 samples, then downwards: the limited command must fall with the
    first of these, not after unwinding 40 pushes."""
    data = inverse_data(clean, commands=["u"], targets=["y"], forward=forward)
    pool = polynomial_pool(
        data.channels,
        input_lags={"y_ahead2": (0,), "d": ()},
        output_lags=(1,),
        degree=1,
    )
    net = widened(grow(pool, data, Global()).value)
    gain = np.asarray(net.gain)
    local = net.models[0].local
    row = np.asarray(local.factor)[np.asarray(local.index)[0]].max(axis=1)
    integrates = np.array([0.0, gain[0] / gain[2], 1.0])[row]
    net = eqx.tree_at(
        lambda n: n.models[0].local.coefficient, net, jnp.asarray(integrates[None])
    )
    r = np.concatenate([np.full(50, 0.3), np.full(40, -0.1)])
    record = Dataset.from_arrays(
        np.zeros((90, 2)),
        r[:, None],
        inputs=clean.channels.inputs,
        outputs=["y"],
        sample_time=0.1,
    )
    limits = ActuatorLimits(range={"u": (-0.5, 0.6)})
    u = cascade(net, forward, record, limits).value.commands[0][:, 0]
    turn = 48  # where the reference seen two samples ahead turns
    np.testing.assert_allclose(u[10:turn], 0.6, atol=1e-12)
    np.testing.assert_allclose(
        u[turn : turn + 5], 0.6 - 0.1 * np.arange(1, 6), atol=1e-9
    )


@pytest.mark.slow
def test_an_exact_inverse_tracks_what_was_recorded():
    data = recorded(linear)
    forward = exact(data, lags=(2,), degree=1, disturbance=2)
    back = inverse_data(data, commands=["u"], targets=["y"], forward=forward)
    net = polynomial_inverse(back, degree=1)
    other = recorded(linear, seed=7)
    found = cascade(net, forward, other)
    # Two samples at the end are commanded from a reference that is held.
    assert found.stats["nrmse"][0] < 1e-9
    np.testing.assert_allclose(
        found.value.commands[0][2:-2], other.records[0].u[2:-2, :1], atol=1e-8
    )


@pytest.fixture(scope="module")
def scheduled(clean, forward):
    """An inverse of several regions over its command's past and the plant's output,
    which the forward network simulates, and its cascade."""
    data = inverse_data(
        clean, commands=["u"], targets=["y"], forward=forward, states=["y"]
    )
    pool = polynomial_pool(
        data.channels,
        input_lags={"y_ahead2": (0, 1), "d": (0,), "y": (1,)},
        output_lags=(1,),
        degree=1,
    )
    method = Lolimot(scheduling=["y[t-1]", "u[t-1]"], max_models=3)
    net = widened(grow(pool, data, method).value)
    assert int(np.sum(np.asarray(net.models[0].active))) == 3
    return net, cascade(net, forward, clean).value


def rewritten(data: Dataset, found) -> Dataset:
    """The records with the cascade's commands in place of those recorded."""
    rows = [
        np.concatenate([u, r.u[:, 1:]], axis=1)
        for u, r in zip(found.commands, data, strict=True)
    ]
    return Dataset.from_arrays(
        rows,
        [y.copy() for y in found.outputs],
        inputs=data.channels.inputs,
        outputs=data.channels.outputs,
        sample_time=0.1,
    )


@pytest.mark.slow
def test_the_forward_network_alone_agrees(clean, forward, scheduled):
    _, found = scheduled
    alone = simulate(forward, rewritten(clean, found)).value
    for a, b in zip(found.outputs, alone.outputs, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)


@pytest.mark.slow
def test_the_inverse_alone_agrees(clean, forward, scheduled):
    net, found = scheduled
    data = rewritten(clean, found)
    back = inverse_data(
        data, commands=["u"], targets=["y"], forward=forward, states=["y"]
    )
    # References stand where the outputs were read ahead; states are the simulated ones.
    records = [
        np.concatenate([r[2:], back.records[n].u[:, 1:]], axis=1)
        for n, r in enumerate(found.references)
    ]
    asked = Dataset.from_arrays(
        records,
        [r.y for r in back],
        inputs=back.channels.inputs,
        outputs=back.channels.outputs,
        sample_time=0.1,
    )
    one = predict(net, asked).value
    for n, u in enumerate(found.commands):
        np.testing.assert_allclose(one.outputs[n][2:], u[2:-2], atol=1e-12)


@pytest.mark.slow
def test_a_record_does_not_feel_its_neighbours(clean, forward, inverse):
    short = recorded(plant, seed=3, records=1, length=60)
    both = Dataset((*clean.records[:1], *short.records), clean.channels, 0.1)
    alone = cascade(inverse, forward, short).value
    beside = cascade(inverse, forward, both).value
    np.testing.assert_allclose(beside.commands[1], alone.commands[0], atol=1e-12)
    np.testing.assert_allclose(beside.outputs[1], alone.outputs[0], atol=1e-12)


def test_a_forward_network_at_its_bound_is_called_diverged(clean, forward, inverse):
    tight = eqx.tree_at(lambda n: n.upper, forward, forward.lower + 0.1)
    found = cascade(inverse, tight, clean)
    assert found.status_name == "diverged"
    assert found.channel == "y" and "y leaves its bounds" in found.detail


def test_missing_references_are_not_scored(clean, forward, inverse):
    rows = [r.y.copy() for r in clean]
    rows[0][[1, 50]] = np.nan
    data = Dataset.from_arrays(
        [r.u for r in clean],
        rows,
        inputs=clean.channels.inputs,
        outputs=clean.channels.outputs,
        sample_time=0.1,
        missing="mask",
    )
    found = cascade(inverse, forward, data).value
    # The output at 1 is missing: what looks back to it cannot start before 3.
    np.testing.assert_array_equal(np.flatnonzero(~found.scored[0]), [0, 1, 2, 50])
    np.testing.assert_array_equal(np.flatnonzero(~found.scored[1]), [0, 1])
    np.testing.assert_array_equal(found.commands[0][:3], data.records[0].u[:3, :1])
    assert np.isfinite(found.nrmse()).all()


def test_what_does_not_fit_together_is_said(clean, forward, inverse):
    with pytest.raises(SpecError, match="no input of the forward"):
        cascade(forward, forward, clean)
    with pytest.raises(SpecError, match="no command"):
        cascade(inverse, forward, clean, ActuatorLimits(rate={"d": 1.0}))
    with pytest.raises(SpecError, match="nothing in common"):
        cascade(inverse, forward, clean, ActuatorLimits(range={"u": (50.0, 60.0)}))
    slow = eqx.tree_at(lambda n: n.sample_time, inverse, jnp.asarray(0.2))
    with pytest.raises(SpecError, match="sample time"):
        cascade(slow, forward, clean)
    with pytest.raises(DataError, match="needs 2 valid samples"):
        cascade(inverse, forward, recorded(plant, length=2))


@pytest.mark.slow
def test_a_state_that_is_not_known_yet_is_refused(clean, forward):
    data = inverse_data(clean, commands=["u"], targets=["y"], lead=2, states=["y"])
    pool = polynomial_pool(data.channels, input_lags=(0,), output_lags=(), degree=1)
    net = grow(pool, data, Global()).value
    with pytest.raises(SpecError, match="lag 0"):
        cascade(net, forward, clean)


def test_limits_are_checked():
    with pytest.raises(SpecError, match="low < high"):
        ActuatorLimits(range={"u": (1.0, 0.0)})
    with pytest.raises(SpecError, match="positive"):
        ActuatorLimits(rate={"u": 0.0})
