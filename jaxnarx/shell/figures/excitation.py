"""What the inputs of a data set excite: over time, over frequency, over their space."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, NullLocator

from jaxnarx.data import Channel, Dataset
from jaxnarx.shell.figures.envelope import envelope
from jaxnarx.shell.figures.style import (
    BLUE,
    GREY,
    INK_COLOUR,
    RED,
    plain_text,
    use_style,
)

ROW_INCHES, MAP_INCHES = 0.85, 1.45
"""Height in inches of a trace, and of a map of two inputs."""

SCATTER_POINTS = 600
MAX_RECORD_BORDERS = 40
"""More records than this are not told apart by lines."""

BANDWIDTH_POWER_SHARE = 0.95
"""Of the power, below the bandwidth that is marked."""

SPECTRUM_DECADES = 8
"""Power below this many decades under the largest is not drawn."""

_VISIT_COLOURS = LinearSegmentedColormap.from_list("visits", ["#e3eef6", BLUE])


def excitation(
    data: Dataset,
    *,
    ranges: Mapping[str, tuple[float | int, float | int]] | None = None,
    outputs: bool = False,
    bins: int = 10,
) -> Figure:
    """Inputs over time, their power spectra, and the cells of their space they visit.

    Records stand one after the other, with gaps where a sample is not valid; long ones
    are drawn by their envelope. Spectra are marked with the frequency below which 95 %
    of the power lies. Each map shows a pair of inputs: the share of its `bins` by
    `bins` cells that are visited, and how often. `ranges` by input name, in its unit,
    is the operating space, else that of the data; with `outputs` these are drawn over
    time too. A single input has a histogram instead of maps.
    """
    from jaxnarx.excitation import assess

    found = assess(data, ranges=ranges, bins=bins)
    inputs = data.channels.inputs
    shown = data.channels.all if outputs else inputs
    maps = max(len(inputs) - 1, 1)
    heights = (0.35 + ROW_INCHES * len(shown), 0.75 + max(MAP_INCHES * maps, 1.9))
    with use_style():
        size = (max(9.0, 1.6 * maps), sum(heights))
        figure = Figure(figsize=size, layout="constrained")
        parts = figure.subfigures(2, 1, height_ratios=heights, squeeze=False)
        _traces(parts[0, 0], data, shown)
        if len(inputs) == 1:
            _histogram(parts[1, 0], data, found)
        else:
            _maps(parts[1, 0], data, found)
    return figure


def _traces(part: SubFigure, data: Dataset, shown: Sequence[Channel]) -> None:
    """A row for each channel: over time, and its spectrum beside it."""
    from jaxnarx.excitation import bandwidth, spectrum

    rows = part.subplots(
        len(shown), 2, squeeze=False, sharex="col", width_ratios=(3, 1.15)
    )
    time, values, borders = _join_records(data)
    held = [np.concatenate([r.u, r.y], axis=1)[:, : len(shown)] for r in data]
    power = spectrum(held, data.sample_time)
    widths = bandwidth(power, BANDWIDTH_POWER_SHARE)
    for i, (channel, (left, right)) in enumerate(zip(shown, rows, strict=True)):
        color = BLUE if i < len(data.channels.inputs) else INK_COLOUR
        left.plot(*envelope(time, values[:, i]), color=color, lw=0.9)
        left.set_title(plain_text(channel.label, 60), pad=2.5, fontsize=8.5)
        left.yaxis.set_major_locator(MaxNLocator(3))
        for border in borders:
            left.axvline(border, color=GREY, lw=0.6, ls=(0, (2, 2)))
        _density(right, power.frequency[1:], power.power[1:, i], color)
        _mark(right, power.frequency[1:], float(widths[i]))
        title = f"power density [{_power_unit(channel.unit)}]"
        right.set_title(title, pad=2.5, fontsize=8.5)
    rows[0, 0].set_xlim(time[0], max(time[-1], data.sample_time))
    rows[-1, 0].set_xlabel("time [s]")
    _frequencies(rows[-1, 1], power.frequency[1:])


def _density(axes: Axes, frequency: np.ndarray, power: np.ndarray, color: str) -> None:
    peak = power.max(initial=0.0)
    if peak <= 0:
        axes.set_yticks([])
        axes.text(0.5, 0.45, "constant", transform=axes.transAxes, ha="center")
        return
    axes.plot(*_average_octaves(frequency, power), color=color, lw=0.9)
    axes.set_yscale("log")
    floor = max(power[power > 0].min(), peak * 10.0**-SPECTRUM_DECADES)
    # A quarter of the height above the peak is left for the text.
    axes.set_ylim(floor / 2, 2 * peak * (peak / floor) ** 0.33)
    axes.yaxis.set_major_locator(LogLocator(numticks=3))
    axes.yaxis.set_minor_locator(NullLocator())


def _mark(axes: Axes, frequency: np.ndarray, width: float) -> None:
    """The bandwidth, its text on the side where a falling spectrum leaves room."""
    if width <= 0:
        return
    axes.axvline(width, color=RED, lw=0.9, ls=(0, (3, 1.5)))
    left = width < np.sqrt(frequency[0] * frequency[-1])
    place: dict[str, Any] = {
        "xy": (width, 0.95 if left else 0.05),
        "xycoords": axes.get_xaxis_transform(),
        "xytext": (3 if left else -3, 0),
        "textcoords": "offset points",
        "ha": "left" if left else "right",
        "va": "top" if left else "bottom",
    }
    axes.annotate(
        f"{BANDWIDTH_POWER_SHARE:.0%} below {width:.3g} Hz",
        fontsize=7.5,
        color=RED,
        **place,
    )


def _frequencies(axes: Axes, frequency: np.ndarray) -> None:
    axes.set_xlabel("frequency [Hz]")
    if len(frequency) < 2:
        return
    axes.set_xscale("log")
    axes.set_xlim(frequency[0], frequency[-1])
    if frequency[-1] < 100 * frequency[0]:
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())


def _maps(part: SubFigure, data: Dataset, found) -> None:
    """Lower triangle of pairs; what holds for the whole space stands above."""
    from jaxnarx.excitation import visited_rows

    n = len(found.low)
    grid = part.subplots(n - 1, n - 1, squeeze=False)
    points = _thin(visited_rows(data))
    names = [_channel_label(c) for c in data.channels.inputs]
    counts = _counts(data, found)
    visited_rows = np.concatenate([c[c > 0] for c in counts.values()])
    most = int(visited_rows.max(initial=1))
    norm = LogNorm(min(int(visited_rows.min(initial=1)), most / 2), most)
    edges = np.linspace(found.low, found.high, found.coverage.bins + 1)
    for (row, j), axes in np.ndenumerate(grid):
        i = row + 1
        if j >= i:
            axes.set_visible(False)
            continue
        cell = np.ma.masked_equal(counts[i, j], 0)
        shades = {"cmap": _VISIT_COLOURS, "norm": norm, "rasterized": True}
        axes.pcolormesh(edges[:, j], edges[:, i], cell, **shades)
        dots = {"ls": "", "marker": ".", "ms": 2.2, "mew": 0, "rasterized": True}
        axes.plot(points[:, j], points[:, i], color=INK_COLOUR, alpha=0.6, **dots)
        axes.set(xlim=edges[[0, -1], j], ylim=edges[[0, -1], i])
        axes.set_title(f"{found.coverage.pairs[i, j]:.0%}", pad=2.5, fontsize=8.5)
        axes.grid(visible=False)
        axes.tick_params(labelleft=j == 0, labelbottom=i == n - 1, labelsize=7.5)
        axes.xaxis.set_major_locator(MaxNLocator(3))
        axes.yaxis.set_major_locator(MaxNLocator(3))
        axes.set_ylabel(names[i] if j == 0 else "", fontsize=8)
        axes.set_xlabel(names[j] if i == n - 1 else "", fontsize=8)
    part.suptitle(
        f"Share of {found.coverage.bins} × {found.coverage.bins} cells visited. "
        + _coverage_text(found),
        x=0.01,
        ha="left",
        fontsize=9,
    )
    bar = ScalarMappable(norm, _VISIT_COLOURS)
    drawn = part.colorbar(bar, ax=grid, shrink=0.7, aspect=30, pad=0.01)
    drawn.set_label("samples per cell", fontsize=8)
    drawn.ax.tick_params(labelsize=7.5)


def _histogram(part: SubFigure, data: Dataset, found) -> None:
    from jaxnarx.excitation import visited_rows

    axes = part.subplots()
    edges = np.linspace(found.low[0], found.high[0], found.coverage.bins + 1)
    counts = np.histogram(visited_rows(data)[:, 0], edges)[0]
    axes.stairs(counts, edges, fill=True, color=BLUE, alpha=0.75)
    share = f"{found.coverage.pairs[0, 0]:.0%} of {found.coverage.bins} parts"
    label = plain_text(data.channels.inputs[0].label)
    axes.set(title=f"visits {share} of the range", xlabel=label, ylabel="samples")


def _coverage_text(found) -> str:
    cover = found.coverage
    power = "".join("⁰¹²³⁴⁵⁶⁷⁸⁹"[int(digit)] for digit in str(len(found.low)))
    return f"Whole space: {cover.whole:.0%} of {cover.whole_bins}{power} cells"


def _counts(data: Dataset, found) -> dict[tuple[int, int], np.ndarray]:
    """Samples per cell of each pair, row of the first input, column of the second."""
    from jaxnarx.excitation import cells, visited_rows

    points, bins = visited_rows(data), found.coverage.bins
    points = points[np.all((points >= found.low) & (points <= found.high), axis=1)]
    cell = cells(points, found.low, found.high, bins)
    return {
        (i, j): np.bincount(cell[:, i] * bins + cell[:, j], minlength=bins**2).reshape(
            bins, bins
        )
        for i in range(len(found.low))
        for j in range(i)
    }


def _thin(
    points: Float[np.ndarray, "samples inputs"],
) -> Float[np.ndarray, "dots inputs"]:
    return points[
        np.unique(np.linspace(0, len(points) - 1, SCATTER_POINTS).astype(int))
    ]


def _join_records(data: Dataset) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """Time [s], signals with NaN for gaps, and where records meet."""
    gap = np.full((1, len(data.channels.names)), np.nan)
    pieces = []
    for record in data:
        signals = np.concatenate([record.u, record.y], axis=1).astype(float)
        pieces += [np.where(record.valid, signals, np.nan), gap]
    values = np.concatenate(pieces[:-1])
    starts = np.cumsum([len(r) + 1 for r in data])[:-1] * data.sample_time
    borders = starts.tolist() if len(data) <= MAX_RECORD_BORDERS else []
    return np.arange(len(values)) * data.sample_time, values, borders


def _average_octaves(
    frequency: Float[np.ndarray, " frequencies"],
    power: Float[np.ndarray, " frequencies"],
    parts: int = 24,
) -> tuple[np.ndarray, np.ndarray]:
    """Means over `parts` bins per octave: a long spectrum without its grass."""
    place = np.floor(parts * np.log2(frequency / frequency[0])).astype(int)
    _, place = np.unique(place, return_inverse=True)
    count = np.bincount(place)
    mean = [np.bincount(place, x) / count for x in (frequency, power)]
    return mean[0], mean[1]


def _power_unit(unit: str) -> str:
    return f"({plain_text(unit, 20)})²/Hz" if unit else "1/Hz"


def _channel_label(channel: Channel) -> str:
    name = plain_text(channel.name, 22)
    return f"{name}\n[{plain_text(channel.unit, 22)}]" if channel.unit else name
