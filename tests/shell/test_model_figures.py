"""Figures of a network's cost, gains and validity: what they mark and what they say."""

import dataclasses

import numpy as np
import pytest
from common import CHANNELS, A, B, Part, network

from jaxnarx.data import Channel, Channels, Dataset
from jaxnarx.errors import SpecError
from jaxnarx.evaluation import describe_partition
from jaxnarx.shell import style
from jaxnarx.shell.local_models_figure import local_models_figure
from jaxnarx.shell.surface_figure import validity_surface
from jaxnarx.shell.trade_off_figure import front, trade_off

EVIL = "<script>alert(1)</script>"


def points_of(axes, *, filled):
    """Data of the markers of an axes; what is on the front is filled."""
    lines = [line for line in axes.lines if line.get_marker() == "o"]
    chosen = [ln for ln in lines if (ln.get_markerfacecolor() != "none") == filled]
    return sorted(
        pair for ln in chosen for pair in zip(*np.asarray(ln.get_data()), strict=True)
    )


def test_trade_off_marks_the_front_of_every_panel():
    error = [0.5, 0.3, None, 0.4, float("inf"), 0.2]
    costs = {"regressors": [2, 4, 1, 6, 1, 900], "local models": [1, 1, 1, 2, 2, 3]}
    groups = [EVIL, "grid", "grid", EVIL, "grid", "grid"]
    figure = trade_off(error, costs, groups=groups)
    first, second = figure.axes
    assert points_of(first, filled=True) == [(2, 0.5), (4, 0.3), (900, 0.2)]
    assert points_of(second, filled=True) == [(1, 0.3), (3, 0.2)]
    assert len(points_of(first, filled=False)) == 4
    assert first.get_xscale() == "log" and second.get_xscale() == "linear"
    page = style.inline_svg(figure, "t-", "t")
    assert "<script" not in page and "&lt;script&gt;" in page


def test_a_fitness_to_be_made_large_has_the_mirrored_front():
    rng = np.random.default_rng(0)
    cost, error = rng.random(30), rng.random(30)
    expected = front(cost, error)
    np.testing.assert_array_equal(front(cost, -error, True), expected)
    figure = trade_off(1 - error, {"a": cost}, larger_is_better=True)
    assert len(points_of(figure.axes[0], filled=True)) == expected.sum()


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
    figure = local_models_figure(blended(dims), data)
    titles = [ax.get_title(loc="left") for ax in figure.axes]
    assert f"gain by {EVIL} [ppm per V]" in titles
    assert "gain by b [ppm per 1]" in titles and "slowest time constant [s]" in titles
    page = style.inline_svg(figure, "l-", "l")
    assert "<script" not in page and "&lt;script&gt;" in page


def test_unstable_local_models_are_crosses_without_gain(data):
    figure = local_models_figure(blended(1, second=1.5), data)
    gain, _, slow = figure.axes[:3]
    assert not [ln for ln in gain.lines if ln.get_marker() == "x"]
    (crosses,) = [ln for ln in slow.lines if ln.get_marker() == "x"]
    assert np.all(np.asarray(crosses.get_xdata()) > 0)


def test_a_surface_needs_two_variables(data):
    two = describe_partition(blended(2))["y"]
    figure = validity_surface(two | {"before": two["after"]})
    assert len(figure.axes) == 2
    assert len(style.inline_svg(figure, "s-", "s")) < 500_000
    with pytest.raises(SpecError, match="two scheduling variables, got 1"):
        validity_surface(describe_partition(blended(1))["y"])


def test_colours_of_local_models_are_all_different_and_begin_with_the_palette():
    """Apart by more than a display's rounding, in one of the three channels."""
    colours = [style.tone(n) for n in range(24)]
    assert tuple(colours[:6]) == style.CYCLE and style.tone(24) == style.tone(0)
    rgb = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in colours])
    apart = np.abs(rgb[:, None] - rgb[None]).max(axis=2) + 255 * np.eye(24, dtype=int)
    assert apart.min() >= 16
