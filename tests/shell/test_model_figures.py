"""Figures of local models: what they mark and what they say."""

import dataclasses

import numpy as np
import pytest
from common import CHANNELS, A, B, Part, network

from jaxnarx.data import Channel, Channels, Dataset
from jaxnarx.shell.figures import style
from jaxnarx.shell.plot import local_models

EVIL = "<script>alert(1)</script>"


NAMED = Channels((Channel(EVIL, "V"), Channel("b")), CHANNELS.outputs)


def blended(dims, second=0.3):
    part = Part(
        [[((0, 1), 1.0), ((3, 0), 0.5)], [((2,), 1.0), ((3,), second)]],
        scheduling=((A, 0), (B, 1))[:dims],
        offset=[-1.0, -1.0][:dims],
        span=[2.0, 2.0][:dims],
        centre=[[0.2, 0.5][:dims], [0.8, 0.5][:dims]],
        width=[[0.2, 0.2][:dims]] * 2,
    )
    terms = [[(tuple((0,) * (2 - len(r)) + r), c) for r, c in m] for m in part.models]
    net = network([dataclasses.replace(part, models=terms)])
    return dataclasses.replace(net, channels=NAMED)


@pytest.fixture(scope="module")
def data():
    rng = np.random.default_rng(7)
    return Dataset.from_arrays(
        rng.uniform(-1, 1, (60, 2)),
        rng.uniform(-1, 1, (60, 2)),
        inputs=[EVIL, "b"],
        outputs=["y", "w"],
        sample_time=0.1,
        units={EVIL: "V", "y": "ppm"},
    )


@pytest.mark.parametrize("dims", [1, 2])
def test_local_models_show_gains_and_poles(data, dims):
    figure = local_models(blended(dims), data)
    titles = [ax.get_title(loc="left") for ax in figure.axes]
    assert f"gain by {EVIL} [ppm per V]" in titles
    assert "gain by b [ppm per 1]" in titles and "slowest time constant [s]" in titles
    page = style.svg(figure)
    assert "<script" not in page and "&lt;script&gt;" in page


def test_unstable_local_models_are_crosses_without_gain(data):
    figure = local_models(blended(1, second=1.5), data)
    gain, _, slow = figure.axes[:3]
    assert not [ln for ln in gain.lines if ln.get_marker() == "x"]
    (crosses,) = [ln for ln in slow.lines if ln.get_marker() == "x"]
    assert np.all(np.asarray(crosses.get_xdata()) > 0)


def test_colours_of_local_models_are_all_different_and_begin_with_the_palette():
    """Apart by more than a display's rounding, in one of the three channels."""
    colours = [style.tone(n) for n in range(24)]
    assert tuple(colours[:6]) == style.COLOUR_CYCLE and style.tone(24) == style.tone(0)
    rgb = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in colours])
    apart = np.abs(rgb[:, None] - rgb[None]).max(axis=2) + 255 * np.eye(24, dtype=int)
    assert apart.min() >= 16
