"""Figures 5.6 and 5.7 of thesis chapter 5, and the spread over seeds."""

import matplotlib.figure
import numpy as np
from chapter5_tables import MODES
from matplotlib.axes import Axes

from jaxnarx import Channel
from jaxnarx.shell.figures.style import (
    BLUE,
    GREY,
    INK_COLOUR,
    ORANGE,
    RED,
    canvas,
    use_style,
)

COLORS = {"one_step": GREY, "free_run": BLUE}


def draw_prediction(
    channel: Channel, models: dict[str, dict]
) -> matplotlib.figure.Figure:
    """Unseen output and the errors of CORR and ERR, one step ahead and free."""
    with use_style():
        figure, axes = canvas(10, 4.8, rows=2, columns=2, sharex=True, sharey="row")
        for column, mode in enumerate(MODES):
            top, low = axes[column], axes[2 + column]
            runs = {k: models[k]["runs"]["unseen"][mode] for k in ("CORR", "ERR")}
            one = runs["CORR"]
            top.plot(
                one["at"], one["measured"], color=INK_COLOUR, lw=1.6, label="measured"
            )
            for (name, run), color in zip(runs.items(), (BLUE, ORANGE), strict=True):
                top.plot(run["at"], run["predicted"], color=color, lw=0.9, label=name)
                error = run["measured"] - run["predicted"]
                low.plot(run["at"], error, color=color, lw=0.8)
            top.set_title("one step ahead" if mode == "one_step" else "free run")
            low.set_xlabel("event of 360°")
        axes[0].set_ylabel(channel.label)
        axes[2].set_ylabel(f"error [{channel.unit}]")
        axes[1].legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
        axes[0].margins(x=0.01)
    return figure


def draw_spread(outputs: dict[str, list[dict]]) -> matplotlib.figure.Figure:
    """Share of the unseen variance that is not explained, every seed a dot."""
    with use_style():
        figure, axes = canvas(10, 3.6, columns=2, sharey=True)
        for ax, (output, seeds) in zip(axes, outputs.items(), strict=True):
            _dots(ax, seeds)
            ax.set_yticks(range(len(seeds[0])), list(seeds[0]))
            ax.set(xscale="log", title=output)
            ax.set_xlabel("unseen variance not explained [%]")
            ax.xaxis.set_major_formatter("{x:g}")
        axes[0].invert_yaxis()
        for label, color in (*COLORS.items(), ("held at its bounds", RED)):
            axes[1].scatter([], [], s=14, color=color, label=label.replace("_", " "))
        axes[1].plot([], [], "|", color=INK_COLOUR, ms=8, label="median")
        figure.legend(loc="outside upper right", ncols=4, handletextpad=0.2)
    return figure


def _dots(ax: Axes, seeds: list[dict]) -> None:
    """One step ahead above, free run below the line of each method."""
    for mode, aside in zip(MODES, (-0.15, 0.15), strict=True):
        for i, name in enumerate(seeds[0]):
            rows = [models[name]["quality"]["unseen"][mode] for models in seeds]
            x = [100 - row["r2"] for row in rows]
            color = [RED if row["diverged"] else COLORS[mode] for row in rows]
            ax.scatter(x, [i + aside] * len(x), s=12, c=color, alpha=0.7, linewidths=0)
            ends = [i + aside - 0.14, i + aside + 0.14]
            ax.plot([np.median(x)] * 2, ends, color=INK_COLOUR)
