"""Pictures as SVG: every mark is where its numbers say, round numbers beside it."""

import base64
import io
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.image import imread

from jaxnarx.evaluation import (
    Band,
    Bars,
    Cells,
    Chart,
    Curve,
    Picture,
    RegionMap,
    Span,
    StraightLine,
    Text,
)
from jaxnarx.shell.figures.axis import find_axis, fit, text_width
from jaxnarx.shell.figures.palette import DARKENING, channels, on_scale, tone
from jaxnarx.shell.figures.paths import line_path
from jaxnarx.shell.figures.svg import svg


def points(path: str) -> list[np.ndarray]:
    """The pieces of a path of moves and relative lines."""
    pieces = []
    for piece in re.findall(r"M([^M]*)", path):
        start, _, steps = piece.rstrip("z").partition("l")
        numbers = [float(x) for x in re.findall(r"-?\d+(?:\.\d+)?", start)[:2]]
        moves = np.array([float(x) for x in re.findall(r"-?\d+", steps)]).reshape(-1, 2)
        pieces.append(np.cumsum([numbers, *moves.tolist()], axis=0))
    return pieces


def paths(page: str, attribute: str = "") -> list[str]:
    """The shapes of all paths whose text holds the attribute."""
    return [
        m[1]
        for m in re.finditer(r'<path d="([^"]*)"([^>]*)', page)
        if attribute in m[2]
    ]


def test_a_line_comes_back_from_its_path_with_its_gaps():
    rng = np.random.default_rng(0)
    x = np.round(np.cumsum(rng.uniform(0, 20, 200)))
    y = np.round(rng.normal(size=200) * 1e3)
    y[[10, 11, 60]] = np.nan
    found = points(line_path(x, y))
    assert [len(p) for p in found] == [10, 48, 139]
    known = np.isfinite(y)
    np.testing.assert_array_equal(
        np.concatenate(found), np.stack([x[known], y[known]], 1)
    )
    alone = points(line_path(np.array([3.0]), np.array([4.0])))
    assert alone[0].tolist() == [[3.0, 4.0]]


def value_of(text: str) -> float:
    """The number that a tick says: `−2,000`, `0.25` or `−2·10⁻⁶`."""
    raised = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
    text = text.replace("−", "-").replace(",", "")
    found = re.fullmatch(r"(-?)(?:([\d.]+)·)?10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)", text)
    if found is None:
        return float(text)
    size = float(found[2] or 1) * 10.0 ** int(found[3].translate(raised))
    return -size if found[1] else size


@pytest.mark.parametrize("log", [False, True])
def test_ticks_are_few_round_and_say_their_value(log):
    rng = np.random.default_rng(3)
    for _ in range(300):
        low = 10 ** rng.uniform(-8, 7)
        ends = (low, low * 10 ** rng.uniform(0.02, 9))
        if not log:
            ends = tuple((rng.normal() + np.array([0, rng.uniform(0.1, 9)])) * low)
        axis = find_axis((float(ends[0]), float(ends[1])), log, 5.0)
        assert 1 <= len(axis.ticks) <= 12, ends
        for value, text in axis.ticks:
            assert ends[0] <= value <= ends[1]
            told = value_of(text)
            assert told == pytest.approx(value, rel=1e-9, abs=1e-9 * abs(ends[1])), text
        shares = axis.share(np.array(ends))
        np.testing.assert_allclose(shares, [0, 1], atol=1e-12)


def test_an_axis_may_fall_and_may_have_whole_numbers_only():
    axis = find_axis((5.5, -0.5), False, 20.0, whole=True)
    assert [text for _, text in axis.ticks] == list("012345")
    np.testing.assert_allclose(axis.share(np.array([5.5, 2.5, -0.5])), [0, 0.5, 1])


def test_a_curve_stands_where_its_values_are_and_shared_axes_agree():
    x = np.linspace(0, 10, 50)
    charts = [
        Chart((Curve("", x, k * x, "red"),), "t [s]", "y", x_range=(0, 10))
        for k in (1.0, 2.0)
    ]
    apart = svg(Picture(tuple(charts), columns=2), "a", "t")
    first, second = (points(p)[0] for p in paths(apart, "--red"))
    np.testing.assert_array_equal(first, second)  # each fills its own range
    shared = svg(Picture(tuple(charts), columns=2, shared="y"), "a", "t")
    first, second = (points(p)[0] for p in paths(shared, "--red"))
    foot = first[0, 1]
    np.testing.assert_allclose(2 * (foot - first[:, 1]), foot - second[:, 1], atol=1.5)
    assert apart.count(">y</text>") == 2 and shared.count(">y</text>") == 1


