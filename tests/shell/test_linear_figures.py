"""Figures of linear models: what they mark and what they say."""

import numpy as np
import pytest
import scipy.signal

from jaxnarx.data import Channel, Dataset
from jaxnarx.linear import TransferFunction, spectra
from jaxnarx.shell.figures import style
from jaxnarx.shell.plot import bode, poles, step_responses

EVIL = "<script>alert(1)</script>"
SYSTEM = TransferFunction(
    np.array([0.0, 1.0, 2.0]),
    np.array([1.0, -1.2, 0.5]),
    0.1,
    Channel("duty", "%"),
    Channel("speed", "rpm"),
)


@pytest.fixture(scope="module")
def data():
    rng = np.random.default_rng(0)
    u = rng.normal(size=1200)
    y = scipy.signal.lfilter(SYSTEM.numerator, SYSTEM.denominator, u)
    y += rng.normal(size=1200)
    channels = {"inputs": [SYSTEM.input], "outputs": [SYSTEM.output]}
    return Dataset.from_arrays(u, y, sample_time=0.1, **channels)


def points(line):
    """x and y of a line."""
    return np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)


def clean(figure):
    page = style.svg(figure)
    assert "<script" not in page
    return page


def test_bode_draws_every_system_and_the_measured_response(data):
    found = spectra(data, segment=128)
    figure = bode({EVIL: SYSTEM, "b": SYSTEM}, measured=found)
    top, bottom = figure.axes
    assert "[rpm per %]" in top.get_ylabel()
    curve = SYSTEM.bode()
    lines = [line for line in top.lines if line.get_label() == style.plain_text(EVIL)]
    np.testing.assert_allclose(points(lines[0])[1], curve.magnitude)
    # Measured phases stand next to the curve, not turns away.
    (dots,) = (line for line in bottom.lines if line.get_linestyle() == "None")
    frequency, phase = points(dots)
    near = np.interp(frequency, curve.frequency, curve.phase)
    assert np.nanmax(np.abs(phase - near)) < 180
    assert "&lt;script&gt;" in clean(figure)


def test_poles_and_zeros_are_marked():
    figure = poles({"a": SYSTEM})
    (ax,) = figure.axes
    crosses = next(line for line in ax.lines if line.get_marker() == "x")
    np.testing.assert_allclose(points(crosses)[0], np.real(SYSTEM.poles))
    # The zero at -2 lies beyond the panel.
    assert "1 beyond" in ax.get_title(loc="left")
    clean(figure)


def test_steps_settle_on_the_dotted_gain():
    figure = step_responses({"a": SYSTEM})
    (ax,) = figure.axes
    step, gain = ax.lines
    assert points(gain)[1][0] == pytest.approx(SYSTEM.dc_gain)
    assert points(step)[1][-1] == pytest.approx(SYSTEM.dc_gain, rel=0.02)
    clean(figure)
