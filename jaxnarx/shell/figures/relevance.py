"""What every input is worth to the free run: bars of the error without it."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxnarx.evaluation import Relevance
from jaxnarx.shell.figures.style import (
    BLUE,
    GREY,
    INK_COLOUR,
    RED,
    canvas,
    plain_text,
    use_style,
)

PANELS_PER_ROW = 3
"""Panels in a row."""


def relevance(found: Relevance) -> Figure:
    """Free-run error without each input, that missed most on top; a panel per output.

    The line is the error with all inputs. A run that diverges without an input is a red
    bar to the edge; the open dot tells by how much withholding it moves the run.
    """
    outputs = len(found.outputs)
    columns = min(outputs, PANELS_PER_ROW)
    rows = -(-outputs // columns)
    height = 0.85 + 0.24 * len(found.inputs)
    with use_style():
        figure, axes = canvas(9.0, max(height, 1.8) * rows, rows=rows, columns=columns)
        for o, ax in enumerate(axes[:outputs]):
            _bars(ax, found, o)
        for ax in axes[outputs:]:
            ax.set_axis_off()
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper left", ncols=4)
    return figure


def _bars(axes: Axes, found: Relevance, o: int) -> None:
    order = found.order(o)
    error, moved = found.without[order, o], found.moved[order, o]
    at, lost = np.arange(len(order)), ~np.isfinite(error)
    known = np.concatenate([error[~lost], moved[~lost], [found.complete[o], 0.1]])
    edge = 1.12 * float(np.max(known[np.isfinite(known)]))
    look: dict[str, Any] = {"height": 0.62, "alpha": 0.8}
    fine = at[~lost], error[~lost]
    axes.barh(*fine, color=BLUE, label=f"without it ({_words(found)})", **look)
    if lost.any():
        axes.barh(at[lost], edge, color=RED, label="diverges without it", **look)
    dots = {"ls": "", "marker": "o", "ms": 4, "mfc": "white", "color": INK_COLOUR}
    axes.plot(moved[~lost], at[~lost], label="moves the run by", **dots)
    if np.isfinite(found.complete[o]):
        axes.axvline(found.complete[o], color=GREY, lw=1.2, label="with all inputs")
    axes.set_yticks(at, [plain_text(found.inputs[i].name, 20) for i in order])
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="y", visible=False)
    axes.invert_yaxis()
    axes.set(xlim=(0, edge), xlabel="NRMSE of the free run")
    axes.set_title(plain_text(found.outputs[o].name, 30))


def _words(found: Relevance) -> str:
    return "held at its mean" if found.how == "mean" else "permuted in blocks"
