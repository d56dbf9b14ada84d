"""Pictures as `<svg>` elements of a page, written without a drawing library.

A page shows its figures where no script runs, on paper too, so they are elements of it.
They are short (whole tenths of a point, each point told from the one before), take ink,
grid and palette from the style of the page, and need no drawing library.
"""

import dataclasses
import math
from collections.abc import Iterator
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from jaxtyping import Float

from jaxnarx.evaluation import (
    Band,
    Bars,
    Cells,
    Curve,
    Mark,
    Number,
    Picture,
    RegionMap,
    Span,
    StraightLine,
    Text,
    Values,
    floats,
)
from jaxnarx.shell.figures.axis import (
    FONT,
    Axis,
    find_axis,
    fit,
)
from jaxnarx.shell.figures.layout import (
    INCH,
    LINE,
    SAMPLE,
    PanelPlace,
    lay_out,
    name_of,
)
from jaxnarx.shell.figures.palette import shorten
from jaxnarx.shell.figures.paths import (
    STEPS,
    area_paths,
    cell_colour,
    css,
    fill,
    line_path,
    markers,
    png_of,
    stroke,
    tenths,
)


def svg(picture: Picture, prefix: str, title: str) -> str:
    """The picture as an element to stand in an HTML page.

    `prefix` begins every identifier in it, so that figures do not meet; `title` is for
    readers that cannot see it.
    """
    prefix = "".join(c if c.isalnum() or c in "-_" else "_" for c in prefix)
    width, height = picture.width * INCH, picture.height * INCH
    parts = [
        f'<svg viewBox="0 0 {width:g} {height:g}" role="img" '
        f"aria-label={quoteattr(title)}>"
    ]
    for n, place in enumerate(lay_out(picture)):
        parts += _Panel(place).draw(f"{prefix}{n}")
    return "".join([*parts, "</svg>"])


