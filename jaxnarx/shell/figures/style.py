"""The look of matplotlib figures, and how they are written to files.

Figures are drawn with matplotlib's objects, never with pyplot, so nothing global is
kept and no display is needed.
"""

import io
import os
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation

from jaxnarx.files import write_whole
from jaxnarx.shell.figures.palette import BLUE as BLUE
from jaxnarx.shell.figures.palette import COLOUR_CYCLE as COLOUR_CYCLE
from jaxnarx.shell.figures.palette import GREEN as GREEN
from jaxnarx.shell.figures.palette import GREY as GREY
from jaxnarx.shell.figures.palette import GRID_COLOUR as GRID_COLOUR
from jaxnarx.shell.figures.palette import INK_COLOUR as INK_COLOUR
from jaxnarx.shell.figures.palette import ORANGE as ORANGE
from jaxnarx.shell.figures.palette import PURPLE as PURPLE
from jaxnarx.shell.figures.palette import RED as RED
from jaxnarx.shell.figures.palette import SKY as SKY
from jaxnarx.shell.figures.palette import shorten
from jaxnarx.shell.figures.palette import tone as tone

LAYOUT_ENGINE = "constrained"
"""How figures find their margins: half of the time of a figure."""

_STYLE_SETTINGS: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.titleweight": "normal",
    "axes.labelcolor": INK_COLOUR,
    "axes.edgecolor": INK_COLOUR,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.facecolor": "none",
    "figure.facecolor": "none",
    "grid.color": GRID_COLOUR,
    "grid.linewidth": 0.5,
    "text.color": INK_COLOUR,
    "xtick.color": INK_COLOUR,
    "ytick.color": INK_COLOUR,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.1,
    "svg.fonttype": "none",
    "svg.hashsalt": "jaxnarx",
    "savefig.facecolor": "none",
}


@contextmanager
def use_style() -> Iterator[None]:
    """Draw inside this: our settings, the caller's back afterwards, no font chatter.

    A channel name in a script the drawing font lacks is no fault: the SVG carries text.
    """
    with matplotlib.rc_context(_STYLE_SETTINGS), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*[Gg]lyph.*")
        yield


class Drawing(Figure):
    """A figure that a notebook shows by itself, without pyplot."""

    def _repr_png_(self) -> bytes:
        return png(self)


def png(figure: Figure) -> bytes:
    """The figure as a picture, 160 dpi on white."""
    picture = io.BytesIO()
    with use_style():
        figure.savefig(picture, format="png", dpi=160, facecolor="white")
    return picture.getvalue()


def canvas(
    width: float = 9.0, height: float = 2.8, *, rows: int = 1, columns: int = 1, **grid
) -> tuple[Figure, list[Axes]]:
    """A figure of that size in inches and its axes, row by row."""
    figure = Drawing(figsize=(width, height), layout=LAYOUT_ENGINE)
    axes = figure.subplots(rows, columns, squeeze=False, **grid)
    return figure, list(axes.flat)


class Powers(LogFormatterSciNotation):
    """Powers of ten as plain text, such as 10⁻³: mathematics takes long to set."""

    def __call__(self, x: Any, pos: int | None = None) -> str:
        """The label at `x`."""
        label = super().__call__(x, pos)
        text = re.sub(r"\^\{(.*?)\}", lambda m: m[1].translate(_SUPERSCRIPTS), label)
        return re.sub(r"\$|\\mathdefault|[{}]", "", text).replace(r"\times", "×")


_SUPERSCRIPTS = str.maketrans("−-0123456789", "⁻⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def plain_text(text: object, width: int = 48) -> str:
    """`text` as it is, on one line: no mathematics in it, no control characters."""
    return shorten(text, width).replace("$", r"\$")


def svg(figure: Figure) -> str:
    """The figure as SVG text: the same figure gives the same text, without dates."""
    stream = io.StringIO()
    with use_style(), _lay_out(figure):
        nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        figure.savefig(stream, format="svg", dpi=200, metadata=nothing)
    return stream.getvalue()


@contextmanager
def _lay_out(figure: Figure) -> Iterator[None]:
    """Lay out `figure` for SVG; inside this it has no layout engine.

    While it has one, `savefig` draws it twice, the first time for its layout only.
    """
    engine, canvas = figure.get_layout_engine(), figure.canvas
    FigureCanvasSVG(figure)  # the layout is found in the metrics of this format
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine(None)
    try:
        yield
    finally:
        figure.set_layout_engine(engine)
        figure.set_canvas(canvas)


def save(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write PNG (160 dpi, white) or SVG, told by the suffix; whole or not at all."""
    path = Path(path)
    if path.suffix.lower() == ".svg":
        data = svg(figure).encode("utf-8")
    elif path.suffix.lower() == ".png":
        data = png(figure)
    else:
        raise ValueError(f"figures are saved as .svg or .png, got {path.name!r}")
    write_whole(path, data)
