"""A linear model as a network, and what it says of itself."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

import jaxnarx as jnx
from jaxnarx.data import Channel, Channels, Dataset
from jaxnarx.errors import SpecError
from jaxnarx.linear.model import LinearModel
from jaxnarx.linear.structure import Structure
from jaxnarx.solution import RESULTS

CHANNELS = Channels(
    (Channel("duty"), Channel("spark", "deg")),
    (Channel("torque", "Nm"), Channel("speed", "rpm")),
)
SAMPLES, T = 300, 0.03
CONSTANT = 2.0
B = ([3.0, 1.0], [0.5])
DELAYS = (2, 0)


def model(a, c, d, f) -> LinearModel:
    """Of the second output."""
    orders = (len(a) - 1, (2, 1), len(c) - 1, len(d) - 1)
    structure = Structure((0, 1), *orders, tuple(len(x) - 1 for x in f), DELAYS)
    parts = (a[1:], *B, c[1:], d[1:], *(x[1:] for x in f), [CONSTANT])
    theta = jnp.asarray(np.concatenate(parts))
    return LinearModel(
        structure,
        CHANNELS,
        1,
        theta,
        jnp.eye(len(theta)) * 0.01,
        jnp.asarray(0.25),
        jnp.asarray(T),
        jnp.asarray([0.0, -5.0, 0.0, -60.0]),
        jnp.asarray([1.0, 5.0, 1.0, 90.0]),
    )


ARMAX = model([1.0, -0.7, 0.2], [1.0, 0.4], [1.0], ([1.0], [1.0]))
BOX_JENKINS = model([1.0], [1.0, 0.4], [1.0, -0.9], ([1.0, -0.7], [1.0, -0.5, 0.3]))


def inputs() -> np.ndarray:
    rng = np.random.default_rng(0)
    return rng.uniform(0, 1, (SAMPLES, 2)) * [1.0, 8.0] - [0.0, 4.0]


def deterministic(model: LinearModel, u: np.ndarray) -> np.ndarray:
    """The output without noise by scipy's filter, from rest."""
    y = np.zeros(len(u))
    a = np.asarray(model.a)
    for i, (b, f) in enumerate(zip(model.b, model.f, strict=True)):
        numerator = np.concatenate([np.zeros(model.delays[i]), b])
        y += scipy.signal.lfilter(numerator, np.convolve(a, f), u[:, i])
    return y + scipy.signal.lfilter([float(model.constant)], a, np.ones(len(u)))


def dataset(u: np.ndarray, y: np.ndarray) -> Dataset:
    return Dataset.from_arrays(
        u,
        np.stack([0 * y, y], axis=1),
        inputs=CHANNELS.inputs,
        outputs=CHANNELS.outputs,
        sample_time=T,
    )


@pytest.mark.parametrize("one", [ARMAX, BOX_JENKINS], ids=["ARMAX", "BJ"])
def test_the_network_simulates_as_the_filter(one):
    """Over the common denominator, with the constant and each input's delay."""
    u = inputs()
    y = deterministic(one, u)
    network = one.network()
    # Measured only where the run starts: what follows is the network's own.
    measured = y.copy()
    measured[network.history + 20 :] = 0.0
    found = jnx.simulate(network, dataset(u, measured))
    assert found.status == RESULTS.ok
    np.testing.assert_allclose(found.value[0][:, 0], y, atol=1e-10)
    assert network.output_names == ["speed"]


def test_an_unstable_model_simulates_to_diverged():
    wild = model([1.0, -1.3, 0.2], [1.0, 0.4], [1.0], ([1.0], [1.0]))
    assert ARMAX.stable and BOX_JENKINS.stable and not wild.stable
    u = inputs()
    found = jnx.simulate(wild.network(), dataset(u, np.ones(len(u))))
    assert found.status == RESULTS.diverged


def test_polynomials_are_laid_out_as_the_names_say():
    values = dict(
        zip(
            BOX_JENKINS.parameter_names,
            np.asarray(BOX_JENKINS.parameters),
            strict=True,
        )
    )
    assert values["b2(duty)"] == 3.0 and values["b3(duty)"] == 1.0
    assert values["b0(spark)"] == 0.5 and values["c1"] == 0.4
    assert values["d1"] == -0.9 and values["f2(spark)"] == 0.3
    assert values["constant"] == CONSTANT == float(BOX_JENKINS.constant)
    joined = BOX_JENKINS.structure.join(BOX_JENKINS.polynomials)
    np.testing.assert_array_equal(joined, BOX_JENKINS.parameters)
    np.testing.assert_allclose(BOX_JENKINS.standard_errors, 0.1)


def test_transfer_functions_are_of_their_input():
    first = BOX_JENKINS.transfer_function("duty")
    assert first.input == CHANNELS.inputs[0] and first.delay == 2
    assert first.dc_gain == pytest.approx(4 / 0.3)
    both = ARMAX.transfer_function("spark")
    np.testing.assert_allclose(both.denominator, [1.0, -0.7, 0.2])
    noise = BOX_JENKINS.noise_transfer_function()
    assert noise.input is None
    assert noise.dc_gain == pytest.approx(1.4 / 0.1)
    with pytest.raises(SpecError, match="duty"):
        BOX_JENKINS.transfer_function("dutty")
    with pytest.raises(SpecError):
        BOX_JENKINS.transfer_function()


def test_it_reads_as_a_table():
    text = str(BOX_JENKINS)
    assert "speed: noise 0.5 rpm rms, stable" in text
    assert len(text.splitlines()) == 1 + BOX_JENKINS.structure.size
    assert "30.00" in next(line for line in text.splitlines() if "b2(duty)" in line)


def test_a_structure_needs_parameters():
    with pytest.raises(SpecError, match="no parameters"):
        Structure((), 0, (), 0, 0, (), (), constant=False)
    with pytest.raises(ValueError, match="parameters"):
        dataclasses.replace(
            ARMAX, parameters=jnp.zeros(3), covariance=jnp.zeros((3, 3))
        )
