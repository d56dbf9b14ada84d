"""What stands against an inverse: found, named with its region, and not invented."""

import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from common import device
from inverse_problems import delayed_zero, exact, plant, recorded, reversing, widened

from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.inverse import invertible, reachable
from jaxnarx.inverse.linearise import local_slopes, static_gain, zeros
from jaxnarx.inverse.region import find_region
from jaxnarx.inverse.statics import statics
from jaxnarx.models import Network, hold_to_range
from jaxnarx.partition import grow
from jaxnarx.regressors import LowPass, polynomial_pool
from jaxnarx.settings import Global
from jaxnarx.settings.inverse import ActuatorLimits


def looked_at(forward: Network, data: Dataset, **options):
    """`invertible` from u to y."""
    names: dict[str, Any] = {"commands": ["u"], "targets": ["y"]} | options
    return invertible(forward, data, **names)


@pytest.fixture(scope="module")
def curved(forward, clean):
    return forward, clean


def test_a_plant_that_can_be_inverted_raises_no_error(curved):
    forward, data = curved
    found = looked_at(forward, data)
    assert found.status_name == "ok" and found.value.findings.is_okay
    assert not found.value.findings.of("gain_reversal")
    assert not found.value.findings.of("non_minimum_phase")
    assert found.value.lead == {"y": 2}
    # f'(u) of the plant at u(t-2), where the network looks at it.
    a = found.value.place[:, 0]
    np.testing.assert_allclose(
        found.value.gain[:, 0, 0], 1 + 0.6 * a - 0.3 * a**2, atol=1e-8
    )
    (note,) = found.value.findings.of("dead_time")
    assert note.severity == "note" and "after 2 samples" in note.message


def test_a_gain_through_zero_is_named_with_its_region():
    data = recorded(reversing)
    found = looked_at(exact(data, lags=(1,), degree=2), data)
    assert found.status_name == "unidentifiable"
    (finding,) = found.value.findings.of("gain_reversal")
    region = found.value.regions[list(found.value.findings).index(finding)]
    assert region is not None
    assert finding.severity == "error" and region.channel == "u [deg]"
    # The border lies between neighbouring levels around 0.2, of which there are
    # about forty on a range of two.
    assert region.border == pytest.approx(0.2, abs=0.1) and region.agreement == 1.0
    assert found.detail == finding.message
    # In words, and not by six hundred gains.
    head, *lines = str(found.value).splitlines()
    assert head == "Invertibility: y by u, seen ahead by 1 samples"
    assert f"error: {finding.message}" in lines
    assert repr(found.value) == f"<{head}>"


def test_a_zero_outside_the_unit_circle_asks_for_lead():
    data = recorded(delayed_zero)
    forward = exact(data, lags=(1, 2), degree=1)
    found = looked_at(forward, data, lead=1)
    np.testing.assert_allclose(found.value.zero, 2.0, rtol=1e-6)
    # Dead time 1 and ln(20) / ln(2) = 4.3 samples more.
    assert found.value.lead == {"y": 6}
    kinds = {f.kind: f.severity for f in found.value.findings}
    assert kinds == {"non_minimum_phase": "warning", "dead_time": "warning"}


def square(coupling: float) -> Dataset:
    """Two commands on two outputs; static gains [[2, 0.6], [c / 0.6, 1 / 0.6]].

    The poles are 0.5 and 0.4; det [[w, 0.3 w], [c w, w]] has no root but w = 0.
    """
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(-1, 1, (30, 2)), 5, axis=0)
    y = np.zeros((150, 2))
    for t in range(1, 150):
        y[t, 0] = 0.5 * y[t - 1, 0] + u[t - 1, 0] + 0.3 * u[t - 1, 1]
        y[t, 1] = 0.4 * y[t - 1, 1] + coupling * u[t - 1, 0] + u[t - 1, 1]
    return Dataset.from_arrays(
        u, y, inputs=["p", "q"], outputs=["a", "b"], sample_time=0.1
    )


@pytest.fixture(scope="module")
def pair():
    data = square(0.2)
    pool = polynomial_pool(data.channels, input_lags=(1,), output_lags=(1,), degree=1)
    return widened(grow(pool, data, Global()).value), data


@pytest.mark.slow
def test_gains_and_zeros_of_two_by_two(pair):
    forward, data = pair
    local = local_slopes(forward, data, points=3)
    gain = static_gain(local, [0, 1], [0, 1])
    exact = np.array([[2.0, 0.6], [0.2 / 0.6, 1 / 0.6]])
    np.testing.assert_allclose(gain, np.tile(exact, (3, 1, 1)), atol=1e-9)
    assert all(len(z) == 0 for z in zeros(local, [0, 1], [0, 1]))
    # From p to b the pole of a, which nothing shows, remains.
    np.testing.assert_allclose(zeros(local, [1], [0]), [[0.5]] * 3, atol=1e-9)


