"""Figures as plain data: marks on axes, in panels; who draws them is another matter.

A page draws a `Picture` as SVG text and `jnx.plot` with matplotlib, both with the same
ranges. A colour is a name (`"ink"`, `"grey"`, `"blue"`, `"orange"`, `"green"`, `"red"`,
`"purple"`, `"sky"`) or a number: that of a local model or of a series, from 0.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

Colour = str | int
Number = float | int
Ticks = tuple[tuple[float, str], ...]
"""Places on an axis and what is written there."""
Range = tuple[Number, Number]
Values = np.ndarray | Sequence[Number | None] | Number

ROOM = 0.04
"""Empty share of an axis at either end, beyond what is drawn."""
NOTHING = np.zeros(0)


def step_points(
    x: Float[np.ndarray, " _"], y: Float[np.ndarray, " _"], steps: str
) -> tuple[Float[np.ndarray, " points"], Float[np.ndarray, " points"]]:
    """The corners of a line: as it is (`""`), level about each x (`"middle"`), or level
    from each x to the next (`"after"`; one y fewer is welcome)."""
    if not steps or len(y) == 0:
        return x, y
    if steps == "middle":
        x = np.concatenate([x[:1], 0.5 * (x[1:] + x[:-1]), x[-1:]])
    elif len(x) == len(y):
        x = np.append(x, x[-1])
    return np.repeat(x, 2)[1:-1], np.repeat(y, 2)


def uprights(
    x: Values, low: Values, high: Values
) -> tuple[Float[np.ndarray, " points"], Float[np.ndarray, " points"]]:
    """Points of a line that runs from low to high at every x, with gaps between."""
    x, low, high = np.broadcast_arrays(*map(floats, (x, low, high)))
    gap = np.full(x.shape, np.nan)
    return np.stack([x, x, gap], 1).ravel(), np.stack([low, high, gap], 1).ravel()


def ellipse(
    centre: tuple[Number, Number], half: tuple[Number, Number]
) -> tuple[Float[np.ndarray, " points"], Float[np.ndarray, " points"]]:
    """Points of an ellipse with these half axes."""
    angle = np.linspace(0, 2 * np.pi, 73)
    return centre[0] + half[0] * np.cos(angle), centre[1] + half[1] * np.sin(angle)


def floats(values: Values) -> Float[np.ndarray, " points"]:
    """One axis of numbers; NaN where one is None."""
    found: Any = values
    return np.atleast_1d(np.array(found, float))


@dataclasses.dataclass(frozen=True, eq=False)
class Curve:
    """A line through points, marks on them, or both; what is not finite is a gap.

    `line` is `"solid"`, `"dashed"`, `"dotted"` or `""`, `marker` a letter as matplotlib
    has them (`o s D ^ v P * X x | .`), `steps` that of `step_points`. Without a colour
    it takes that of its place in the chart. A curve with a name is in the legend.
    """

    name: str
    x: Values
    y: Values
    colour: Colour | None = None
    line: str = "solid"
    width: Number = 1.1
    marker: str = ""
    size: Number = 4.0
    hollow: bool = False
    opacity: Number = 1.0
    steps: str = ""

    @property
    def points(
        self,
    ) -> tuple[Float[np.ndarray, " points"], Float[np.ndarray, " points"]]:
        """What is drawn, in order."""
        return step_points(floats(self.x), floats(self.y), self.steps)

    def extent(self, axis: str) -> Float[np.ndarray, " _"]:
        """Values that the axis `"x"` or `"y"` should reach."""
        return self.points[axis == "y"]


@dataclasses.dataclass(frozen=True, eq=False)
class Band:
    """The area between two lines over x."""

    x: Values
    low: Values
    high: Values
    colour: Colour = "blue"
    opacity: Number = 0.18
    name: str = ""
    steps: str = ""

    @property
    def points(self) -> tuple[Float[np.ndarray, " points"], ...]:
        """x, low and high of the corners."""
        x, high = floats(self.x), floats(self.high)
        low = np.broadcast_to(floats(self.low), high.shape)
        corners, top = step_points(x, high, self.steps)
        return corners, step_points(x, low, self.steps)[1], top

    def extent(self, axis: str) -> Float[np.ndarray, " _"]:
        """Values that the axis should reach."""
        x, low, high = self.points
        return x if axis == "x" else np.concatenate([low, high])


@dataclasses.dataclass(frozen=True, eq=False)
class Span:
    """A stretch of one axis, shaded across the panel."""

    start: Number
    end: Number
    axis: str = "x"
    colour: Colour = "blue"
    opacity: Number = 0.12
    name: str = ""

    def extent(self, axis: str) -> Float[np.ndarray, " _"]:
        """Values that the axis should reach: its ends, where they are on it."""
        return floats((self.start, self.end)) if axis == self.axis == "y" else NOTHING


@dataclasses.dataclass(frozen=True, eq=False)
class StraightLine:
    """A straight line across the panel at one value of an axis."""

    at: Number
    axis: str = "x"
    colour: Colour = "ink"
    line: str = "solid"
    width: Number = 0.7
    name: str = ""

    def extent(self, axis: str) -> Float[np.ndarray, " _"]:
        """Values that the axis should reach."""
        return floats(self.at) if axis == self.axis else NOTHING


@dataclasses.dataclass(frozen=True, eq=False)
class Bars:
    """Bars that lie from the left edge to `length`, about their place on the y axis."""

    at: Values
    length: Values
    colour: Colour = "blue"
    height: Number = 0.62
    name: str = ""

    def extent(self, axis: str) -> Float[np.ndarray, " _"]:
        """Values that the axis should reach."""
        if axis == "x":
            return floats(self.length)
        at, half = floats(self.at), 0.5 * self.height
        return np.concatenate([at - half, at + half])


@dataclasses.dataclass(frozen=True, eq=False)
class Text:
    """A text at a place; `nudge` moves it right and up, in points.

    `across` tells which of its ends is there (`"left"`, `"centre"`, `"right"`), `up`
    likewise (`"bottom"`, `"middle"`, `"top"`).
    """

    x: Number
    y: Number
    text: str
    colour: Colour = "ink"
    across: str = "centre"
    up: str = "middle"
    bold: bool = False
    size: Number = 9.0
    nudge: tuple[Number, Number] = (0, 0)

    def extent(self, axis: str) -> Float[np.ndarray, " _"]:
        """Values that the axis should reach: none, a text stands beside others."""
        del axis
        return NOTHING


@dataclasses.dataclass(frozen=True, eq=False)
class Cells:
    """Cells coloured by their value, with a scale beside the panel.

    NaN is an empty cell; those that `crossed` marks carry a line. `signed` values are
    blue below zero and red above it, others the darker the larger.
    """

    x_edges: Float[np.ndarray, " _"]
    y_edges: Float[np.ndarray, " _"]
    value: Float[np.ndarray, "columns rows"]
    signed: bool = False
    crossed: Bool[np.ndarray, "columns rows"] | None = None

    @property
    def ends(self) -> Range:
        """Values at both ends of the scale."""
        known = self.value[np.isfinite(self.value)]
        low, high = (known.min(), known.max()) if len(known) else (0.0, 1.0)
        if self.signed:
            high = max(abs(low), abs(high)) or 1.0
            low = -high
        return (float(low), float(high)) if high > low else (low - 0.5, low + 0.5)

    def extent(self, axis: str) -> Float[np.ndarray, " _"]:
        """Values that the axis should reach."""
        return self.x_edges if axis == "x" else self.y_edges


@dataclasses.dataclass(frozen=True, eq=False)
class RegionMap:
    """A map of who leads: the colour of model `lead`, paler where it leads by little.

    Both arrays are over points of an even grid that reaches from edge to edge of the
    ranges; `strength` is from 0 to 1.
    """

    x_range: Range
    y_range: Range
    lead: np.ndarray
    strength: Float[np.ndarray, "columns rows"]

    def extent(self, axis: str) -> Float[np.ndarray, " _"]:
        """Values that the axis should reach."""
        return floats(self.x_range if axis == "x" else self.y_range)


Mark = Curve | Band | Span | StraightLine | Bars | Text | Cells | RegionMap


@dataclasses.dataclass(frozen=True, eq=False)
class Chart:
    """Marks over one pair of axes, the later ones on top.

    `log` names the axes that are logarithmic, such as `"y"` or `"xy"`; `whole` those
    with ticks at whole numbers only. Ranges and ticks are found where none are given.
    The legend stands `"above"` the panel, at its `"right"`, or nowhere (`""`); one
    name alone needs none. A `bare` chart has no axes.
    """

    marks: tuple[Mark, ...]
    x_label: str = ""
    y_label: str = ""
    title: str = ""
    log: str = ""
    x_range: Range | None = None
    y_range: Range | None = None
    x_ticks: Ticks | None = None
    y_ticks: Ticks | None = None
    whole: str = ""
    legend: str = "above"
    bare: bool = False

    def values(self, axis: str) -> Float[np.ndarray, " _"]:
        """Finite values that an axis should reach; positive ones of a logarithm."""
        found = np.concatenate([NOTHING, *(m.extent(axis) for m in self.marks)])
        found = found[np.isfinite(found)]
        return found[found > 0] if axis in self.log else found

    @property
    def legend_marks(self) -> tuple[Mark, ...]:
        """Marks with a name, the curves of one mark alone left out."""
        named = tuple(m for m in self.marks if getattr(m, "name", ""))
        return named if self.legend and len(named) > 1 else ()

    def colour_of(self, mark: Curve) -> Colour:
        """The mark's colour, or else that of its place among the curves."""
        if mark.colour is not None:
            return mark.colour
        curves = [m for m in self.marks if isinstance(m, Curve)]
        return next(n for n, one in enumerate(curves) if one is mark)


