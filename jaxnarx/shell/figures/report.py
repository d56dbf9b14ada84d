"""The figures of a report: plain data in, a matplotlib figure out.

Axes carry units. Long records are reduced to their envelope, so that a figure stays
small and no peak is lost.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from jaxnarx.shell.figures.style import (
    BLUE,
    COLOUR_CYCLE,
    INK_COLOUR,
    ORANGE,
    RED,
    Powers,
    canvas,
    plain_text,
    use_style,
)

Numbers = Sequence[float | int | None] | np.ndarray
"""A list or array of numbers; None where one is not known."""

LINE_POINTS = 1500
PANELS_PER_ROW = 4
"""Panels beside one another where every record is shown."""


def envelope(
    time: Float[np.ndarray, " time"],
    value: Float[np.ndarray, " time"],
    points: int = LINE_POINTS,
) -> tuple[Float[np.ndarray, " points"], Float[np.ndarray, " points"]]:
    """At most `points` samples that draw the same line: least and largest of each bin.

    Both keep their own time and order. A short record comes back as it is; missing
    values (NaN) stay gaps where a whole bin is missing.
    """
    bins = max(points // 2, 1)
    if len(value) <= 2 * bins:
        return time, value
    borders = np.linspace(0, len(value), bins + 1).astype(int)
    low = np.where(np.isnan(value), np.inf, value)
    high = np.where(np.isnan(value), -np.inf, value)
    kept = np.array(
        [
            sorted((a + int(np.argmin(low[a:b])), a + int(np.argmax(high[a:b]))))
            for a, b in zip(borders[:-1], borders[1:], strict=True)
        ]
    ).ravel()
    return time[kept], value[kept]


def draw_free_run(
    time: Float[np.ndarray, " time"],
    measured: Float[np.ndarray, " time"],
    simulated: Float[np.ndarray, " time"],
    *,
    label: str,
    title: str = "",
    one_step: Float[np.ndarray, " time"] | None = None,
    limited: Bool[np.ndarray, " time"] | None = None,
    scored: Bool[np.ndarray, " time"] | None = None,
    lower: Float[np.ndarray, " time"] | None = None,
    upper: Float[np.ndarray, " time"] | None = None,
    points: int = LINE_POINTS,
) -> Figure:
    """Measurement, free run and one-step prediction over time [s], residual below.

    Between `lower` and `upper` lies the interval of the free run, shaded; about the
    residual too.

    The one-step prediction, nearly always right, lies broad and pale behind the
    measurement. Samples that do not count (`scored` False) are left out of the
    measurement and of the residual; where the feedback bound acted is shaded.
    """
    gap = measured if scored is None else np.where(scored, measured, np.nan)
    with use_style():
        figure, (top, low) = canvas(9.0, 3.4, rows=2, sharex=True, height_ratios=(3, 1))
        if lower is not None and upper is not None:
            _interval(top, time, lower, upper, points, label="90 % interval")
            about = (lower - simulated, upper - simulated)
            _interval(low, time, *about, points)
        if one_step is not None:
            style = {"color": ORANGE, "lw": 4.0, "alpha": 0.45}
            top.plot(*envelope(time, one_step, points), label="one step", **style)
        top.plot(
            *envelope(time, gap, points), color=INK_COLOUR, lw=1.4, label="measured"
        )
        top.plot(*envelope(time, simulated, points), color=BLUE, label="free run")
        _limits(top, gap)
        residual = gap - simulated
        low.plot(*envelope(time, residual, points), color=BLUE, lw=0.8)
        low.axhline(0, color=INK_COLOUR, lw=0.6)
        _limits(low, residual, around=gap)
        for axes in (top, low):
            _shade(axes, time, limited)
        top.set_ylabel(plain_text(label))
        top.set_title(plain_text(title, 90), pad=20)
        low.set(xlabel="time [s]", ylabel="residual")
        low.set_xlim(time[0], time[-1] if len(time) > 1 else time[0] + 1)
        figure.align_ylabels([top, low])
        top.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=5, borderaxespad=0.1)
    return figure


def _interval(
    axes: Axes,
    time: Float[np.ndarray, " time"],
    lower: Float[np.ndarray, " time"],
    upper: Float[np.ndarray, " time"],
    points: int,
    **style: Any,
) -> None:
    """Shade it; of a long record the least and the largest of each bin."""
    bins = max(points // 2, 1)
    step = max(1, -(-len(time) // bins))
    at = np.arange(0, len(time), step)
    low, high = np.minimum.reduceat(lower, at), np.maximum.reduceat(upper, at)
    axes.fill_between(time[at], low, high, color=BLUE, alpha=0.18, lw=0, **style)


def draw_record_panels(traces: Sequence[Any], *, points: int = 240) -> Figure:
    """Measurement and free run of many records of one output, a small panel each.

    Each trace has `time`, `measured`, `simulated`, `scored`, `record` and `rmse`. All
    panels share the axis of the output.
    """
    columns = min(len(traces), PANELS_PER_ROW)
    rows = -(-len(traces) // columns)
    with use_style():
        share = {"sharey": True}
        figure, axes = canvas(
            9.0, 1.25 * rows + 0.3, rows=rows, columns=columns, **share
        )
        shown = [np.where(t.scored, t.measured, np.nan) for t in traces]
        for ax, trace, measured in zip(axes, traces, shown, strict=False):
            ax.plot(*envelope(trace.time, measured, points), color=INK_COLOUR, lw=1.0)
            line = envelope(trace.time, trace.simulated, points)
            ax.plot(*line, color=BLUE, lw=0.8)
            error = "diverged" if trace.rmse is None else f"RMSE {trace.rmse:.3g}"
            ax.set_title(f"{plain_text(trace.record, 28)}: {error}", fontsize=7.5)
            ax.tick_params(labelsize=7)
        _limits(axes[0], np.concatenate(shown))
        for ax in axes[len(traces) :]:
            ax.set_axis_off()
        for ax in axes[::columns]:
            ax.set_ylabel(plain_text(traces[0].output.label, 20), fontsize=7.5)
        for ax in axes[max(len(traces) - columns, 0) : len(traces)]:
            ax.set_xlabel("time [s]", fontsize=7.5)
    return figure


def error_map(value: Any) -> Figure:
    """Free-run error, bias, spread and number of samples in cells over two variables.

    `value` is an `ErrorMap`. The darker, the larger; of the bias blue where the run is
    too low and red where it is too high. White cells hold no sample, hatched ones too
    few to say much.
    """
    unit = f" [{plain_text(value.unit)}]" if value.unit else ""
    counts = np.where(value.samples > 0, value.samples, np.nan)
    most = float(np.nanmax(np.abs(value.bias), initial=0.0)) or 1.0
    panels: tuple[tuple[Any, str, dict[str, Any]], ...] = (
        (value.rms, "RMSE" + unit, {"cmap": "viridis_r"}),
        (value.bias, "bias" + unit, {"cmap": "RdBu", "vmin": -most, "vmax": most}),
        (value.spread, "spread" + unit, {"cmap": "viridis_r"}),
        (counts, "samples", {"cmap": "viridis_r"}),
    )
    with use_style():
        figure, axes = canvas(9.0, 5.6, rows=2, columns=2, sharex=True, sharey=True)
        for ax, (cells, title, look) in zip(axes, panels, strict=True):
            dark = ax.pcolormesh(*value.edges, cells.T, lw=0, **look)
            figure.colorbar(dark, ax=ax, label=title)
            _hatch(ax, value)
            ax.grid(visible=False)
        for ax in axes[2:]:
            ax.set_xlabel(plain_text(value.variables[0]))
        for ax in axes[::2]:
            ax.set_ylabel(plain_text(value.variables[1]))
    return figure


def _hatch(axes: Axes, value: Any) -> None:
    """Lines across the cells with few samples."""
    x, y = value.edges
    few = np.argwhere(value.thin & (value.samples > 0)).tolist()
    corners = [
        [(x[i], y[j]), (x[i + 1], y[j]), (x[i + 1], y[j + 1]), (x[i], y[j + 1])]
        for i, j in few
    ]
    style = {
        "facecolor": "none",
        "edgecolor": INK_COLOUR,
        "hatch": "////",
        "linewidth": 0,
    }
    axes.add_collection(PolyCollection(corners, **style))


def error_by_index(value: Any, edges: Sequence[float]) -> Figure:
    """Free-run error over the index of the domain; the line is its border.

    All bins are as wide; one with too few samples for an error says so. `value` is an
    `ErrorByIndex`, `edges` are the borders of its bins, the last without an end.
    """
    unit = f" [{plain_text(value.unit)}]" if value.unit else ""
    bins, border = len(value.rms), list(edges).index(1.0)
    ends = np.arange(bins + 1)
    few = np.isnan(value.rms) & (value.samples > 0)
    with use_style():
        figure, (left, right) = canvas(9.0, 2.8, columns=2)
        left.stairs(np.nan_to_num(value.rms), ends, fill=True, color=BLUE, alpha=0.75)
        for n in np.flatnonzero(few):
            left.annotate("few", (n + 0.5, 0), ha="center", va="bottom", fontsize=7)
        right.stairs(value.samples, ends, fill=True, color=BLUE, alpha=0.75)
        for ax, label in ((left, "RMSE" + unit), (right, "samples")):
            ax.axvline(border, color=INK_COLOUR, lw=0.8)
            ax.set(xlabel="index, one at the border", ylabel=label)
            ax.set_xticks(ends[:-1], [f"{edge:g}" for edge in edges[:-1]])
            ax.set_xlim(0, bins)
        right.set_yscale("symlog", linthresh=10)
    return figure


def agreement(
    measured: Float[np.ndarray, " pairs"],
    simulated: Float[np.ndarray, " pairs"],
    counts: Int[np.ndarray, " bins"],
    edges: Float[np.ndarray, " borders"],
    *,
    label: str,
    unit: str = "",
) -> Figure:
    """Simulated against measured, and the histogram of the free-run residual.

    The dashed curve is the normal density of the same mean square.
    """
    with use_style():
        figure, (left, right) = canvas(9.0, 3.2, columns=2, width_ratios=(1, 1.6))
        if len(measured):
            span = np.array([measured.min(), measured.max()])
            left.plot(span, span, color=INK_COLOUR, lw=0.8)
        dots = {"ls": "", "marker": ".", "ms": 2.2, "alpha": 0.45, "mew": 0}
        left.plot(measured, simulated, color=BLUE, rasterized=True, **dots)
        left.set(xlabel="measured " + plain_text(label), ylabel="free run")
        if len(counts):
            right.stairs(counts, edges, fill=True, color=BLUE, alpha=0.75)
            _draw_normal(right, counts, edges)
            right.axvline(0, color=INK_COLOUR, lw=0.8)
        right.set(
            xlabel="residual" + (f" [{plain_text(unit)}]" if unit else ""),
            ylabel="samples",
        )
    return figure


def cumulated_errors(value: Any) -> Figure:
    """Share of the samples over the size of their error, of an `ErrorDistribution`; a
    line marks 95 %, another the tolerance."""
    unit = f" [{plain_text(value.unit)}]" if value.unit else ""
    with use_style():
        figure, (axes,) = canvas(9.0, 2.6)
        axes.plot(value.size, 100 * value.share, color=BLUE)
        axes.plot([value.most] * 2, [0, 95], color=INK_COLOUR, lw=0.8, ls="--")
        if value.tolerance is not None and value.tolerance <= value.largest:
            axes.axvline(value.tolerance, color=ORANGE, lw=1.2)
        axes.set(xlabel="size of the error" + unit, ylabel="samples up to it [%]")
        axes.set_xlim(0, value.largest or 1.0)
        axes.set_ylim(0, 101)
    return figure


def selection_path(
    names: Sequence[str],
    err: Numbers,
    cumulative: Numbers | None = None,
    *,
    criteria: Mapping[str, Numbers] | None = None,
) -> Figure:
    """Error reduction ratio per chosen term, what is left unexplained, and criteria.

    `cumulative` is the running sum of `err`; 1 - cumulative is drawn on a log axis, its
    zeros left out. Criteria, each by number of terms, are drawn with their lowest
    point marked, on a common scale from their best (0) to their worst (1).
    """
    share = np.asarray(err, float)
    total = np.cumsum(share) if cumulative is None else np.asarray(cumulative, float)
    left_over = np.where(total < 1, 1 - total, np.nan)
    at = np.arange(len(share))
    with use_style():
        columns = 2 if criteria else 1
        height = 1.3 + 0.19 * max(len(names), 6)
        figure, axes = canvas(9.0, height, columns=columns)
        bars = axes[0]
        bars.barh(at, np.maximum(share, 0), color=BLUE, height=0.62, label="ERR")
        dots = {"color": RED, "marker": "o", "ms": 3.2, "lw": 1}
        bars.plot(left_over, at, label="1 − ΣERR, still unexplained", **dots)
        bars.set_xscale("log")
        bars.xaxis.set_major_formatter(Powers())
        bars.xaxis.set_minor_formatter(Powers(labelOnlyBase=False))
        bars.set_yticks(at, [plain_text(name, 34) for name in names])
        bars.tick_params(axis="y", length=0, labelsize=8)
        bars.invert_yaxis()
        bars.grid(axis="y", visible=False)
        bars.set_xlabel("share of the output's energy")
        bars.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, borderaxespad=0.1)
        if criteria:
            _criteria(axes[1], criteria)
    return figure


def refinement(history: Sequence[Mapping[str, Any]]) -> Figure:
    """Loss per iteration on a log axis, coloured by horizon; validation beside it.

    Each entry has `iteration`, `loss`, and where known `horizon` [samples], `stage`
    and `validation`. The best validation value is ringed.
    """
    step = np.arange(len(history))
    loss = np.array([_positive_or_nan(h.get("loss")) for h in history])
    proof = np.array([_positive_or_nan(h.get("validation")) for h in history])
    horizon = [_horizon(h) for h in history]
    with use_style():
        figure, axes = canvas(9.0, 2.9, columns=2, sharex=True)
        for i, name in enumerate(dict.fromkeys(horizon)):
            here = np.array([h == name for h in horizon])
            style = {
                "color": COLOUR_CYCLE[i % len(COLOUR_CYCLE)],
                "marker": "o",
                "ms": 3,
            }
            axes[0].plot(step[here], loss[here], label=name, **style)
            axes[1].plot(step[here], proof[here], **style)
        if np.any(np.isfinite(proof)):
            best = int(np.nanargmin(proof))
            ring = {"ms": 9, "mfc": "none", "mec": INK_COLOUR, "mew": 1.2, "ls": ""}
            axes[1].plot(best, proof[best], marker="o", label="best, kept", **ring)
            axes[1].legend()
        else:
            note = "no validation data"
            axes[1].text(0.5, 0.5, note, ha="center", transform=axes[1].transAxes)
        for ax, title in zip(axes, ("training loss", "validation"), strict=True):
            if ax.lines and np.any(np.isfinite(np.concatenate(_ydata(ax)))):
                ax.set_yscale("log")
                ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
                ax.yaxis.set_major_formatter("{x:g}")
                ax.yaxis.set_minor_formatter(NullFormatter())
            ax.set(xlabel="iteration", title=title)
            ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes[0].legend(title="horizon", title_fontsize=8.5)
    return figure


def _ydata(axes: Axes) -> list[np.ndarray]:
    return [np.asarray(line.get_ydata(), float) for line in axes.lines]


def _positive_or_nan(value: object) -> float:
    number = float(value) if isinstance(value, int | float | np.number) else np.nan
    return number if np.isfinite(number) and number > 0 else np.nan


def _horizon(entry: Mapping[str, Any]) -> str:
    value = entry.get("horizon")
    if value is None:
        return plain_text(entry.get("stage", "all"))
    return (
        f"{value} samples" if isinstance(value, int | np.integer) else plain_text(value)
    )


def _limits(axes: Axes, value: np.ndarray, around: np.ndarray | None = None) -> None:
    """Show the measurement; a free run that leaves it widely may leave the frame.

    A residual is shown up to the span of the measurement.
    """
    finite = value[np.isfinite(value)]
    base = finite if around is None else around[np.isfinite(around)]
    if not len(finite) or not len(base):
        return
    low, high = float(base.min()), float(base.max())
    room = (high - low) or abs(high) or 1.0
    if around is None:
        axes.set_ylim(low - 0.35 * room, high + 0.35 * room)
    else:
        reach = min(max(float(np.max(np.abs(finite))), 1e-12 * room), room) * 1.1
        axes.set_ylim(-reach, reach)


def _shade(axes: Axes, time: np.ndarray, where: np.ndarray | None) -> None:
    if where is None or not np.any(where):
        return
    change = np.diff(np.concatenate([[0], where.astype(int), [0]]))
    starts, ends = np.flatnonzero(change == 1), np.flatnonzero(change == -1) - 1
    for i, (a, b) in enumerate(list(zip(starts, ends, strict=True))[:200]):
        label = "feedback limited" if i == 0 else None
        axes.axvspan(time[a], time[b], color=RED, alpha=0.16, lw=0.5, label=label)


def _draw_normal(axes: Axes, counts: np.ndarray, edges: np.ndarray) -> None:
    middle = 0.5 * (edges[:-1] + edges[1:])
    spread = float(np.sqrt(np.average(middle**2, weights=counts)))
    if spread > 0:
        at = np.linspace(edges[0], edges[-1], 200)
        density = np.exp(-0.5 * (at / spread) ** 2) / (spread * np.sqrt(2 * np.pi))
        bulk = density * counts.sum() * (edges[1] - edges[0])
        axes.plot(at, bulk, color=INK_COLOUR, lw=0.9, ls=(0, (3, 1.5)))


def _criteria(axes: Axes, criteria: Mapping[str, Numbers]) -> None:
    for i, (name, values) in enumerate(criteria.items()):
        value = np.asarray([np.nan if v is None else v for v in values], float)
        value = np.where(np.isfinite(value), value, np.nan)
        if np.all(np.isnan(value)):
            continue
        low, high = np.nanmin(value), np.nanmax(value)
        scaled = (value - low) / ((high - low) or 1.0)
        size, color = np.arange(1, len(value) + 1), COLOUR_CYCLE[i % len(COLOUR_CYCLE)]
        best = int(np.nanargmin(value))
        label = f"{plain_text(name)}, least at {size[best]}"
        axes.plot(size, scaled, color=color, label=label)
        axes.plot(size[best], scaled[best], color=color, marker="o", ms=5)
    axes.set(xlabel="number of terms", ylabel="from best (0) to worst (1)")
    kept = max(map(len, criteria.values()))
    axes.set_title(f"one-step criteria by size; {kept} terms kept")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend()
