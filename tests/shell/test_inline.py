"""Figures in a page are as drawn, and short."""

import re
from xml.etree import ElementTree

import numpy as np
from matplotlib.figure import Figure

from jaxnarx.shell.figures.inline import inline_svg
from jaxnarx.shell.figures.style import canvas, svg, use_style


def marks() -> Figure:
    """A line of two pieces, and as many bars as a map has cells."""
    with use_style():
        figure, (axes,) = canvas()
        axes.plot([0, 1, 2, np.nan, 4, 5], [0, 1, 4, np.nan, 2, 1])
        axes.bar(np.arange(40), np.arange(40.0))
        axes.set(xlabel="a < b", title="title & more")
    return figure


def points(text: str) -> list[list[float]]:
    """Numbers of every path, in order."""
    root = ElementTree.fromstring(text)
    paths = [e.get("d", "") for e in root.iter() if e.tag.endswith("path")]
    return [[float(x) for x in re.findall(r"-?\d+(?:\.\d+)?", d)] for d in paths]


def test_paths_are_where_they_were_to_two_decimals():
    whole, short = svg(marks()), inline_svg(marks(), "p", "t")
    old, new = points(whole), points(short)
    assert len(old) == len(new) > 40
    for a, b in zip(old, new, strict=True):
        np.testing.assert_allclose(a, b, atol=0.01)
    assert len(short) < 0.6 * len(whole)


def test_styles_and_clips_stand_once_and_belong_to_their_figure():
    root = ElementTree.fromstring(inline_svg(marks(), "my figure", "t"))
    sheet = next(root.iter("style"))
    rules = dict(re.findall(r"\.([\w-]+)\{([^}]*)\}", sheet.text or ""))
    used = [e.get("class") for e in root.iter() if e.get("class")]
    assert set(used) == set(rules) and len(used) > 2 * len(rules)
    assert all(name.startswith("my_figure") for name in rules)
    clips = [rule for rule in rules.values() if "clip-path: url(#my_figure" in rule]
    assert clips
    ids = {e.get("id") for e in root.iter() if e.get("id")}
    assert set(re.findall(r"url\(#([^)]*)\)", " ".join(clips))) <= ids


def test_text_and_blanks_in_it_stay():
    found = "".join(ElementTree.fromstring(inline_svg(marks(), "p", "t")).itertext())
    assert "a < b" in found and "title & more" in found
