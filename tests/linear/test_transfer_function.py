"""Transfer functions against scipy.signal and closed forms."""

import numpy as np
import pytest
import scipy.signal

from jaxnarx.data import Channel
from jaxnarx.errors import SpecError
from jaxnarx.linear.transfer_function import TransferFunction

NUMERATOR = [0.0] * 6 + [40.98, 15.69, 23.6, 18.99, 20.27, 65.12]
DENOMINATOR = [1, -0.4303, -0.3422, -0.2126, -0.1174, -0.0136, 0.143]
T = 0.03


def system(numerator, denominator, sample_time=T) -> TransferFunction:
    return TransferFunction(
        np.array(numerator, float),
        np.array(denominator, float),
        sample_time,
        Channel("duty"),
        Channel("speed", "rpm"),
    )


ENGINE = system(NUMERATOR, DENOMINATOR)
"""The thesis's own (4.46)."""


def oracle():
    """The same in rising powers of z: both sides by z^11."""
    bottom = np.concatenate([DENOMINATOR, np.zeros(5)])
    return scipy.signal.dlti(np.trim_zeros(NUMERATOR, "f"), bottom, dt=T)


def by_size(roots):
    return np.sort_complex(np.round(roots, 9))


def test_poles_and_zeros_are_scipys():
    reference = oracle()
    np.testing.assert_allclose(by_size(ENGINE.zeros), by_size(reference.zeros))
    # scipy counts the five poles at the origin that the delay makes.
    poles = np.asarray(reference.poles)
    poles = poles[np.abs(poles) > 1e-6]
    np.testing.assert_allclose(by_size(ENGINE.poles), by_size(poles))
    assert np.all(np.diff(np.abs(ENGINE.poles)) <= 1e-12)
    assert ENGINE.stable and ENGINE.delay == 6


def test_responses_are_scipys():
    frequency = np.geomspace(0.01, 16, 30)
    _, expected = oracle().freqresp(2 * np.pi * frequency * T)
    found = ENGINE.frequency_response(frequency)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    time, step = ENGINE.step_response(100)
    expected = np.asarray(scipy.signal.dlsim(oracle(), np.ones(100))[1])
    np.testing.assert_allclose(step, expected[:, 0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(time, np.arange(100) * T)
    np.testing.assert_allclose(np.diff(step), ENGINE.impulse_response(100)[1:])


def test_bode_is_continuous_and_starts_at_the_gain():
    curve = ENGINE.bode()
    assert curve.frequency[-1] == pytest.approx(0.5 / T)
    assert curve.magnitude[0] == pytest.approx(ENGINE.dc_gain, rel=0.01)
    assert np.abs(np.diff(curve.phase)).max() < 180
    response = ENGINE.frequency_response(curve.frequency)
    np.testing.assert_allclose(
        curve.magnitude * np.exp(1j * np.radians(curve.phase)), response, rtol=1e-9
    )


def test_the_step_settles_at_the_static_gain():
    _, step = ENGINE.step_response()
    # The default length covers five time constants: exp(-5) is left.
    assert step[-1] == pytest.approx(ENGINE.dc_gain, rel=0.01)
    assert ENGINE.dc_gain == pytest.approx(sum(NUMERATOR) / sum(DENOMINATOR))


def test_a_first_order_lag_has_its_time_constant():
    lag = system([0.0, 0.2], [1.0, -0.8])
    assert lag.time_constants == pytest.approx([-T / np.log(0.8)])
    assert lag.damping == pytest.approx([1.0])
    assert lag.natural_frequency == pytest.approx([-np.log(0.8) / T])
    assert lag.dc_gain == pytest.approx(1.0)


def test_a_sampled_oscillator_has_its_damping():
    """Poles exp(T (-z w +- i w sqrt(1 - z^2)))."""
    w, z = 7.0, 0.3
    s = -z * w + 1j * w * np.sqrt(1 - z**2)
    pair = np.poly(np.exp(T * np.array([s, np.conj(s)]))).real
    found = system([1.0], pair)
    np.testing.assert_allclose(found.damping, z)
    np.testing.assert_allclose(found.natural_frequency, w)
    np.testing.assert_allclose(found.time_constants, 1 / (z * w))


def test_an_integrator_and_an_unstable_pole():
    integrator = system([0.0, -2.0], [1.0, -1.0])
    assert integrator.dc_gain == -np.inf and not integrator.stable
    assert integrator.time_constants == pytest.approx([np.inf])
    assert integrator.damping == pytest.approx([1.0])
    wild = system([1.0], [1.0, -1.2])
    assert wild.damping == pytest.approx([-1.0])
    assert np.isinf(wild.time_constants).all()
    assert len(wild.step_response()[1]) == 200


def test_a_pure_delay_has_no_roots():
    delay = system([0.0, 0.0, 3.0], [1.0])
    assert len(delay.poles) == len(delay.zeros) == 0
    assert delay.stable and delay.delay == 2
    np.testing.assert_allclose(delay.step_response(4)[1], [0, 0, 3, 3])
    curve = delay.bode(np.array([1.0]))
    assert curve.phase == pytest.approx([-360 * 2 * T])


def test_it_reads_as_a_ratio():
    text = str(system([0.0, 41.0, -1.5], [1.0, 0.0, -0.25]))
    assert text == "(41 z^-1 - 1.5 z^-2) / (1 - 0.25 z^-2)"
    assert str(system([0.0], [1.0])) == "(0) / (1)"


def test_the_denominator_begins_with_one():
    with pytest.raises(SpecError, match="begin with 1"):
        system([1.0], [2.0, 1.0])
