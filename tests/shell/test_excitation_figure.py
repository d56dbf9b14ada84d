"""The figure of an excitation: drawn for every kind of record, with its numbers."""

import matplotlib.figure
import numpy as np
import pytest

from jaxnarx.data import Channel, Dataset
from jaxnarx.excitation import assess
from jaxnarx.shell.figures import style
from jaxnarx.shell.figures.excitation import excitation

EVIL = "<script>alert(1)</script> $x_$ & 転"


def data(length=400, inputs=2, *, records=1, name="u", constant=False):
    rng = np.random.default_rng(inputs)
    u = [np.repeat(rng.random((length, inputs)), 7, axis=0)[:length] for _ in range(2)]
    u = [100 * x for x in u[:records]]
    for x in u:
        x[:, 0] = 3.0 if constant else x[:, 0]
    return Dataset.from_arrays(
        u,
        [x.sum(axis=1) for x in u],
        inputs=[Channel(f"{name}{i}", "kg/h") for i in range(inputs)],
        outputs=[Channel("torque", "N m")],
        sample_time=0.1,
    )


def texts(figure: matplotlib.figure.Figure) -> str:
    return style.svg(figure)


def test_the_figure_tells_the_numbers():
    given = data(inputs=3, records=2)
    found = assess(given, bins=6)
    text = texts(excitation(given, bins=6, outputs=True))
    cover = found.coverage
    for i, j in [(1, 0), (2, 0), (2, 1)]:
        assert f">{cover.pairs[i, j]:.0%}<" in text
    assert f"{cover.whole:.0%} of {cover.whole_bins}³ cells" in text
    for width in found.bandwidth:
        assert f"95% below {width:.3g} Hz" in text
    for label in ("u0 [kg/h]", "torque [N m]", "[(kg/h)²/Hz]", "time [s]"):
        assert label in text


def test_the_operating_space_is_the_given_one():
    given = data()
    figure = excitation(given, ranges={"u0": (-200.0, 200.0), "u1": (0.0, 300.0)})
    spaces = [(a.get_xlim(), a.get_ylim()) for a in axes(figure)]
    assert ((-200.0, 200.0), (0.0, 300.0)) in spaces


def axes(figure):
    return [a for part in figure.subfigs for a in part.axes]


@pytest.mark.parametrize("inputs", [1, 6])
def test_any_number_of_inputs_has_its_maps(inputs):
    figure = excitation(data(inputs=inputs, records=2))
    maps = [a for a in figure.subfigs[1].axes if a.get_visible()]
    # 15 pairs and the scale of their colours, or one histogram.
    assert len(maps) == (16 if inputs == 6 else 1)
    assert len(figure.subfigs[0].axes) == 2 * inputs


@pytest.mark.parametrize("length", [1, 2, 9])
@pytest.mark.parametrize("constant", [False, True])
def test_short_and_constant_records_are_drawn(length, constant):
    for inputs in (1, 2):
        text = texts(excitation(data(length, inputs, constant=constant)))
        assert ("constant" in text) == (constant or length < 8)


def test_missing_samples_are_gaps():
    given = data()
    u = given.records[0].u.copy()
    u[100:200, 1] = np.nan
    holed = Dataset.from_arrays(
        u,
        given.records[0].y,
        inputs=["a", "b"],
        outputs=["y"],
        sample_time=0.1,
        missing="mask",
    )
    drawn = [a.lines[0].get_ydata() for a in excitation(holed).subfigs[0].axes[::2]]
    assert np.isnan(drawn[1]).sum() == 100 and not np.isnan(drawn[0]).any()


def test_channel_names_are_text():
    page = style.svg(excitation(data(name=EVIL)))
    assert "<script" not in page and "&lt;script&gt;" in page


def test_a_long_record_stays_a_small_figure():
    figure = excitation(data(100_000, 3))
    points = [np.size(line.get_xdata()) for a in axes(figure) for line in a.lines]
    assert max(points) <= 1500
    assert len(texts(figure)) < 500_000
