"""Logarithmic axes that can be read, and figures that do not weigh much."""

from pathlib import Path

import numpy as np
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator
from PIL import Image

from jaxnarx.shell.figures.style import save

COLOURS = 160
"""Colours of a saved figure."""


def plain_ticks(axis: Axis) -> None:
    """Plain numbers at 1, 2 and 5 times powers of ten, or a few even ones where not two
    of these are in view; call it when everything is drawn."""
    low, high = sorted(axis.get_view_interval())
    decades = 10.0 ** np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)))
    ticks = np.outer(decades, [1.0, 2.0, 5.0]).ravel()
    ticks = ticks[(ticks >= low) & (ticks <= high)]
    if len(ticks) < 2:
        ticks = np.asarray(MaxNLocator(3).tick_values(low, high))
    axis.set_ticks(ticks[(ticks >= low) & (ticks <= high)].tolist())
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))


def save_small(figure: Figure, path: Path) -> None:
    """Save as PNG of few colours."""
    save(figure, path)
    with Image.open(path) as image:
        small = image.convert("RGB").quantize(COLOURS, Image.Quantize.MAXCOVERAGE)
    small.save(path, optimize=True)
