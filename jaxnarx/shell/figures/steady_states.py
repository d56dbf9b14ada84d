"""Outputs at rest: over one input each through an operating point, and over two."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from jaxnarx.evaluation import Intersection, ResponseSurface
from jaxnarx.shell.figures.style import (
    BLUE,
    GREY,
    INK_COLOUR,
    canvas,
    plain_text,
    use_style,
)

PANELS_PER_ROW = 4
"""Panels in a row; more inputs go on below."""
COLOUR_LEVELS = 11
"""Steps of colour of a surface."""


def intersections(cuts: Sequence[Intersection]) -> Figure:
    """Every output at rest over every input, the others held at the operating point.

    A row of panels per output; the dot is the operating point, shaded the band. Dashed
    where the point lies outside of the domain; a gap where the model does not come to
    rest.
    """
    outputs = list(dict.fromkeys(cut.output.name for cut in cuts))
    inputs = len(cuts) // len(outputs)
    columns = min(inputs, PANELS_PER_ROW)
    each = -(-inputs // columns)
    rows = each * len(outputs)
    with use_style():
        figure, axes = canvas(9.0, 2.0 * rows + 0.3, rows=rows, columns=columns)
        for ax in axes:
            ax.set_axis_off()
        for o, name in enumerate(outputs):
            own = [cut for cut in cuts if cut.output.name == name]
            panels = axes[o * each * columns :][: len(own)]
            heights = _heights(own)
            for n, (ax, cut) in enumerate(zip(panels, own, strict=True)):
                ax.set_axis_on()
                _cut(ax, cut)
                if heights is not None:
                    ax.set_ylim(*heights)
                ax.tick_params(labelleft=n % columns == 0)
                if n % columns == 0:
                    ax.set_ylabel(plain_text(cut.output.label, 24))
        figure.suptitle(_point(cuts[0].at), x=0.01, ha="left", fontsize=8)
    return figure


def _cut(axes: Axes, cut: Intersection) -> None:
    beyond = np.zeros(len(cut.x), bool) if cut.index is None else cut.index > 1
    if cut.lower is not None and cut.upper is not None:
        fine = np.isfinite(cut.lower) & np.isfinite(cut.upper) & np.isfinite(cut.y)
        low, high = np.where(fine, cut.lower, np.nan), np.where(fine, cut.upper, np.nan)
        axes.fill_between(cut.x, low, high, color=BLUE, alpha=0.18, lw=0)
    axes.plot(cut.x, np.where(beyond, np.nan, cut.y), color=BLUE)
    # Dashed from the last place inside on.
    near = beyond | np.r_[beyond[1:], False] | np.r_[False, beyond[:-1]]
    axes.plot(cut.x, np.where(near, cut.y, np.nan), color=GREY, ls=(0, (3, 1.5)))
    axes.plot(*cut.here, color=INK_COLOUR, marker="o", ms=4.5, mec="white", mew=0.8)
    axes.set_xlabel(plain_text(cut.over.label, 26))
    axes.locator_params(axis="x", nbins=5)


def _heights(cuts: Sequence[Intersection]) -> tuple[float, float] | None:
    """The axis of one output: what its runs reach, with bands inside of the domain.

    Beyond it bands may be many times as wide.
    """
    known = []
    for cut in cuts:
        inside = np.ones(len(cut.x), bool) if cut.index is None else cut.index <= 1
        bands = [a[inside] for a in (cut.lower, cut.upper) if a is not None]
        known += [cut.y, *bands, np.array(cut.here[1:])]
    values = np.concatenate(known)
    values = values[np.isfinite(values)]
    if not len(values) or not np.ptp(values):
        return None
    room = 0.06 * float(np.ptp(values))
    return float(values.min()) - room, float(values.max()) + room


def _point(at) -> str:
    told = ", ".join(f"{name} {value:.4g}" for name, value in at.items())
    return plain_text(f"at rest, through {told}", 130)


def response_surface(found: ResponseSurface) -> Figure:
    """One output at rest over two inputs: steps of colour with lines between them.

    Hatched outside of the domain; white where the model does not come to rest.
    """
    with use_style():
        figure, (axes,) = canvas(6.4, 4.4)
        lines = {"colors": "white", "linewidths": 0.4, "linestyles": "solid"}
        value = np.ma.masked_invalid(found.value.T)
        low, high = _ends(found.value)
        levels = MaxNLocator(COLOUR_LEVELS).tick_values(low, high)
        filled = axes.contourf(found.x, found.y, value, levels=levels, cmap="viridis")
        axes.contour(found.x, found.y, value, levels=levels, **lines)
        if found.index is not None and np.any(found.index > 1):
            _hatch_outside(axes, found)
        figure.colorbar(filled, ax=axes, label=plain_text(found.output.label))
        here = [found.at[channel.name] for channel in found.over]
        axes.plot(*here, color=INK_COLOUR, marker="o", ms=5, mec="white", mew=0.8)
        axes.set_xlabel(plain_text(found.over[0].label))
        axes.set_ylabel(plain_text(found.over[1].label))
        own = {channel.name for channel in found.over}
        held = [f"{n} {v:.4g}" for n, v in found.at.items() if n not in own]
        if held:
            told = ", ".join(held)
            axes.set_title(plain_text(f"at rest with {told}", 90), fontsize=8)
        axes.grid(visible=False)
    return figure


def _ends(value: Float[np.ndarray, "first second"]) -> tuple[float, float]:
    known = value[np.isfinite(value)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    return (low, high) if high > low else (low - 0.5, low + 0.5)


def _hatch_outside(axes: Axes, found: ResponseSurface) -> None:
    assert found.index is not None
    style = {"colors": "none", "hatches": ["////"]}
    top = max(float(found.index.max()), 1.0) + 1.0
    axes.contourf(found.x, found.y, found.index.T, levels=[1.0, top], **style)
    line = {"colors": INK_COLOUR, "linewidths": 0.9}
    axes.contour(found.x, found.y, found.index.T, levels=[1.0], **line)
