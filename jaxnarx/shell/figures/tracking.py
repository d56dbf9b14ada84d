"""References, what follows them, and the commands behind it (thesis figure 7.14)."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxnarx.control import ControlledRun
from jaxnarx.inverse import Tracking
from jaxnarx.shell.figures.style import (
    COLOUR_CYCLE,
    INK_COLOUR,
    canvas,
    plain_text,
    use_style,
)
from jaxnarx.solution import Solution

Followed = Tracking | ControlledRun

MAX_SAMPLES_SHOWN = 600
"""Samples shown of a record; longer ones are cut, not thinned."""


def draw_tracking(
    ways: Mapping[str, Solution[Any]], sample_time: float, *, record: int = 0
) -> Figure:
    """One record of loops that follow the same references, one panel a signal.

    `ways` are cascades, such as the direct and the trained inverse, and closed loops by
    name. Targets first, with the reference in ink and the NRMSE over all records in the
    legend (or that the loop diverges), then other outputs that have a limit, dashed,
    then commands, the samples marked at which a limit holds them.
    """
    first = next(iter(ways.values())).value
    bounded = _bounded_outputs(first)
    panels = len(first.targets) + len(bounded) + len(first.command_names)
    length = min(MAX_SAMPLES_SHOWN, len(first.commands[record]))
    time = np.arange(length) * sample_time
    with use_style():
        figure, axes = canvas(9.0, 1.4 * panels + 0.6, rows=panels, sharex=True)
        for i, name in enumerate(first.target_names):
            ax = axes[i]
            wanted = first.references[record][:length, i]
            ax.plot(time, wanted, color=INK_COLOUR, linewidth=0.8, label="reference")
            for (way, found), colour in zip(ways.items(), COLOUR_CYCLE, strict=False):
                followed = found.value.outputs[record][:length, first.targets[i]]
                error = f"NRMSE {found.value.nrmse()[i]:.3g}"
                end = error if found.is_okay else found.status_name
                ax.plot(time, followed, color=colour, label=f"{way}, {end}")
            _draw_limits(ax, first, first.targets[i])
            _finish_panel(ax, name)
        for ax, o in zip(axes[len(first.targets) :], bounded, strict=False):
            for (way, found), colour in zip(ways.items(), COLOUR_CYCLE, strict=False):
                reached = found.value.outputs[record][:length, o]
                ax.plot(time, reached, color=colour, label=way)
            _draw_limits(ax, first, o)
            _finish_panel(ax, first.output_channels[o].name)
        for c, name in enumerate(first.command_names):
            ax = axes[len(first.targets) + len(bounded) + c]
            for (way, found), colour in zip(ways.items(), COLOUR_CYCLE, strict=False):
                _command(ax, time, found.value, record, c, colour, way)
            _finish_panel(ax, name)
        axes[-1].set_xlabel("time [s]")
    return figure


def _draw_limits(ax: Axes, value: Followed, o: int) -> None:
    if isinstance(value, ControlledRun):
        for limit in (value.floor[o], value.ceiling[o]):
            if np.isfinite(limit):
                ax.axhline(limit, color=INK_COLOUR, linewidth=0.8, linestyle="--")


def _bounded_outputs(value: Followed) -> list[int]:
    """Outputs that have a limit and no reference."""
    if not isinstance(value, ControlledRun):
        return []
    limited = np.isfinite(value.floor) | np.isfinite(value.ceiling)
    return [o for o in np.flatnonzero(limited).tolist() if o not in value.targets]


def _command(
    ax: Axes, time: np.ndarray, value: Followed, record: int, c: int, colour, way: str
) -> None:
    length = len(time)
    moved = value.commands[record][:length, c]
    ax.plot(time, moved, color=colour, label=way)
    held = (value.at_range[record] | value.at_rate[record])[:length, c]
    if held.any():
        ax.plot(time[held], moved[held], ".", color=colour, markersize=3)


def _finish_panel(ax: Axes, name: str) -> None:
    ax.set_ylabel(plain_text(name, 16))
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), ncols=4, borderaxespad=0)
    ax.margins(x=0)