@dataclasses.dataclass(frozen=True, eq=False)
class Picture:
    """Charts row by row, `columns` beside one another; sizes in inches.

    `heights` and `widths` are shares of rows and of columns, all alike by default.
    Charts have the axes that `shared` names in common: the same range, and numbers only
    at the left and at the bottom. `small` panels have smaller letters.
    """

    charts: tuple[Chart, ...]
    columns: int = 1
    width: Number = 9.0
    height: Number = 2.8
    heights: tuple[Number, ...] = ()
    widths: tuple[Number, ...] = ()
    shared: str = ""
    small: bool = False

    @property
    def rows(self) -> int:
        """Rows of panels, the last of them perhaps not full."""
        return -(-len(self.charts) // self.columns)

    def ranges(self) -> list[tuple[Range, Range]]:
        """The range of both axes of every chart."""
        found = []
        for axis in "xy":
            alone = [getattr(one, f"{axis}_range") for one in self.charts]
            reached = [one.values(axis) for one in self.charts]
            if axis in self.shared:
                reached = [np.concatenate(reached)] * len(reached)
                alone = [next((r for r in alone if r is not None), None)] * len(alone)
            found.append(
                [
                    own if own is not None else _widen(values, axis in chart.log)
                    for own, values, chart in zip(
                        alone, reached, self.charts, strict=True
                    )
                ]
            )
        return list(zip(*found, strict=True))


def _widen(values: Float[np.ndarray, " _"], log: bool) -> Range:
    """From the least to the largest with some room; about a value that stands alone."""
    if not len(values):
        return (0.1, 1.0) if log else (0.0, 1.0)
    low, high = float(values.min()), float(values.max())
    if log:
        room = (high / low) ** ROOM if high > low else 2.0
        return low / room, high * room
    room = ROOM * (high - low) or 0.5 * abs(high) or 0.5
    return low - room, high + room