@dataclasses.dataclass(frozen=True)
class _Panel:
    """A chart that is drawn at its place."""

    at: PanelPlace

    def draw(self, prefix: str) -> Iterator[str]:
        """Everything in it; `prefix` is its own."""
        (x, y), (width, height) = self.at.corner, self.at.size
        yield f'<g transform="translate({x:.1f} {y:.1f})" font-size="{self.at.font:g}">'
        if not self.at.chart.bare:
            yield from self._axes()
        broad, high = round(10 * width), round(10 * height)
        yield (
            f'<clipPath id="{prefix}c"><path d="M-9-9h{broad + 18}v{high + 18}'
            f'h-{broad + 18}z"/></clipPath>'
        )
        clip = "" if self.at.chart.bare else f' clip-path="url(#{prefix}c)"'
        # Inside, a unit is a tenth of a point.
        yield f'<g transform="scale(.1)"{clip} fill="none">'
        texts = []
        for mark in self.at.chart.marks:
            if isinstance(mark, Text):
                texts.append(mark)
            else:
                yield from self._mark(mark)
        yield "</g>"
        for mark in texts:
            yield self._text(mark)
        yield from self._legend()
        for mark in self.at.chart.marks:
            if isinstance(mark, Cells):
                yield from self._scale(mark, prefix)
        yield "</g>"

    def _axes(self) -> Iterator[str]:
        """Grid, edges, numbers, labels and title."""
        (width, height), room = self.at.size, self.at.room
        across = [(width * float(s), t) for s, t in _placed(room.x)]
        up = [(height * (1 - float(s)), t) for s, t in _placed(room.y)]
        grid = "".join(f"M{p:.1f} 0v{height:.1f}" for p, _ in across)
        grid += "".join(f"M0 {p:.1f}h{width:.1f}" for p, _ in up)
        if grid and not any(
            isinstance(m, Cells | RegionMap) for m in self.at.chart.marks
        ):
            yield f'<path d="{grid}" style="stroke:var(--grid)" stroke-width=".5"/>'
        yield (
            f'<path d="M0 0v{height:.1f}h{width:.1f}" fill="none" '
            'stroke="currentColor" stroke-width=".6"/>'
        )
        if self.at.numbers[1]:
            for p, text in across:
                yield _write(p, height + 1.2 * self.at.font, text, "middle")
        if self.at.numbers[0]:
            for p, text in up:
                yield _write(-4, p + 0.35 * self.at.font, text, "end")
        line = LINE * self.at.font
        if self.at.chart.x_label and self.at.numbers[1]:
            room_for = width + 2 * min(self.at.left, 40)
            text = fit(self.at.chart.x_label, room_for, self.at.font)
            yield _write(width / 2, height + 1.2 * self.at.font + line, text, "middle")
        if self.at.chart.y_label and self.at.numbers[0]:
            text = fit(self.at.chart.y_label, height + 20, self.at.font)
            place = f"translate({8 - self.at.left:.1f} {height / 2:.1f})rotate(-90)"
            yield (
                f'<text transform="{place}" text-anchor="middle" '
                f'style="fill:currentColor">{escape(text)}</text>'
            )
        if self.at.chart.title:
            rows = len(self.at.room.legend) if self.at.chart.legend == "above" else 0
            text = fit(self.at.chart.title, width + 20, self.at.font)
            yield _write(0, -5 - rows * line, text, "start")

    def _x(self, value: Values) -> Float[np.ndarray, " _"]:
        return tenths(self.at.room.x.share(floats(value)), self.at.size[0])

    def _y(self, value: Values) -> Float[np.ndarray, " _"]:
        return tenths(1 - self.at.room.y.share(floats(value)), self.at.size[1])

    def _mark(self, mark: Mark) -> Iterator[str]:
        match mark:
            case Curve():
                yield from self._curve(mark)
            case Band():
                x, low, high = mark.points
                if self.at.room.y.log:
                    low = np.maximum(low, self.at.room.y.low)
                shape = "".join(area_paths(self._x(x), self._y(low), self._y(high)))
                yield f'<path d="{shape}" {fill(mark.colour, mark.opacity)}/>'
            case Span():
                yield self._span(mark)
            case StraightLine():
                line = stroke(mark.colour, mark.width, mark.line)
                yield f'<path d="{self._across(mark.axis, mark.at)}" {line}/>'
            case Bars():
                yield self._bars(mark)
            case Cells():
                yield from self._cells(mark)
            case RegionMap():
                yield self._regions(mark)
            case Text():
                pass

    def _curve(self, mark: Curve) -> Iterator[str]:
        colour = self.at.chart.colour_of(mark)
        x, y = (f(v) for f, v in zip((self._x, self._y), mark.points, strict=True))
        if mark.line:
            shape = line_path(x, y)
            look = stroke(colour, mark.width, mark.line, mark.opacity)
            yield f'<path d="{shape}" {look} stroke-linejoin="round"/>'
        if mark.marker:
            yield markers(x, y, mark, colour)

    def _across(self, axis: str, at: Number) -> str:
        width, height = round(10 * self.at.size[0]), round(10 * self.at.size[1])
        if axis == "x":
            place = self._x(at)[0]
            return f"M{place:.0f} 0v{height}" if place == place else ""
        place = self._y(at)[0]
        return f"M0 {place:.0f}h{width}" if place == place else ""

    def _span(self, mark: Span) -> str:
        ends = mark.start, mark.end
        width, height = round(10 * self.at.size[0]), round(10 * self.at.size[1])
        if mark.axis == "x":
            a, b = self._x(ends)
            shape = f"M{a:.0f} 0H{b:.0f}V{height}H{a:.0f}z"
        else:
            a, b = self._y(ends)
            shape = f"M0 {a:.0f}V{b:.0f}H{width}V{a:.0f}z"
        return f'<path d="{shape}" {fill(mark.colour, mark.opacity)}/>'

    def _bars(self, mark: Bars) -> str:
        at, long = floats(mark.at), self._x(mark.length)
        low, high = (self._y(at + s * mark.height / 2) for s in (-1, 1))
        shape = "".join(
            f"M0 {a:.0f}H{x:.0f}V{b:.0f}H0z"
            for x, a, b in zip(long, low, high, strict=True)
            if x == x
        )
        return f'<path d="{shape}" {fill(mark.colour, 0.9)}/>'

    def _cells(self, mark: Cells) -> Iterator[str]:
        """A path for each step of the scale."""
        x, y = self._x(mark.x_edges), self._y(mark.y_edges)
        low, high = mark.ends
        share = (mark.value - low) / (high - low)
        step = np.where(np.isfinite(share), np.round(share * (STEPS - 1)), -1)
        for one in np.unique(step[step >= 0]).astype(int):
            shape = "".join(
                f"M{x[i]:.0f} {y[j]:.0f}H{x[i + 1]:.0f}V{y[j + 1]:.0f}H{x[i]:.0f}z"
                for i, j in np.argwhere(step == one).tolist()
            )
            yield f'<path d="{shape}" fill="{cell_colour(mark, one / (STEPS - 1))}"/>'
        if mark.crossed is not None:
            shape = "".join(
                f"M{x[i]:.0f} {y[j]:.0f}L{x[i + 1]:.0f} {y[j + 1]:.0f}"
                for i, j in np.argwhere(mark.crossed & (step >= 0)).tolist()
            )
            yield f'<path d="{shape}" {stroke("ink", 0.5, "solid")}/>'

    def _scale(self, mark: Cells, prefix: str) -> Iterator[str]:
        """The scale of the colours, at the right of the panel."""
        left, height = self.at.size[0] + 8, self.at.size[1]
        stops = "".join(
            f'<stop offset="{n / 8:g}" stop-color="{cell_colour(mark, n / 8)}"/>'
            for n in range(9)
        )
        yield (
            f'<linearGradient id="{prefix}g" x1="0" y1="1" x2="0" y2="0">{stops}'
            f'</linearGradient><rect x="{left:.1f}" width="8" height="{height:.1f}" '
            f'fill="url(#{prefix}g)"/>'
        )
        axis = find_axis(mark.ends, False, height / 30)
        for share, text in _placed(axis):
            place = height * (1 - float(share)) + 0.35 * self.at.font
            yield _write(left + 11, place, text, "start")

    def _regions(self, mark: RegionMap) -> str:
        left, right = self._x(mark.x_range)
        low, high = self._y(mark.y_range)
        return (
            f'<image x="{left:.0f}" y="{high:.0f}" width="{right - left:.0f}" '
            f'height="{low - high:.0f}" preserveAspectRatio="none" '
            f'href="data:image/png;base64,{png_of(mark)}"/>'
        )

    def _text(self, mark: Text) -> str:
        x = self._x(mark.x)[0] / 10 + mark.nudge[0]
        y = self._y(mark.y)[0] / 10 - mark.nudge[1]
        if not (math.isfinite(x) and math.isfinite(y)):
            return ""
        size = mark.size * (self.at.font / FONT)
        y += {"bottom": 0.0, "middle": 0.35, "top": 0.75}[mark.up] * size
        anchor = {"left": "start", "centre": "middle", "right": "end"}[mark.across]
        more = ' font-weight="bold"' if mark.bold else ""
        more += f' font-size="{size:g}"' if size != self.at.font else ""
        return _write(x, y, shorten(mark.text, 80), anchor, css(mark.colour), more)

    def _legend(self) -> Iterator[str]:
        line, rows = LINE * self.at.font, self.at.room.legend
        if self.at.chart.legend == "right":
            corner = (
                self.at.size[0] + 12,
                0.5 * (self.at.size[1] - line * len(rows)) + line,
            )
        else:
            corner = 0.0, -5 - line * (len(rows) - 1)
        for n, row in enumerate(rows):
            for mark, at in row:
                x, y = corner[0] + at, corner[1] + n * line
                yield self._sample(mark, x, y - 0.32 * self.at.font)
                yield _write(x + SAMPLE - 3, y, name_of(mark), "start")

    def _sample(self, mark: Mark, x: Number, y: Number) -> str:
        """A piece of the mark as it is drawn."""
        if isinstance(mark, Curve):
            colour = self.at.chart.colour_of(mark)
            text = ""
            if mark.line:
                width = min(mark.width, 4)
                look = stroke(colour, width, mark.line, mark.opacity, unit=1)
                text = f'<path d="M{x:.1f} {y:.1f}h12" fill="none" {look}/>'
            if mark.marker:
                one = dataclasses.replace(mark, size=min(mark.size, 7))
                place = np.array([60.0]), np.array([0.0])
                inner = markers(*place, one, colour)
                text += (
                    f'<g transform="translate({x:.1f} {y:.1f})scale(.1)" fill="none">'
                    f"{inner}</g>"
                )
            return text
        if isinstance(mark, StraightLine):
            look = stroke(mark.colour, mark.width, mark.line, unit=1)
            return f'<path d="M{x:.1f} {y:.1f}h12" fill="none" {look}/>'
        if isinstance(mark, Band | Span | Bars):
            opacity = 0.9 if isinstance(mark, Bars) else max(mark.opacity, 0.25)
            box = f'x="{x:.1f}" y="{y - 3:.1f}" width="12" height="6"'
            return f"<rect {box} {fill(mark.colour, opacity)}/>"
        return ""


def _placed(axis: Axis) -> list[tuple[Number, str]]:
    """Shares of the way and texts of the ticks."""
    places = axis.share(np.array([v for v, _ in axis.ticks], float))
    return list(zip(places.tolist(), (t for _, t in axis.ticks), strict=True))


def _write(
    x: Number,
    y: Number,
    text: str,
    anchor: str,
    colour: str = "currentColor",
    more: str = "",
) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" '
        f'style="fill:{colour}"{more}>{escape(text)}</text>'
    )
