"""Charts of the sections of a report."""

from typing import Any

from matplotlib.figure import Figure

from jaxnarx.shell.figures.style import Powers, canvas, plain_text, tone, use_style


def draw_chart(value: Any) -> Figure:
    """The curves of a `Chart` of a section, with a legend where there are several."""
    with use_style():
        figure, (axes,) = canvas(9.0, 2.8)
        for n, curve in enumerate(value.curves):
            name = plain_text(curve.name)
            axes.plot(curve.x, curve.y, color=tone(n), lw=1, label=name)
        axes.set(xlabel=plain_text(value.x_label), ylabel=plain_text(value.y_label))
        for letter, axis in (("x", axes.xaxis), ("y", axes.yaxis)):
            if letter in value.log:
                axes.set(**{f"{letter}scale": "log"})
                axis.set_major_formatter(Powers())
        if len(value.curves) > 1:
            axes.legend()
    return figure
