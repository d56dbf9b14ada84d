"""Figures 4.1 to 4.6, 4.8 and 4.9 of thesis chapter 4, and fits by seed."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib.figure
import numpy as np
from chapter4_algorithms import REFERENCE, UNCUT, Runs
from chapter4_models import (
    DUTY,
    MODES,
    ORDERS,
    PARTS,
    REFINED,
    SQUARES,
    START,
    STRUCTURE,
    Model,
    residual,
    thesis_place,
)
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

import jaxnarx as jnx
from jaxnarx.linear import NonlinearityCheck, OrderSearch, Spectra
from jaxnarx.shell.figures.style import (
    BLUE,
    COLOUR_CYCLE,
    GREEN,
    GREY,
    INK_COLOUR,
    ORANGE,
    RED,
    canvas,
    plain_text,
    use_style,
)

WINDOW = 1200
"""Events of a record that are drawn where curves are to be told apart."""
FEW = 200
BINS = 12
SPEED, ERROR, EVENT = "speed [rpm]", "error [rpm]", "event of 180°"


def draw_data(data: jnx.Dataset) -> matplotlib.figure.Figure:
    """Duty and speed of the records to identify and to validate (4.1, 4.2)."""
    with use_style():
        shared: dict[str, Any] = {"sharex": True, "sharey": "row"}
        figure, axes = canvas(10, 4.2, rows=2, columns=2, **shared)
        for n, name in enumerate(PARTS[:2]):
            record = data.records[n]
            axes[n].plot(record.u[:, 0], color=BLUE, lw=0.6)
            axes[2 + n].plot(record.y[:, 0], color=INK_COLOUR, lw=0.6)
            axes[n].set_title(name)
            axes[2 + n].set_xlabel(EVENT)
        axes[0].set_ylabel("duty of the valve")
        axes[2].set_ylabel(SPEED)
        axes[0].margins(x=0.01)
    return figure


def draw_coherence(
    found: Spectra, check: NonlinearityCheck
) -> matplotlib.figure.Figure:
    """Coherence (4.3) beside what the noise alone would leave, and the level of chance.

    What noise leaves is drawn up to where half of the output is noise: beyond, the
    estimate scatters.
    """
    expected = check.expected_coherence
    noisy = np.logical_or.accumulate(expected < 0.5)
    with use_style():
        figure, axes = canvas(6.4, 2.8)
        ax = axes[0]
        ax.plot(found.frequency, found.coherence, color=BLUE, label="measured")
        left = np.where(noisy, np.nan, expected)
        ax.plot(found.frequency, left, color=ORANGE, label="linear with noise")
        label = "chance, 95 %"
        ax.axhline(found.chance, color=GREY, ls="--", lw=0.8, label=label)
        ax.set(ylim=(0, 1.02), xlim=(0, None), xlabel="frequency [Hz]")
        names = ", ".join(c.name for c in found.inputs)
        ax.set_ylabel("coherence")
        ax.set_title(
            plain_text(f"{names} to {found.output.name}, {found.segments} segments")
        )
        ax.legend(loc="upper right")
        turn = 2 * found.sample_time
        other = ax.secondary_xaxis(
            "top",
            functions=(
                lambda f: np.asarray(f) * turn,
                lambda w: np.asarray(w) / turn,
            ),
        )
        other.set_xlabel("frequency [pi rad/sample]")
    return figure


def draw_orders(search: OrderSearch) -> matplotlib.figure.Figure:
    """Unexplained output variance by the number of parameters (4.4).

    Bars are the best structures of every number; those that AIC and MDL choose are
    coloured and named, the thesis's is marked. The axis begins near the smallest bar:
    what matters is small.
    """
    frontier = search.frontier
    count, left = search.parameters[frontier], search.unexplained[frontier]
    with use_style():
        figure, axes = canvas(6.4, 3.2)
        ax = axes[0]
        ax.bar(count, left, color="#c9d1d9", width=0.8)
        chosen: dict[int, list[str]] = {}
        for name in ("mdl", "aic"):
            chosen.setdefault(search.best_place(name), []).append(name.upper())
        for (place, names), colour in zip(chosen.items(), (BLUE, ORANGE), strict=False):
            orders = ", ".join(map(str, search.orders(place)))
            ax.bar(
                search.parameters[place],
                search.unexplained[place],
                color=colour,
                width=0.8,
                label=f"{' and '.join(names)}: ({orders})",
            )
        low = float(left.min())
        # The first bars may tower over all others; they are cut off.
        high = min(float(left.max()), low + 4 * float(np.median(left) - low) + 1e-12)
        if high > low:
            ax.set_ylim(low - 0.15 * (high - low), high + 0.05 * (high - low))
        ax.set(
            xlabel="number of parameters $n_a + n_b$",
            ylabel="unexplained output variance [%]",
        )
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        place = thesis_place(search)
        if place is not None:
            top = float(search.unexplained[place])
            at = int(search.parameters[place])
            ax.plot(at, top, "D", color=RED, ms=6, label=f"thesis: {ORDERS}")
            low, high = ax.get_ylim()
            ax.set_ylim(low, max(high, top + 0.05 * (top - low)))
        ax.legend(loc="upper right", title="$(n_a, n_b, n_k)$ chosen by")
    return figure


def draw_runs(
    data: jnx.Dataset, models: Mapping[str, Model], part: str = "validation"
) -> matplotlib.figure.Figure:
    """Measured speed and free runs in the first events, and their errors below."""
    shown = slice(START, START + WINDOW)
    with use_style():
        figure, (top, low) = canvas(10, 4.8, rows=2, sharex=True)
        place = PARTS.index(part)
        y = data.records[place].y[shown, 0]
        at = START + np.arange(len(y))
        top.plot(at, y, color=INK_COLOUR, lw=1.8, label="measured")
        for (name, model), colour in zip(models.items(), COLOUR_CYCLE, strict=False):
            run = model.predicted["free_run"][place][shown]
            top.plot(at, run, color=colour, lw=1.0, label=name)
            low.plot(at, y - run, color=colour, lw=0.8)
        low.axhline(0, color=INK_COLOUR, lw=0.6)
        top.set(ylabel=SPEED, title=f"free run, {part} record")
        low.set(ylabel=ERROR, xlabel=EVENT)
        top.legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
        top.margins(x=0.01)
    return figure


def draw_algorithms(
    data: jnx.Dataset, found: Mapping[str, Mapping[str, Any]]
) -> matplotlib.figure.Figure:
    """How far free runs are from that of QR (4.6); no distance stands at 1e-15."""
    speed = data.records[1].y[START:, 0]
    names = list(found)
    with use_style():
        shared: dict[str, Any] = {"sharey": True, "sharex": True}
        figure, axes = canvas(10, 3.4, columns=len(names), **shared)
        for ax, name in zip(axes, names, strict=True):
            _distances(ax, found[name]["runs"], float(np.ptp(speed)))
            ax.axvline(0.5, color=RED, ls="--", lw=0.9)
            ax.set(xscale="log", title=name)
            ax.set_xlabel("largest distance of free runs [% of range]")
        axes[0].invert_yaxis()
        axes[0].annotate(
            "thesis: below 0.5 %",
            (0.5, 0.03),
            xycoords=("data", "axes fraction"),
            xytext=(-4, 0),
            textcoords="offset points",
            ha="right",
            color=RED,
            fontsize=8,
        )
    return figure


def _distances(ax: Axes, runs: Runs, size: float) -> None:
    """A dot for every way but the reference."""
    ways = sorted((w for w in runs if w != REFERENCE), key=lambda w: w[0])
    look = {
        "norm": (BLUE, "columns by norm"),
        "mean": (ORANGE, "columns by mean"),
        "none": (GREY, "as they are"),
        UNCUT: (INK_COLOUR, "as they are, uncut"),
    }
    for row, way in enumerate(ways):
        gap = np.abs(runs[way] - runs[REFERENCE])[START:].max()
        ax.plot(max(100 * gap / size, 1e-15), row, "o", ms=5, color=look[way[1]][0])
    labels = [f"{algorithm}, {look[scaling][1]}" for algorithm, scaling in ways]
    ax.set_yticks(range(len(ways)), labels)


def draw_residual(
    data: jnx.Dataset, models: Mapping[str, Model]
) -> matplotlib.figure.Figure:
    """Residuals of the validation record over time and over the speed (4.9).

    One step ahead only the first events are drawn over time.
    """
    names = (STRUCTURE, SQUARES, SQUARES + REFINED)
    colours = dict(zip(names, (GREY, BLUE, GREEN), strict=True))
    speed = data.records[1].y[START:, 0]
    with use_style():
        figure, axes = canvas(10, 5.6, rows=2, columns=2)
        for mode, time, point in zip(MODES, axes[:2], axes[2:], strict=True):
            shown = FEW if mode == "one_step" else len(speed)
            for name in names:
                error = residual(data, models[name], "validation", mode)
                look: dict[str, Any] = {"color": colours[name], "label": name}
                at = np.arange(len(error))[:shown] + START
                time.plot(at, error[:shown], lw=0.7, **look)
                _by_speed(point, speed, error, colours[name])
            time.set(title=mode.replace("_", " "), xlabel=EVENT)
            point.set_xlabel("measured " + SPEED)
            for ax in (time, point):
                ax.axhline(0, color=INK_COLOUR, lw=0.6)
                ax.margins(x=0.01)
        axes[0].set_ylabel("residual [rpm]")
        axes[2].set_ylabel("mean of residual [rpm],\nbar: one standard deviation")
        lines = axes[1].get_legend_handles_labels()
        figure.legend(*lines, loc="outside upper right", ncols=3)
    return figure


def by_speed(
    speed: np.ndarray, error: np.ndarray, bins: int = BINS
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Middle, mean and standard deviation of the error in bins of equal width."""
    edges = np.linspace(speed.min(), speed.max(), bins + 1)
    own = np.clip(np.searchsorted(edges, speed, side="right") - 1, 0, bins - 1)
    kept = [n for n in range(bins) if np.sum(own == n) > 1]
    middle = (edges[:-1] + edges[1:])[kept] / 2
    mean = np.array([error[own == n].mean() for n in kept])
    return middle, mean, np.array([error[own == n].std() for n in kept])


