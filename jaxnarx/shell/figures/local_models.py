"""Gains and slowest poles of the local models over the operating range."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxnarx.data import Dataset
from jaxnarx.evaluation import LocalBehaviour, local_behaviour
from jaxnarx.models import Network
from jaxnarx.shell.figures.style import INK_COLOUR, canvas, plain_text, tone, use_style

PANELS_PER_ROW = 4
"""Panels in a row."""


def local_models(
    network: Network,
    data: Dataset,
    *,
    output: str | None = None,
    over: Sequence[str] = (),
) -> Figure:
    """Static gain by every signal and the slowest pole, a panel each.

    Against the first variable of `over` (default: the scheduling), a colour per local
    model; with two variables as a map of points, coloured by the value. See
    `local_behaviour`. Unstable local models are crosses and have no gain.
    """
    models = local_behaviour(network, data, output=output, over=over)
    units = {c.name: c.unit for c in network.channels.all}
    panels = {
        f"gain by {name} {_gain_unit(units[models[0].output], units[name])}": [
            m.gain.get(name, np.zeros(len(m.place))) for m in models
        ]
        for name in dict.fromkeys(name for m in models for name in m.gain)
    }
    panels["slowest time constant [s]"] = [m.time_constant for m in models]
    rows = -(-len(panels) // PANELS_PER_ROW)
    with use_style():
        columns = min(len(panels), PANELS_PER_ROW)
        two = len(models[0].over) == 2
        height = (2.9 if two else 2.6) * rows
        share = {"sharex": True, "sharey": two}
        figure, axes = canvas(9.0, height, rows=rows, columns=columns, **share)
        for ax, (title, values) in zip(axes, panels.items(), strict=False):
            (_map if two else _curve)(ax, models, values)
            ax.set_title(plain_text(title), fontsize=8.5)
        for ax in axes[len(panels) :]:
            ax.set_axis_off()
        names = [plain_text(name) for name in models[0].over]
        for ax in axes[max(len(panels) - columns, 0) : len(panels)]:
            ax.set_xlabel(names[0])
            ax.tick_params(labelbottom=True)
        if two:
            for ax in axes[::columns]:
                ax.set_ylabel(names[1])
        else:
            _legend(figure, axes[0])
    return figure


def _gain_unit(output: str, signal: str) -> str:
    """`[ppm per rpm]`; nothing where neither has a unit."""
    parts = [u if u not in ("", "-") else "1" for u in (output, signal)]
    return f"[{parts[0]} per {parts[1]}]" if parts != ["1", "1"] else "[-]"


def _curve(axes: Axes, models: Sequence[LocalBehaviour], values) -> None:
    """Values over the first variable, a colour per model."""
    known = np.concatenate([v[np.isfinite(v)] for v in values])
    top = float(known.max(initial=0.0))
    for m, value in zip(models, values, strict=True):
        fine = np.isfinite(value)
        look = {"color": tone(m.model - 1), "ls": "", "mew": 0}
        dots = look | {"marker": "o", "ms": 2.6, "alpha": 0.6}
        axes.plot(m.place[fine, 0], value[fine], label=f"model {m.model}", **dots)
        wild = np.isinf(value)
        if wild.any():
            cross = look | {"marker": "x", "ms": 4, "mew": 0.9, "clip_on": False}
            axes.plot(m.place[wild, 0], np.full(wild.sum(), 1.06 * top or 1.0), **cross)


def _map(axes: Axes, models: Sequence[LocalBehaviour], values) -> None:
    """Points in two variables, coloured by the value; the middle of a gain is zero."""
    place = np.concatenate([m.place for m in models])
    value = np.concatenate(values)
    fine = np.isfinite(value)
    signed = bool(np.any(value[fine] < 0))
    low, high = np.quantile(value[fine], [0.02, 0.98]) if fine.any() else (0.0, 1.0)
    if signed:
        high = max(abs(low), abs(high))
        low = -high
    dots = axes.scatter(
        *place[fine].T,
        c=value[fine],
        s=9,
        lw=0,
        vmin=low,
        vmax=high if high > low else low + 1,
        cmap="RdBu_r" if signed else "viridis",
        rasterized=True,
    )
    wild = np.isinf(value)
    axes.plot(*place[wild].T, color=INK_COLOUR, marker="x", ms=4, mew=0.9, ls="")
    axes.figure.colorbar(dots, ax=axes, location="bottom", pad=0.02, aspect=30)


def _legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=8, markerscale=2)
