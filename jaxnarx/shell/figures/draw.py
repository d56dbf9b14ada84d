"""Pictures as matplotlib figures, for `jnx.plot` and for files."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from jaxnarx.evaluation import (
    Band,
    Bars,
    Cells,
    Chart,
    Curve,
    Mark,
    Picture,
    Range,
    RegionMap,
    Span,
    StraightLine,
    Text,
    floats,
)
from jaxnarx.shell.figures.palette import DARKENING, DIVERGING, colour_code, tone
from jaxnarx.shell.figures.style import Powers, canvas, plain_text, use_style

DASHES: dict[str, Any] = {
    "solid": "-",
    "dashed": (0, (3, 1.5)),
    "dotted": ":",
    "": "",
}
SMALL_TITLE, SMALL_LABEL = 7.5, 7.0
"""Points of letters in small panels."""
LETTERS_PER_INCH = 15
"""Letters of a legend that have room beside one another."""


def draw(picture: Picture) -> Figure:
    """The picture as a figure with an axes for every chart, row by row."""
    grid: dict[str, Any] = {
        "sharex": "x" in picture.shared,
        "sharey": "y" in picture.shared,
        "height_ratios": picture.heights or None,
        "width_ratios": picture.widths or None,
    }
    with use_style():
        figure, axes = canvas(
            *(picture.width, picture.height),
            rows=picture.rows,
            columns=picture.columns,
            **grid,
        )
        pairs = zip(picture.charts, picture.ranges(), strict=True)
        for n, (ax, (chart, ends)) in enumerate(zip(axes, pairs, strict=False)):
            _chart(figure, ax, chart, ends, picture, n)
        for ax in axes[len(picture.charts) :]:
            ax.set_axis_off()
        # Where the last row is not full, the panels above it have the numbers.
        for ax in axes[max(len(picture.charts) - picture.columns, 0) :]:
            ax.tick_params(labelbottom=True)
        figure.align_ylabels(axes)
    return figure


def _chart(
    figure: Figure,
    axes: Axes,
    chart: Chart,
    ends: tuple[Range, Range],
    picture: Picture,
    place: int,
) -> None:
    """Draw the chart that stands at that place of the picture."""
    for mark in chart.marks:
        _mark(figure, axes, chart, mark)
    axes.set(xlim=ends[0], ylim=ends[1])
    for letter, axis in (("x", axes.xaxis), ("y", axes.yaxis)):
        ticks = getattr(chart, f"{letter}_ticks")
        if letter in chart.log:
            low, high = ends["xy".index(letter)]
            axes.set(**{f"{letter}scale": "log", f"{letter}lim": (low, high)})
            few = high < 1000 * low
            axis.set_major_locator(LogLocator(subs=(1, 2, 5) if few else (1,)))
            axis.set_major_formatter("{x:,g}" if few else Powers())
            axis.set_minor_formatter(NullFormatter())
        if letter in chart.whole:
            axis.set_major_locator(MaxNLocator(integer=True))
        if ticks is not None:
            axis.set_ticks([v for v, _ in ticks], [plain_text(t) for _, t in ticks])
    # Of panels that share an axis, only those at the edge are named.
    if "x" not in picture.shared or place + picture.columns >= len(picture.charts):
        axes.set_xlabel(plain_text(chart.x_label, 60))
    if "y" not in picture.shared or place % picture.columns == 0:
        axes.set_ylabel(plain_text(chart.y_label, 60))
    names = len(chart.legend_marks)
    style: dict[str, Any] = {"pad": 6}
    if chart.legend == "above" and names:
        longest = max(len(getattr(m, "name", "")) for m in chart.legend_marks) + 7
        broad = LETTERS_PER_INCH * picture.width / picture.columns
        columns = max(1, min(names, int(broad // longest)))
        place_of = {"loc": "lower left", "bbox_to_anchor": (0, 1)}
        axes.legend(**place_of, ncols=columns, borderaxespad=0.1)
        style["pad"] = 6 + 13 * -(-names // columns)
    elif chart.legend == "right" and names:
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), borderaxespad=0)
    if picture.small:
        axes.tick_params(labelsize=SMALL_LABEL)
        style["fontsize"] = SMALL_TITLE
        for label in (axes.xaxis.label, axes.yaxis.label):
            label.set_fontsize(SMALL_TITLE)
    axes.set_title(plain_text(chart.title, 90), **style)
    if chart.bare:
        axes.set_axis_off()
    if any(isinstance(m, Cells | RegionMap) for m in chart.marks):
        axes.grid(visible=False)


def _mark(figure: Figure, axes: Axes, chart: Chart, mark: Mark) -> None:
    name = plain_text(getattr(mark, "name", ""), 60) or None
    match mark:
        case Curve():
            _curve(axes, mark, colour_code(chart.colour_of(mark)), name)
        case Band():
            x, low, high = mark.points
            look = {"color": colour_code(mark.colour), "alpha": mark.opacity, "lw": 0}
            axes.fill_between(x, low, high, label=name, **look)
        case Span():
            span = axes.axvspan if mark.axis == "x" else axes.axhspan
            look = {"color": colour_code(mark.colour), "alpha": mark.opacity, "lw": 0}
            span(mark.start, mark.end, label=name, **look)
        case StraightLine():
            rule = axes.axvline if mark.axis == "x" else axes.axhline
            look = {"ls": DASHES[mark.line], "lw": mark.width}
            rule(mark.at, color=colour_code(mark.colour), label=name, **look)
        case Bars():
            look = {"color": colour_code(mark.colour), "height": mark.height}
            axes.barh(floats(mark.at), floats(mark.length), label=name, **look)
        case Cells():
            _cells(figure, axes, mark)
        case RegionMap():
            _regions(axes, mark)
        case Text():
            _text(axes, mark)


def _curve(axes: Axes, mark: Curve, colour: str, name: str | None) -> None:
    look: dict[str, Any] = {"color": colour, "alpha": mark.opacity, "label": name}
    look |= {"lw": mark.width, "ls": DASHES[mark.line], "ms": mark.size}
    look["marker"] = mark.marker or None
    if mark.hollow:
        look |= {"mfc": "none", "mec": colour, "mew": 1.3}
    elif mark.marker not in ("x", "|"):
        look["mew"] = 0
    x, y = mark.points
    axes.plot(x, y, rasterized=mark.marker == "." and len(x) > 300, **look)


def _cells(figure: Figure, axes: Axes, mark: Cells) -> None:
    colours = DIVERGING if mark.signed else DARKENING
    low, high = mark.ends
    scale = LinearSegmentedColormap.from_list("values", colours)
    dark = axes.pcolormesh(
        *(mark.x_edges, mark.y_edges, mark.value.T),
        **{"cmap": scale, "vmin": low, "vmax": high, "lw": 0},
    )
    figure.colorbar(dark, ax=axes)
    if mark.crossed is not None:
        x, y = mark.x_edges, mark.y_edges
        for i, j in np.argwhere(mark.crossed & np.isfinite(mark.value)).tolist():
            ends = x[i : i + 2], y[j : j + 2]
            axes.plot(*ends, color=colour_code("ink"), lw=0.5)


def _regions(axes: Axes, mark: RegionMap) -> None:
    colour = np.array([to_rgb(tone(m)) for m in range(int(mark.lead.max()) + 1)])
    alpha = 0.45 * mark.strength[..., None]
    image = np.concatenate([colour[mark.lead], alpha], axis=-1)
    # Pixels lie around the points of the grid, also around those on the edge.
    box = np.array([mark.x_range, mark.y_range])
    half = 0.5 * np.diff(box, axis=1)[:, 0] / (np.array(mark.lead.shape) - 1)
    left, right, low, high = (box + np.outer(half, [-1, 1])).ravel().tolist()
    axes.imshow(
        np.swapaxes(image, 0, 1),
        extent=(left, right, low, high),
        origin="lower",
        aspect="auto",
        zorder=0.5,
    )


def _text(axes: Axes, mark: Text) -> None:
    look: dict[str, Any] = {"color": colour_code(mark.colour), "fontsize": mark.size}
    look |= {"ha": {"centre": "center"}.get(mark.across, mark.across)}
    look |= {"va": {"middle": "center_baseline"}.get(mark.up, mark.up)}
    look |= {"fontweight": "bold" if mark.bold else "normal"}
    look |= {"textcoords": "offset points", "xytext": mark.nudge}
    axes.annotate(plain_text(mark.text, 80), (mark.x, mark.y), **look)