def _by_speed(ax: Axes, speed: np.ndarray, error: np.ndarray, colour: str) -> None:
    at, mean, deviation = by_speed(speed, error)
    ax.errorbar(at, mean, deviation, color=colour, marker="o", ms=3, lw=1.1, capsize=2)


def draw_fits(rows: Sequence[Mapping[str, Any]]) -> matplotlib.figure.Figure:
    """Fit ratio of every model on the unseen record, every seed a dot."""
    names = list(dict.fromkeys(row["model"] for row in rows))
    colours = {"one_step": GREY, "free_run": BLUE}
    with use_style():
        figure, axes = canvas(10, 3.8, columns=2)
        for ax, mode in zip(axes, MODES, strict=True):
            for place, name in enumerate(names):
                own = [r for r in rows if r["model"] == name]
                fit = [r["unseen"][mode]["fit"] for r in own]
                look = {"s": 14, "color": colours[mode], "alpha": 0.7}
                ax.scatter(fit, [place] * len(fit), linewidths=0, **look)
                ends = [place - 0.25, place + 0.25]
                ax.plot([np.median(fit)] * 2, ends, color=INK_COLOUR)
            ax.set_xlabel("fit ratio of the unseen record [%]")
            ax.set_title(mode.replace("_", " "))
            ax.set_yticks(range(len(names)), names)
            ax.invert_yaxis()
        axes[1].set_yticklabels([])
        for value in (75.8, 73.93):
            axes[1].axvline(value, color=RED, ls="--", lw=0.9)
        place = {"xytext": (4, 6), "textcoords": "offset points", "color": RED}
        corner = {"xycoords": ("data", "axes fraction"), "fontsize": 8}
        axes[1].annotate("ARX of the thesis", (75.8, 0.0), **place, **corner)
    return figure


DRAWN = (STRUCTURE, "ARX by MDL", "output error(2, 2, 6)")
"""Linear models of figure 4.5."""
CURVED = (STRUCTURE, SQUARES, SQUARES + REFINED, DUTY + REFINED)
"""Models of figure 4.8."""
