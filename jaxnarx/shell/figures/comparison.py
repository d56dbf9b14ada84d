"""Several models on one page: their free runs, and their errors by size."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from jaxnarx.evaluation import ComparedRecord, ModelComparison, SizeErrors
from jaxnarx.shell.figures.envelope import envelope
from jaxnarx.shell.figures.style import (
    COLOUR_CYCLE,
    GREY,
    INK_COLOUR,
    canvas,
    plain_text,
    use_style,
)

LINE_POINTS = 900
"""Points of a line."""
LEGEND_ROW_LETTERS, LINE_SAMPLE_LETTERS = 125, 7
"""Letters that a row of the legend holds, and those that a line's sample takes."""


def draw_comparison(
    found: ModelComparison, records: Sequence[ComparedRecord]
) -> Figure:
    """Records below one another, each measured and simulated by every model.

    The legend of a panel tells how well each model fits this record.
    """
    with use_style():
        height = 2.3 * len(records) + 0.2
        figure, axes = canvas(9.0, height, rows=len(records))
        for ax, one in zip(axes, records, strict=True):
            _record(ax, one)
            ax.set_ylabel(plain_text(found.output.label, 26))
        axes[-1].set_xlabel("time [s]")
    return figure


def _record(axes: Axes, one: ComparedRecord) -> None:
    lines = {"color": INK_COLOUR, "lw": 1.5}
    axes.plot(*envelope(one.time, one.measured, LINE_POINTS), label="measured", **lines)
    for n, (name, run) in enumerate(one.simulated.items()):
        fit = one.fit[name]
        told = "diverges" if fit is None else f"{fit:.3g} %"
        line = envelope(one.time, run, LINE_POINTS)
        label = f"{plain_text(name, 24)}: {told}"
        axes.plot(*line, color=COLOUR_CYCLE[n % len(COLOUR_CYCLE)], lw=1.0, label=label)
    known = one.measured[np.isfinite(one.measured)]
    if len(known):
        low, high = float(known.min()), float(known.max())
        room = 0.35 * (high - low) or 1.0
        least, most = axes.get_ylim()
        axes.set_ylim(max(least, low - room), min(most, high + room))
    axes.set_xlim(one.time[0], one.time[-1] if len(one.time) > 1 else 1.0)
    part = f"{one.part}, " if one.part not in ("", "data") else ""
    labels = axes.get_legend_handles_labels()[1]
    columns = max(
        1,
        min(
            len(labels),
            LEGEND_ROW_LETTERS // (max(map(len, labels)) + LINE_SAMPLE_LETTERS),
        ),
    )
    rows = -(-len(labels) // columns)
    axes.set_title(
        plain_text(f"{part}{one.record}", 60), fontsize=8.5, pad=5 + 12 * rows
    )
    place = {"loc": "lower left", "bbox_to_anchor": (0, 0.99)}
    axes.legend(**place, ncols=columns, fontsize=8)


def draw_errors_by_size(found: SizeErrors) -> Figure:
    """Error of the free run and of one step over terms, and over operations.

    The upright line is the size that was chosen, the ring the least error in free run.
    A size of which the free run diverges is a gap.
    """
    panels = ((found.sizes, "number of terms"), (found.operations, "operations"))
    with use_style():
        figure, axes = canvas(9.0, 3.0, columns=2, sharey=True)
        for ax, (x, label) in zip(axes, panels, strict=True):
            for n, (part, free) in enumerate(found.free_run.items()):
                color = COLOUR_CYCLE[n % len(COLOUR_CYCLE)]
                free = np.where(np.isfinite(free), free, np.nan)
                name = f", {plain_text(part)}" if part != "data" else ""
                dots = {"color": color, "marker": "o", "ms": 3}
                ax.plot(x, free, label="free run" + name, **dots)
                one = {"color": color, "ls": (0, (3, 1.5)), "lw": 0.9}
                ax.plot(x, found.one_step[part], label="one step" + name, **one)
                if np.isfinite(free).any():
                    best = int(np.nanargmin(free))
                    ring = {"ms": 11, "mfc": "none", "mec": color, "mew": 1.3}
                    ax.plot(x[best], free[best], marker="o", ls="", **ring)
            at = int(np.flatnonzero(found.sizes == found.chosen)[0])
            ax.axvline(float(x[at]), color=GREY, lw=1.0, label="chosen")
            ax.set_xlabel(label)
            ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes[0].set_yscale("log")
        axes[0].yaxis.set_major_formatter("{x:g}")
        axes[0].set_ylabel(f"NRMSE of {plain_text(found.output.name, 24)}")
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper left", ncols=5)
    return figure