def test_what_leaves_the_frame_is_cut_and_what_is_infinite_is_a_gap():
    y = np.array([0.0, 1.0, 1e300, np.inf, 0.5])
    chart = Chart((Curve("", np.arange(5.0), y, "red"),), y_range=(0.0, 1.0))
    (line,) = paths(svg(Picture((chart,)), "a", "t"), "--red")
    pieces = points(line)
    assert [len(p) for p in pieces] == [3, 1]
    assert np.abs(np.concatenate(pieces)).max() < 2e4


def test_every_mark_is_drawn_named_and_clipped_once():
    edges = np.arange(3.0)
    cells = Cells(
        edges, edges, np.array([[1.0, 2.0], [np.nan, 4.0]]), crossed=np.eye(2) > 0
    )
    marks = (
        Span(0.2, 0.4, name="a span"),
        Span(0.2, 0.4, "y", name="another"),
        Band(edges, -1.0, edges, name="a band"),
        Bars([0.5, 1.5], [1.0, np.nan], name="bars"),
        StraightLine(1.0, name="a rule"),
        StraightLine(1.0, "y", line="dashed"),
        *(
            Curve(f"m{m}", edges, edges, n, "", marker=m, hollow=m == "o")
            for n, m in enumerate("osD^vP*Xx|.")
        ),
        Text(1.0, 1.0, "a < b", bold=True, size=12),
        Text(np.inf, 1.0, "nowhere"),
    )
    page = svg(Picture((Chart(marks, legend="right"), Chart((cells,)))), "p q", "a & b")
    root = ElementTree.fromstring(page)
    words = "".join(root.itertext())
    named = [name for m in marks if (name := getattr(m, "name", ""))]
    assert all(words.count(name) == 1 for name in named)
    assert "a < b" in words and "nowhere" not in words
    assert root.get("aria-label") == "a & b"
    ids = [e.get("id") for e in root.iter() if e.get("id")]
    assert len(ids) == len(set(ids)) and all(i and i.startswith("p_q") for i in ids)
    assert set(re.findall(r"url\(#([^)]*)\)", page)) <= set(ids)
    shades = [
        e.get("fill") for e in root.iter() if (e.get("fill") or "").startswith("#")
    ]
    assert set(shades) >= {on_scale(DARKENING, s) for s in (0.0, 1.0)}


def test_the_map_of_regions_is_a_picture_in_the_colours_of_the_models():
    lead = np.zeros((40, 30), int)
    lead[20:, :] = 1
    strength = np.ones((40, 30))
    strength[:, 15:] = 0.0
    chart = Chart((RegionMap((0.0, 1.0), (0.0, 1.0), lead, strength),))
    page = svg(Picture((chart,)), "a", "t")
    (data,) = re.findall(r"data:image/png;base64,([^\"]*)", page)
    image = imread(io.BytesIO(base64.b64decode(data)), format="png")
    assert image.shape == (30, 40, 4)
    for m, column in ((0, 0), (1, -1)):
        np.testing.assert_allclose(
            image[-1, column, :3] * 255, channels(tone(m)), atol=0.5
        )
    np.testing.assert_allclose(image[-1, 0, 3], 0.45, atol=0.01)
    assert image[0, 0, 3] == 0  # upward is the second variable


def test_texts_are_cut_to_the_room_they_have():
    text = "a rather long name of a channel [unit]"
    assert fit(text, 1000.0, 9.0) == text
    short = fit(text, 60.0, 9.0)
    assert short.endswith("…") and text_width(short) < 75


@pytest.mark.parametrize("values", [[], [np.nan, np.inf], [3.0], [0.0, 0.0]])
@pytest.mark.parametrize("log", ["", "xy"])
def test_nothing_or_one_value_is_an_empty_panel(values, log):
    chart = Chart((Curve("", values, values),), log=log)
    ElementTree.fromstring(svg(Picture((chart,)), "a", "t"))
