"""Validity over two scheduling variables as a surface: hills, and valleys between."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.colors import LightSource, to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from jaxnarx.evaluation import describe_partition
from jaxnarx.models import Network
from jaxnarx.shell.figures.style import canvas, plain_text, tone, use_style

FINENESS = 81
"""Points a side, at most: a surface is drawn face by face."""


def validity_surface(network: Network) -> Figure:
    """The largest weight over two scheduling variables, in the colour of its model."""
    entry = next(iter(describe_partition(network).values()))
    first, second = (plain_text(name) for name in entry["scheduling"])
    with use_style():
        figure, (ax,) = canvas(5.4, 4.2, subplot_kw={"projection": "3d"})
        _surface(ax, entry["ranges"], np.asarray(entry["after"]["weights"], float))
        ax.set(xlabel=first, ylabel=second, zlabel="validity")
    return figure


def _surface(axes: Any, ranges, weights: Float[np.ndarray, "models _ _"]) -> None:
    for axis in (1, 2):
        at = np.linspace(0, weights.shape[axis] - 1, FINENESS).round().astype(int)
        weights = np.take(weights, np.unique(at), axis=axis)
    sides = zip(ranges, weights.shape[1:], strict=True)
    grid = [np.linspace(low, high, n) for (low, high), n in sides]
    color = np.array([to_rgb(tone(m)) for m in range(len(weights))])
    height = weights.max(axis=0)
    lit = LightSource(azdeg=225, altdeg=55).shade_rgb(
        0.35 + 0.65 * color[weights.argmax(axis=0)],
        height,
        fraction=0.5,
        vert_exag=weights.shape[1] / 3,
    )
    x, y = np.meshgrid(*grid, indexing="ij")
    counts = {"rcount": FINENESS, "ccount": FINENESS}
    look = {"facecolors": lit, "shade": False, "lw": 0, "antialiased": False}
    axes.plot_surface(x, y, height, rasterized=True, **look, **counts)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(4))
    axes.set_zlim(0, 1)
    axes.view_init(elev=48, azim=-115)
