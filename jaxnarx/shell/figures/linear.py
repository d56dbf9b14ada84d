"""Figures of linear systems: Bode, poles and zeros, step responses."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxnarx.linear import Spectra, TransferFunction
from jaxnarx.shell.figures.style import (
    COLOUR_CYCLE,
    GREY,
    INK_COLOUR,
    canvas,
    plain_text,
    use_style,
)

Systems = Mapping[str, TransferFunction]
"""Transfer functions by the name they have in the legend."""


MAX_RELATIVE_DEVIATION = 0.25
"""Relative standard deviation up to which a measured response is shown."""


def bode(
    systems: Systems, *, measured: Spectra | None = None, input: int = 0
) -> Figure:
    """Magnitude and phase over frequency, a line per system.

    `measured` adds the response estimated from data as dots, its 95 % band shaded,
    where its magnitude is known to 25 % (one standard deviation); `input` is the place
    of its input.
    """
    with use_style():
        figure, (top, bottom) = canvas(6.4, 4.2, rows=2, sharex=True)
        if measured is not None:
            _draw_measured(top, bottom, measured, input, next(iter(systems.values())))
        for n, (name, system) in enumerate(systems.items()):
            curve = system.bode()
            colour = COLOUR_CYCLE[n % len(COLOUR_CYCLE)]
            top.plot(
                curve.frequency, curve.magnitude, color=colour, label=plain_text(name)
            )
            bottom.plot(curve.frequency, curve.phase, color=colour)
        top.set(xscale="log", yscale="log", ylabel=f"magnitude {_gain(systems)}")
        bottom.set(xlabel="frequency [Hz]", ylabel="phase [deg]")
        top.legend(loc="lower left")
    return figure


def _draw_measured(
    top: Axes, bottom: Axes, found: Spectra, place: int, near: TransferFunction
) -> None:
    """Dots; the phase by whole turns next to that of `near`."""
    response, spread = found.response[:, place], 1.96 * found.deviation[:, place]
    size, frequency = np.abs(response), found.frequency
    # What is not shown is a gap in the band too.
    shown = np.where(spread < 1.96 * MAX_RELATIVE_DEVIATION * size, 1.0, np.nan)
    look = {"ls": "", "marker": "o", "ms": 2, "mew": 0, "color": GREY}
    top.plot(frequency, size * shown, label="measured", **look)
    low, high = (size - spread) * shown, (size + spread) * shown
    top.fill_between(frequency, low, high, color=GREY, alpha=0.25, lw=0)
    every = near.bode()
    aim = np.interp(frequency, every.frequency, every.phase)
    phase = np.degrees(np.angle(response))
    turned = phase + 360 * np.round((aim - phase) / 360)
    bottom.plot(frequency, turned * shown, **look)


def _gain(systems: Systems) -> str:
    first = next(iter(systems.values()))
    unit = first.input.unit if first.input is not None else first.output.unit
    parts = [u if u not in ("", "-") else "1" for u in (first.output.unit, unit)]
    return (
        f"[{plain_text(parts[0])} per {plain_text(parts[1])}]"
        if parts != ["1", "1"]
        else ""
    )


def poles(systems: Systems) -> Figure:
    """Poles as crosses, zeros as circles in the z plane.

    The panel reaches to 1.6; what lies beyond is counted in the title.
    """
    with use_style():
        figure, axes = canvas(4.2, 4.2)
        ax, angle = axes[0], np.linspace(0, 2 * np.pi, 200)
        ax.plot(np.cos(angle), np.sin(angle), color=INK_COLOUR, lw=0.6)
        beyond = 0
        for n, (name, system) in enumerate(systems.items()):
            colour = COLOUR_CYCLE[n % len(COLOUR_CYCLE)]
            look = {"ls": "", "color": colour, "ms": 6, "mew": 1.2}
            ax.plot(*_plane(system.poles), marker="x", label=plain_text(name), **look)
            ax.plot(*_plane(system.zeros), marker="o", mfc="none", **look)
            far = np.abs(_plane(np.concatenate([system.poles, system.zeros])))
            beyond += int((far.max(axis=0) > 1.6).sum())
        ax.set(xlim=(-1.6, 1.6), ylim=(-1.6, 1.6), xlabel="real", ylabel="imaginary")
        ax.set_aspect("equal")
        more = f"; {beyond} beyond" if beyond else ""
        ax.set_title(f"poles (crosses) and zeros (circles){more}")
        if len(systems) > 1:
            ax.legend(loc="upper left")
    return figure


def _plane(roots: np.ndarray) -> np.ndarray:
    return np.stack([np.real(roots), np.imag(roots)])


def step_responses(systems: Systems, *, length: int | None = None) -> Figure:
    """Unit step responses over time, the static gains dotted."""
    with use_style():
        figure, axes = canvas(6.4, 2.8)
        ax = axes[0]
        for n, (name, system) in enumerate(systems.items()):
            colour = COLOUR_CYCLE[n % len(COLOUR_CYCLE)]
            time, response = system.step_response(length)
            ax.step(time, response, where="post", color=colour, label=plain_text(name))
            if system.stable and np.isfinite(system.dc_gain):
                ax.axhline(system.dc_gain, color=colour, ls=":", lw=0.8)
        ax.set(xlabel="time [s]", ylabel=f"response {_gain(systems)}")
        ax.legend(loc="lower right")
    return figure
