"""Where the panels of a picture stand, and the room about them."""

import dataclasses
import math
from collections.abc import Iterator

from jaxnarx.evaluation import Cells, Chart, Mark, Number, Picture, Range
from jaxnarx.shell.figures.axis import FONT, SMALL_FONT, Axis, find_axis, text_width
from jaxnarx.shell.figures.palette import shorten

INCH = 72
LINE = 1.3
"""Height of a line of text, of its letters."""
SCALE_WIDTH = 50
"""Points that the scale of coloured cells takes at the right."""
SAMPLE = 18
"""Points of a mark's sample in a legend, with the gap behind it."""


@dataclasses.dataclass(frozen=True)
class Room:
    """Points that a panel needs about it, and its axes."""

    x: Axis
    y: Axis
    left: Number
    right: Number
    top: Number
    bottom: Number
    legend: tuple[tuple[tuple[Mark, Number], ...], ...]
    """Rows of marks with a name, and where each begins."""


@dataclasses.dataclass(frozen=True)
class PanelPlace:
    """Where a chart stands: `corner` is the upper left of its axes, `size` theirs, and
    `left` the room at their left, in points; `numbers` tells whether numbers stand at
    the left and below."""

    chart: Chart
    room: Room
    corner: tuple[Number, Number]
    size: tuple[Number, Number]
    font: Number
    numbers: tuple[bool, bool]
    left: Number


def lay_out(picture: Picture) -> Iterator["PanelPlace"]:
    """Every panel with its place; those of a row or of a column stand in line."""
    font = SMALL_FONT if picture.small else FONT
    columns, rows = picture.columns, picture.rows
    width, height = picture.width * INCH, picture.height * INCH
    shares = [
        _shares(s, n) for s, n in ((picture.widths, columns), (picture.heights, rows))
    ]
    edge = [
        (n % columns == 0, n + columns >= len(picture.charts))
        for n in range(len(picture.charts))
    ]
    rooms = [
        _need(
            chart,
            ends,
            (shares[0][n % columns] * width, shares[1][n // columns] * height),
            font,
            first or "y" not in picture.shared,
            last or "x" not in picture.shared,
        )
        for n, (chart, ends, (first, last)) in enumerate(
            zip(picture.charts, picture.ranges(), edge, strict=True)
        )
    ]

    def most(side: str, group: int, *, by_row: bool) -> Number:
        """The most room that a row or a column needs at one side."""
        own = [
            getattr(room, side)
            for n, room in enumerate(rooms)
            if (n // columns if by_row else n % columns) == group
        ]
        return max(own, default=0.0)

    left = [most("left", c, by_row=False) for c in range(columns)]
    right = [most("right", c, by_row=False) for c in range(columns)]
    top = [most("top", r, by_row=True) for r in range(rows)]
    bottom = [most("bottom", r, by_row=True) for r in range(rows)]
    broad = max(width - sum(left) - sum(right), 20.0 * columns)
    high = max(height - sum(top) - sum(bottom), 12.0 * rows)
    for n, (chart, room) in enumerate(zip(picture.charts, rooms, strict=True)):
        r, c = divmod(n, columns)
        before = sum(left[: c + 1]) + sum(right[:c]) + broad * sum(shares[0][:c])
        above = sum(top[: r + 1]) + sum(bottom[:r]) + high * sum(shares[1][:r])
        size = broad * shares[0][c], high * shares[1][r]
        labels = (
            edge[n][0] or "y" not in picture.shared,
            (edge[n][1] or "x" not in picture.shared),
        )
        yield PanelPlace(chart, room, (before, above), size, font, labels, left[c])


def _shares(given: tuple[Number, ...], count: int) -> list[float]:
    values = given or (1.0,) * count
    return [v / sum(values) for v in values]


def _need(
    chart: Chart,
    ends: tuple[Range, Range],
    size: tuple[Number, Number],
    font: Number,
    numbers_left: bool,
    numbers_below: bool,
) -> Room:
    """The room that a chart needs in a place of about `size` points."""
    line = LINE * font
    x = find_axis(
        ends[0],
        "x" in chart.log,
        size[0] / 50,
        whole="x" in chart.whole,
        ticks=chart.x_ticks,
    )
    y = find_axis(
        ends[1],
        "y" in chart.log,
        size[1] / 30,
        whole="y" in chart.whole,
        ticks=chart.y_ticks,
    )
    if chart.bare:
        return Room(x, y, 2, 2, line if chart.title else 2, 2, ())
    left = 7.0
    if numbers_left:
        left += max((text_width(t, font) for _, t in y.ticks), default=0) + 5
    left += line if chart.y_label and numbers_left else 0
    right = 0.5 * text_width(x.ticks[-1][1], font) if x.ticks else 4
    cells = any(isinstance(m, Cells) for m in chart.marks)
    right = max(right, 6) + (SCALE_WIDTH if cells else 0)
    named = chart.legend_marks
    room_below = size[0] - left - right
    legend: list[list[tuple[Mark, Number]]] = []
    at = math.inf
    if chart.legend == "right" and named:
        right += 10 + SAMPLE + max(text_width(name_of(m), font) for m in named)
        legend = [[(m, 0.0)] for m in named]
    elif named:
        for mark in named:
            broad = SAMPLE + text_width(name_of(mark), font) + 12
            if at + broad > max(room_below, broad) + 0.1:
                legend.append([])
                at = 0.0
            legend[-1].append((mark, at))
            at += broad
    lines = (1 if chart.title else 0) + (len(legend) if chart.legend == "above" else 0)
    top = 5 + line * lines
    bottom = 4 + (line if numbers_below else 0)
    bottom += line if chart.x_label and numbers_below else 0
    return Room(x, y, left, right, top, bottom, tuple(map(tuple, legend)))


def name_of(mark: Mark) -> str:
    """The mark's name in a legend."""
    return shorten(getattr(mark, "name", ""), 60)