@pytest.mark.slow
def test_the_commands_that_hold_a_reference(pair):
    forward, data = pair
    wanted = np.array([[0.5, -0.3], [-1.0, 0.4], [9.0, 9.0]])
    held = Dataset.from_arrays(
        [np.zeros((4, 2))] * 3,
        [np.tile(w[None], (4, 1)) for w in wanted],
        inputs=["p", "q"],
        outputs=["a", "b"],
        sample_time=0.1,
    )
    found = reachable(forward, held, commands=["p", "q"], targets=["a", "b"], grid=5)
    value = found.value
    exact = np.array([[2.0, 0.6], [0.2 / 0.6, 1 / 0.6]])
    for n in range(2):
        assert value.reached[n].all()
        best = np.linalg.solve(exact, wanted[n])
        np.testing.assert_allclose(value.commands[n][0], best, atol=1e-6)
        np.testing.assert_allclose(value.outputs[n][0], wanted[n], atol=1e-6)
    # Out of reach on both: both commands at the upper end of their training.
    assert not value.reached[2].any() and found.status_name == "unidentifiable"
    top = np.max(data.records[0].u, axis=0)
    np.testing.assert_allclose(value.commands[2][0], top, atol=1e-9)
    assert found.stats["reached"] == pytest.approx(2 / 3)


def test_what_is_out_of_reach_is_found_by_invertible(curved):
    forward, data = curved
    limits = ActuatorLimits(range={"u": (-0.2, 0.2)})
    found = looked_at(forward, data, references=data, limits=limits)
    (finding,) = found.value.findings.of("unreachable")
    reach = found.value.reach
    assert reach is not None
    for record, ok, u in zip(data, reach.reached, reach.commands, strict=True):
        d, r = record.u[:, 1], record.y[:, 0]
        # At rest y = f(u) + 0.25 d; f rises, so its ends are those of the range.
        ends = [a + 0.3 * a**2 - 0.1 * a**3 + 0.25 * d for a in (-0.2, 0.2)]
        # Tolerance: one hundredth of the training range of y.
        slack = 0.0101 * float(forward.high[2] - forward.low[2])
        inside = (r > ends[0] - slack) & (r < ends[1] + slack)
        np.testing.assert_array_equal(ok, inside)
        np.testing.assert_allclose(u[r > ends[1] + slack], 0.2, atol=1e-9)


@pytest.mark.slow
def test_filters_count_in_gains_and_zeros():
    """y = lp(u) with lag 1: static gain 1, no zero; the filter's pole is none."""
    data = recorded(plant, records=1)
    pool = polynomial_pool(
        data.channels,
        input_lags={"d": (1,)},
        output_lags=(),
        degree=1,
        filters={"u": [LowPass(0.5)]},
        filter_lags=(1,),
    )
    net = grow(pool, data, Global()).value
    local = local_slopes(net, data, points=2)
    gain = static_gain(local, [0], [0])
    slope = {text: c for text, c in net.equations()[0]["terms"]}
    (filtered,) = [c for text, c in slope.items() if text.startswith("lp(")]
    np.testing.assert_allclose(gain, filtered, rtol=1e-9)
    assert all(len(z) == 0 for z in zeros(local, [0], [0]))


def test_a_model_with_limits_is_linearised_where_it_sees_its_inputs(curved):
    """Slopes stand still beyond the range, and a command beyond it changes nothing."""
    forward, data = curved
    ends = jnp.array([-0.5, -0.4, -2.0]), jnp.array([0.6, 0.3, 2.0])
    narrow = dataclasses.replace(forward, low=ends[0], high=ends[1])
    held = hold_to_range(narrow, outside="hold")
    records = tuple(
        dataclasses.replace(r, u=np.clip(r.u, [-0.5, -0.4], [0.6, 0.3])) for r in data
    )
    by_hand = dataclasses.replace(data, records=records)
    found, expected = local_slopes(held, data), local_slopes(forward, by_hand)
    np.testing.assert_array_equal(found.slope, expected.slope)
    np.testing.assert_array_equal(found.place, expected.place)
    far, edge = device(np.array([0.9, -1.0, 0.1])), device(np.array([0.6, -0.4, 0.1]))
    y = device(np.array([0.2]))
    limited, free = (eqx.filter_jit(statics(net)) for net in (held, forward))
    np.testing.assert_array_equal(limited(y, far), free(y, edge))


def test_names_are_checked(curved):
    for wrong in ({"commands": ["y"]}, {"targets": ["u"]}, {"commands": []}):
        with pytest.raises(SpecError):
            looked_at(*curved, **wrong)


def test_a_region_is_a_clean_cut():
    rng = np.random.default_rng(0)
    place = rng.uniform(size=(200, 2))
    found = find_region(place, ["a", "b"], place[:, 1] < 0.25)
    assert (found.channel, found.above, found.agreement) == ("b", False, 1.0)
    assert found.border == pytest.approx(0.25, abs=0.02)
    mirrored = find_region(-place, ["a", "b"], place[:, 1] < 0.25)
    assert mirrored.above and mirrored.border == pytest.approx(-found.border)
