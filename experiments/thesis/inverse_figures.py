"""Figures of inverse models: signals, tracking, and how near a cascade is to one."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxnarx.shell.figures.style import (
    BLUE,
    COLOUR_CYCLE,
    GREY,
    INK_COLOUR,
    ORANGE,
    RED,
    canvas,
    plain_text,
    use_style,
)

ROW = 1.25
"""Height of a panel [inch]."""


class Panel(NamedTuple):
    """One signal over time: its label with unit, and its curves by name.

    The first curve, what is asked for or measured, is drawn in grey below the others.
    """

    label: str
    curves: Mapping[str, Float[np.ndarray, " time"]]


def traces(
    time: Float[np.ndarray, " time"], panels: Sequence[Panel], title: str = ""
) -> Figure:
    """Panels under each other over a common time [s], with one legend a panel."""
    with use_style():
        height = 0.5 + ROW * len(panels)
        figure, axes = canvas(9.0, height, rows=len(panels), sharex=True)
        for ax, panel in zip(axes, panels, strict=True):
            _panel(ax, time, panel)
        axes[-1].set_xlabel("time [s]")
        axes[0].set_title(plain_text(title, 90))
    return figure


def _panel(ax: Axes, time: np.ndarray, panel: Panel) -> None:
    several = len(panel.curves) > 1
    colors = (GREY, BLUE, ORANGE, RED, *COLOUR_CYCLE) if several else (BLUE,)
    for n, ((name, values), color) in enumerate(
        zip(panel.curves.items(), colors, strict=False)
    ):
        wide = 2.2 if several and n == 0 else 1.0
        ax.plot(time, values, color=color, lw=wide, label=plain_text(name))
    ax.set_ylabel(plain_text(panel.label, 24))
    if several:
        place = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.97)}
        ax.legend(ncols=4, fontsize=7.5, borderpad=0.0, **place)


def unity(found: Mapping[str, Any]) -> Figure:
    """Static gains and frequency responses of cascades by name.

    `found` holds values of `unity_gain`, of the same targets. Above: the static
    gain from each reference to its target at every point that rests free of limits,
    over the reference, with the band of 5 % about one. Below: the median size of the
    response over the points, with their quartiles.
    """
    values = list(found.values())
    targets = values[0].target_names
    with use_style():
        figure, axes = canvas(9.0, 5.0, rows=2, columns=len(targets))
        for i, target in enumerate(targets):
            top, low = axes[i], axes[len(targets) + i]
            for (name, value), color in zip(found.items(), COLOUR_CYCLE, strict=False):
                _gains(top, value, i, name, color)
                _response(low, value, i, name, color)
            top.axhspan(0.95, 1.05, color=GREY, alpha=0.2, lw=0)
            top.set(title=plain_text(target), xlabel="reference at rest")
            low.set(xscale="log", xlabel="frequency [Hz]")
            for ax in (top, low):
                ax.axhline(1.0, color=INK_COLOUR, lw=0.6)
            low.set_ylim(bottom=0)
        axes[0].set_ylabel("static gain")
        axes[len(targets)].set_ylabel("size of the response")
        axes[0].legend()
    return figure


def _gains(ax: Axes, value: Any, i: int, name: str, color: str) -> None:
    good = value.settled & ~value.held
    at, gain = value.reference[good, i], value.gain[good, i, i]
    ax.plot(at, gain, "o", ms=4, color=color, label=plain_text(name), alpha=0.8)


def _response(ax: Axes, value: Any, i: int, name: str, color: str) -> None:
    good = value.settled & ~value.held
    if not good.any():
        return
    size = np.abs(value.response[good, :, i, i])
    low, middle, high = np.quantile(size, [0.25, 0.5, 0.75], axis=0)
    ax.plot(value.frequency, middle, color=color, label=plain_text(name))
    ax.fill_between(value.frequency, low, high, color=color, alpha=0.15, lw=0)


def gain_signs(
    place: Float[np.ndarray, "points 2"],
    gains: Mapping[str, Float[np.ndarray, " points"]],
    labels: Sequence[str],
    title: str = "",
) -> Figure:
    """Where gains are positive and where negative, over two channels, side by side."""
    with use_style():
        figure, axes = canvas(9.0, 3.4, columns=len(gains), sharey=True)
        for ax, (name, gain) in zip(axes, gains.items(), strict=True):
            for mark, color, flag in (("o", BLUE, gain < 0), ("^", RED, gain > 0)):
                word = "positive" if mark == "^" else "negative"
                spot = {"ls": "", "ms": 3.5, "alpha": 0.7, "mew": 0}
                x, y = place[flag].T
                ax.plot(x, y, mark, color=color, label=word, **spot)
            ax.set(xlabel=plain_text(labels[0]), title=plain_text(f"{title}{name}", 70))
        axes[0].set_ylabel(plain_text(labels[1]))
        axes[0].legend()
    return figure


def authority(
    late: Float[np.ndarray, " time"],
    torque: Float[np.ndarray, " time"],
    error: Mapping[str, Float[np.ndarray, " time"]],
) -> Figure:
    """What a degree of spark does to torque, and the errors of estimated sparks.

    Over `late`, the distance from the best spark [deg]: the torque's slope `torque`
    [Nm/deg], and the root mean square of each `error` [deg] in bins of 3 degrees.
    """
    edges = np.arange(np.floor(late.min() / 3) * 3, late.max() + 3, 3.0)
    bins = np.digitize(late, edges)
    used = [b for b in np.unique(bins) if np.sum(bins == b) >= 5]
    middle = np.array([late[bins == b].mean() for b in used])
    with use_style():
        figure, (left, right) = canvas(9.0, 3.0, columns=2)
        left.plot(late, torque, ".", ms=2, color=BLUE)
        left.axhline(0.0, color=INK_COLOUR, lw=0.6)
        left.set_ylabel("torque by spark [Nm/deg]")
        for (name, wrong), color in zip(error.items(), COLOUR_CYCLE, strict=False):
            size = [float(np.sqrt(np.mean(wrong[bins == b] ** 2))) for b in used]
            right.plot(middle, size, "o-", ms=3, color=color, label=plain_text(name))
        right.set_ylabel("error of the spark, rms [deg]")
        right.set_ylim(bottom=0)
        right.legend()
        for ax in (left, right):
            ax.set_xlabel("spark from the best one [deg]")
    return figure
