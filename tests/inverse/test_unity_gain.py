"""Static gain and frequency response of cascades."""

import numpy as np
import pytest
from inverse_problems import exact, linear, polynomial_inverse, recorded

from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.inverse import cascade, inverse_data, unity_gain
from jaxnarx.settings.inverse import ActuatorLimits


@pytest.mark.slow
def test_an_exact_inverse_gives_one_at_every_frequency():
    data = recorded(linear)
    forward = exact(data, lags=(2,), degree=1, disturbance=2)
    back = inverse_data(data, commands=["u"], targets=["y"], forward=forward)
    inverse = polynomial_inverse(back, degree=1)
    found = unity_gain(inverse, forward, data, points=4, settle=60, frequencies=5)
    value = found.value
    assert found.status_name == "ok" and value.settled.all() and not value.held.any()
    np.testing.assert_allclose(value.gain, 1.0, atol=1e-9)
    np.testing.assert_allclose(value.response, 1.0, atol=1e-9)
    np.testing.assert_allclose(value.output, value.reference, atol=1e-9)
    assert value.worst() < 1e-9


@pytest.fixture(scope="module")
def curved(inverse, forward, clean):
    return inverse, forward, clean


@pytest.fixture(scope="module")
def checked(curved):
    return unity_gain(*curved, points=4, settle=60, frequencies=5).value


def held(data: Dataset, place: np.ndarray, references: np.ndarray) -> Dataset:
    """Records in which every signal stays at its value, the reference at another."""
    length = 80
    rows = [np.tile(place[None], (length, 1)) for _ in references]
    return Dataset.from_arrays(
        [r[:, :2] for r in rows],
        [np.full((length, 1), r) for r in references],
        inputs=data.channels.inputs,
        outputs=["y"],
        sample_time=0.1,
    )


def test_the_static_gain_is_that_of_small_steps(curved, checked):
    inverse, forward, data = curved
    step = 1e-4
    for p in (0, 2):
        r = float(checked.reference[p, 0])
        asked = held(data, checked.place[p], np.array([r - step, r + step]))
        low, high = (y[-1, 0] for y in cascade(inverse, forward, asked).value.outputs)
        # 0.6^80 of the step is still on its way; curvature gives step^2.
        slope = (high - low) / (2 * step)
        assert checked.gain[p, 0, 0] == pytest.approx(slope, rel=1e-6)
        assert checked.output[p, 0] == pytest.approx((low + high) / 2, abs=1e-6)


def test_the_response_begins_at_the_static_gain(checked):
    # At 1/60 of half the sampling rate the phase is small and the size that at rest.
    np.testing.assert_allclose(
        np.abs(checked.response[:, 0]), np.abs(checked.gain), rtol=0.05
    )


def test_a_command_at_its_limit_is_marked(curved):
    limits = ActuatorLimits(range={"u": (-0.01, 0.01)})
    found = unity_gain(*curved, points=4, settle=60, frequencies=5, limits=limits)
    value = found.value
    assert value.held.any()
    np.testing.assert_array_equal(value.gain[value.held], 0.0)
    with pytest.raises(SpecError):
        unity_gain(*curved, settle=2)
