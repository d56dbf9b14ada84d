"""The figures of a report: plain data in, a `Picture` out.

Axes carry units. Long records are reduced to their envelope, so that a figure stays
small and no peak is lost.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnarx.evaluation import (
    Band,
    Bars,
    Cells,
    Chart,
    Curve,
    Mark,
    Picture,
    Range,
    Span,
    StraightLine,
    Text,
)
from jaxnarx.shell.figures.envelope import LINE_POINTS, envelope
from jaxnarx.shell.figures.palette import shorten

Numbers = Sequence[float | int | None] | np.ndarray
"""A list or array of numbers; None where one is not known."""

PANELS_PER_ROW = 4
"""Panels beside one another where every record is shown."""
MOST_SPANS = 200
"""Stretches of limited feedback that are shaded."""
SCATTER_POINTS = 1500
"""Pairs of measured and simulated values that are drawn."""


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
) -> Picture:
    """Measurement, free run and one-step prediction over time [s], residual below.

    Between `lower` and `upper` lies the interval of the free run, shaded; about the
    residual too.

    The one-step prediction, nearly always right, lies broad and pale behind the
    measurement. Samples that do not count (`scored` False) are left out of the
    measurement and of the residual; where the feedback bound acted is shaded.
    """
    gap = measured if scored is None else np.where(scored, measured, np.nan)
    residual = gap - simulated
    top: list[Mark] = list(_spans(time, limited))
    low: list[Mark] = list(_spans(time, limited))
    if lower is not None and upper is not None:
        top.append(_interval(time, lower, upper, points, "90 % interval"))
        low.append(_interval(time, lower - simulated, upper - simulated, points))
    if one_step is not None:
        line = envelope(time, one_step, points)
        top.append(Curve("one step", *line, "orange", width=4.0, opacity=0.45))
    top.append(Curve("measured", *envelope(time, gap, points), "ink", width=1.4))
    top.append(Curve("free run", *envelope(time, simulated, points), "blue"))
    low.append(Curve("", *envelope(time, residual, points), "blue", width=0.8))
    low.append(StraightLine(0.0, "y", width=0.6))
    start = float(time[0])
    ends = start, float(time[-1]) if len(time) > 1 else start + 1
    return Picture(
        (
            Chart(tuple(top), "", label, title, x_range=ends, y_range=_about(gap)),
            Chart(
                tuple(low),
                *("time [s]", "residual"),
                x_range=ends,
                y_range=_about(residual, around=gap),
                legend="",
            ),
        ),
        height=3.4,
        heights=(3, 1),
        shared="x",
    )


def _interval(
    time: Float[np.ndarray, " time"],
    lower: Float[np.ndarray, " time"],
    upper: Float[np.ndarray, " time"],
    points: int,
    name: str = "",
) -> Band:
    """Shade it; of a long record the least and the largest of each bin."""
    bins = max(points // 2, 1)
    step = max(1, -(-len(time) // bins))
    at = np.arange(0, len(time), step)
    low, high = np.minimum.reduceat(lower, at), np.maximum.reduceat(upper, at)
    return Band(time[at], low, high, name=name)


def draw_record_panels(traces: Sequence[Any], *, points: int = 240) -> Picture:
    """Measurement and free run of many records of one output, a small panel each.

    Each trace has `time`, `measured`, `simulated`, `scored`, `record` and `rmse`. All
    panels share the axis of the output.
    """
    columns = min(len(traces), PANELS_PER_ROW)
    shown = [np.where(t.scored, t.measured, np.nan) for t in traces]
    ends = _about(np.concatenate(shown))
    charts = []
    for trace, measured in zip(traces, shown, strict=True):
        line = envelope(trace.time, measured, points)
        run = envelope(trace.time, trace.simulated, points)
        marks = Curve("", *line, "ink"), Curve("", *run, "blue", width=0.8)
        error = "diverged" if trace.rmse is None else f"RMSE {trace.rmse:.3g}"
        charts.append(
            Chart(
                marks,
                *("time [s]", trace.output.label),
                f"{shorten(trace.record, 28)}: {error}",
                y_range=ends,
            )
        )
    rows = -(-len(charts) // columns)
    return Picture(
        tuple(charts), columns, height=1.35 * rows + 0.3, shared="y", small=True
    )


def error_map(value: Any) -> Picture:
    """Free-run error, bias, spread and number of samples in cells over two variables.

    `value` is an `ErrorMap`. The darker, the larger; of the bias red where the run is
    too low and blue where it is too high. Empty cells hold no sample, crossed ones too
    few to say much.
    """
    unit = f" [{value.unit}]" if value.unit else ""
    counts = np.where(value.samples > 0, value.samples, np.nan)
    panels = (
        (value.rms, "RMSE" + unit, False),
        (value.bias, "bias" + unit, True),
        (value.spread, "spread" + unit, False),
        (counts, "samples", False),
    )
    crossed = value.thin & (value.samples > 0)
    ends = [(float(e[0]), float(e[-1])) for e in value.edges]
    charts = [
        Chart(
            (Cells(value.edges[0], value.edges[1], cells, signed, crossed),),
            value.variables[0],
            value.variables[1],
            title,
            x_range=ends[0],
            y_range=ends[1],
        )
        for cells, title, signed in panels
    ]
    return Picture(tuple(charts), 2, height=5.6, shared="xy")


def error_by_index(value: Any, edges: Sequence[float]) -> Picture:
    """Free-run error over the index of the domain; the line is its border.

    All bins are as wide; one with too few samples for an error says so. `value` is an
    `ErrorByIndex`, `edges` are the borders of its bins, the last without an end.
    """
    unit = f" [{value.unit}]" if value.unit else ""
    bins, border = len(value.rms), list(edges).index(1.0)
    few = np.flatnonzero(np.isnan(value.rms) & (value.samples > 0))
    at = np.arange(bins + 1)
    axis: dict[str, Any] = {"x_label": "index, one at the border", "x_range": (0, bins)}
    axis["x_ticks"] = tuple((float(n), f"{e:g}") for n, e in enumerate(edges[:-1]))
    errors = Band(at, 0.0, np.nan_to_num(value.rms), opacity=0.75, steps="after")
    texts = [Text(n + 0.5, 0.0, "few", up="bottom", size=7) for n in few.tolist()]
    samples = np.where(value.samples > 0, value.samples, np.nan)
    counts = Band(at, 0.5, samples, opacity=0.75, steps="after")
    top = float(np.nanmax(value.rms, initial=0.0)) or 1.0
    most = 2.0 * max(float(np.max(value.samples, initial=1)), 5.0)
    return Picture(
        (
            Chart(
                (errors, StraightLine(border), *texts),
                y_label="RMSE" + unit,
                y_range=(0.0, 1.06 * top),
                **axis,
            ),
            Chart(
                (counts, StraightLine(border)),
                y_label="samples",
                log="y",
                y_range=(0.5, most),
                **axis,
            ),
        ),
        columns=2,
    )


def agreement(
    measured: Float[np.ndarray, " pairs"],
    simulated: Float[np.ndarray, " pairs"],
    counts: Int[np.ndarray, " bins"],
    edges: Float[np.ndarray, " borders"],
    *,
    label: str,
    unit: str = "",
) -> Picture:
    """Simulated against measured, and the histogram of the free-run residual.

    The dashed curve is the normal density of the same mean square.
    """
    left: list[Mark] = []
    if len(measured):
        span = np.array([measured.min(), measured.max()])
        left.append(Curve("", span, span, "ink", width=0.8))
        kept = np.linspace(0, len(measured) - 1, min(len(measured), SCATTER_POINTS))
        at = np.unique(kept.astype(int))
        dots: dict[str, Any] = {"line": "", "marker": ".", "size": 2.5, "opacity": 0.45}
        left.append(Curve("", measured[at], simulated[at], "blue", **dots))
    right: list[Mark] = []
    if len(counts):
        right.append(Band(edges, 0.0, counts, opacity=0.75, steps="after"))
        right += _normal_density(counts, edges)
        right.append(StraightLine(0.0, width=0.8))
    charts = (
        Chart(tuple(left), "measured " + label, "free run"),
        Chart(tuple(right), "residual" + (f" [{unit}]" if unit else ""), "samples"),
    )
    return Picture(charts, 2, height=3.2, widths=(1, 1.6))


def _normal_density(counts: np.ndarray, edges: np.ndarray) -> Iterator[Curve]:
    middle = 0.5 * (edges[:-1] + edges[1:])
    spread = float(np.sqrt(np.average(middle**2, weights=counts)))
    if spread > 0:
        at = np.linspace(edges[0], edges[-1], 200)
        density = np.exp(-0.5 * (at / spread) ** 2) / (spread * np.sqrt(2 * np.pi))
        bulk = density * counts.sum() * (edges[1] - edges[0])
        yield Curve("", at, bulk, "ink", "dashed", 0.9)


def selection_path(
    names: Sequence[str],
    err: Numbers,
    cumulative: Numbers | None = None,
    *,
    criteria: Mapping[str, Numbers] | None = None,
) -> Picture:
    """Error reduction ratio per chosen term, what is left unexplained, and criteria.

    `cumulative` is the running sum of `err`; 1 - cumulative is drawn on a log axis, its
    zeros left out. Criteria, each by number of terms, are drawn with their lowest
    point marked, on a common scale from their best (0) to their worst (1).
    """
    share = np.asarray(err, float)
    total = np.cumsum(share) if cumulative is None else np.asarray(cumulative, float)
    left_over = np.where(total < 1, 1 - total, np.nan)
    at = np.arange(len(share))
    unexplained = "1 − ΣERR, still unexplained"
    marks = (
        Bars(at, np.where(share > 0, share, np.nan), name="ERR"),
        Curve(unexplained, left_over, at, "red", width=1.0, marker="o", size=3.2),
    )
    charts = [
        Chart(
            marks,
            "share of the output's energy",
            log="x",
            y_range=(len(share) - 0.4, -0.6),
            y_ticks=tuple(
                (float(n), shorten(name, 34)) for n, name in enumerate(names)
            ),
        )
    ]
    if criteria:
        charts.append(_criteria(criteria))
    height = 1.3 + 0.19 * max(len(names), 6)
    return Picture(tuple(charts), len(charts), height=height)


def _criteria(criteria: Mapping[str, Numbers]) -> Chart:
    marks: list[Mark] = []
    for i, (name, values) in enumerate(criteria.items()):
        value = np.asarray([np.nan if v is None else v for v in values], float)
        value = np.where(np.isfinite(value), value, np.nan)
        if np.all(np.isnan(value)):
            continue
        low, high = np.nanmin(value), np.nanmax(value)
        scaled = (value - low) / ((high - low) or 1.0)
        size, best = np.arange(1, len(value) + 1), int(np.nanargmin(value))
        marks.append(Curve(f"{name}, least at {size[best]}", size, scaled, i))
        place = size[best : best + 1], scaled[best : best + 1]
        marks.append(Curve("", *place, i, line="", marker="o", size=5))
    kept = max(map(len, criteria.values()))
    return Chart(
        tuple(marks),
        "number of terms",
        "from best (0) to worst (1)",
        f"one-step criteria by size; {kept} terms kept",
        whole="x",
    )


def refinement(history: Sequence[Mapping[str, Any]]) -> Picture:
    """Loss per iteration on a log axis, coloured by horizon; validation beside it.

    Each entry has `iteration`, `loss`, and where known `horizon` [samples], `stage`
    and `validation`. The best validation value is ringed.
    """
    step = np.arange(len(history))
    loss = np.array([_positive_or_nan(h.get("loss")) for h in history])
    proof = np.array([_positive_or_nan(h.get("validation")) for h in history])
    horizon = [_horizon(h) for h in history]
    panels: tuple[list[Mark], list[Mark]] = [], []
    for i, name in enumerate(dict.fromkeys(horizon)):
        here = np.array([h == name for h in horizon])
        for marks, values in zip(panels, (loss, proof), strict=True):
            text = f"horizon {name}" if marks is panels[0] else ""
            line = step[here], values[here]
            marks.append(Curve(text, *line, i, marker="o", size=3))
    known = bool(np.any(np.isfinite(proof)))
    if known:
        best = int(np.nanargmin(proof))
        ring: dict[str, Any] = {"line": "", "marker": "o", "size": 9, "hollow": True}
        panels[1].append(Curve("best, kept", [best], [proof[best]], "ink", **ring))
    else:
        panels[1].append(Text(0.5 * len(step), 0.5, "no validation data"))
    charts = [
        Chart(
            tuple(marks),
            "iteration",
            title=title,
            log="y" if np.any(np.isfinite(values)) else "",
            x_range=(-0.5, len(step) - 0.5),
            whole="x",
        )
        for marks, values, title in zip(
            panels, (loss, proof), ("training loss", "validation"), strict=True
        )
    ]
    return Picture(tuple(charts), 2, height=3.0)


def _positive_or_nan(value: object) -> float:
    number = float(value) if isinstance(value, int | float | np.number) else np.nan
    return number if np.isfinite(number) and number > 0 else np.nan


def _horizon(entry: Mapping[str, Any]) -> str:
    value = entry.get("horizon")
    if value is None:
        return str(entry.get("stage", "all"))
    return f"{value} samples" if isinstance(value, int | np.integer) else str(value)


def _about(value: np.ndarray, around: np.ndarray | None = None) -> Range | None:
    """The range of the measurement; a free run that leaves it widely may leave the
    frame. A residual is shown up to the span of the measurement."""
    finite = value[np.isfinite(value)]
    base = finite if around is None else around[np.isfinite(around)]
    if not len(finite) or not len(base):
        return None
    low, high = float(base.min()), float(base.max())
    room = (high - low) or abs(high) or 1.0
    if around is None:
        return low - 0.35 * room, high + 0.35 * room
    reach = min(max(float(np.max(np.abs(finite))), 1e-12 * room), room) * 1.1
    return -reach, reach


def _spans(time: np.ndarray, where: np.ndarray | None) -> Iterator[Span]:
    """Stretches of time in which `where` is true."""
    if where is None or not np.any(where):
        return
    change = np.diff(np.concatenate([[0], where.astype(int), [0]]))
    starts, ends = np.flatnonzero(change == 1), np.flatnonzero(change == -1) - 1
    for i, (a, b) in enumerate(list(zip(starts, ends, strict=True))[:MOST_SPANS]):
        name = "feedback limited" if i == 0 else ""
        yield Span(float(time[a]), float(time[b]), "x", "red", 0.16, name)
