"""Figures 6.6 and 6.7 (fitness against size) and 6.22 (against local models)."""

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from jaxnarx.shell.figures.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    RED,
    canvas,
    use_style,
)

STRUCTURES = {
    **{"global linear": GREY, "global cubic": PURPLE},
    **{"local linear": BLUE, "local cubic": ORANGE},
}
HOW = {"F": "-", "ERR": "--"}
MLP = {"MLP NARX": (RED, "^"), "MLP NOE": (GREEN, "s")}
LOWEST = 0.0
"""Smaller fits are drawn at the lower end."""


def draw_sizes(found: Sequence[dict]) -> Figure:
    """Median fit of the free run on validation: by regressors, by multiplications."""
    outputs = list(dict.fromkeys(row["output"] for row in found))
    with use_style():
        figure, axes = canvas(10, 6.2, rows=2, columns=len(outputs), sharey="col")
        for column, output in enumerate(outputs):
            rows = [row for row in found if row["output"] == output]
            top, low = axes[column], axes[len(outputs) + column]
            _curves(top, rows, "regressors")
            _curves(low, rows, "multiplications")
            _points(low, rows)
            top.set(title=f"{output} (fits below 0 stand at 0)")
            top.set_xlabel("regressors of a local model")
            low.set(xlabel="multiplications a sample", xscale="log")
            low.xaxis.set_major_formatter("{x:g}")
            for ax in (top, low):
                ax.set_ylim(LOWEST, 100.0)
        for ax in (axes[0], axes[len(outputs)]):
            ax.set_ylabel("free-run fit, validation [%]")
        handles, labels = axes[len(outputs)].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=4)
    return figure


def _curves(ax: Axes, rows: Sequence[dict], x: str) -> None:
    for structure, color in STRUCTURES.items():
        for how, line in HOW.items():
            name = f"{structure}, {how}"
            mine = [row for row in rows if row["series"] == name]
            at = [row[x] for row in mine]
            ax.plot(at, _heights(mine), line, color=color, marker="o", ms=3, label=name)


def _points(ax: Axes, rows: Sequence[dict]) -> None:
    for structure in ("local linear", "local cubic"):
        name = f"{structure}, F, refined"
        mine = [row for row in rows if row["series"] == name]
        at = [row["multiplications"] for row in mine]
        style = {"ls": "", "marker": "*", "ms": 9, "mfc": "none"}
        ax.plot(at, _heights(mine), color=STRUCTURES[structure], label=name, **style)
    for name, (color, marker) in MLP.items():
        for inputs, filled in ((4, True), (2, False)):
            mine = [
                row for row in rows if (row["series"], row["inputs"]) == (name, inputs)
            ]
            at = [row["multiplications"] for row in mine]
            face = color if filled else "none"
            label = f"{name}, {inputs} inputs"
            style = {"ls": "", "marker": marker, "ms": 5, "mfc": face}
            ax.plot(at, _heights(mine), color=color, label=label, **style)


MODELS = (BLUE, ORANGE, GREEN, RED)


def draw_models(found: Sequence[dict], thesis: int) -> Figure:
    """NMSE (6.8) by the number of local models, medians over seeds."""
    names = list(dict.fromkeys(row["series"] for row in found))
    modes = {"one_step": "one step ahead", "free_run": "free run"}
    with use_style():
        figure, axes = canvas(10, 3.4, columns=len(modes))
        for ax, (mode, title) in zip(axes, modes.items(), strict=True):
            for name, color in zip(names, MODELS, strict=False):
                mine = [row for row in found if row["series"] == name]
                at = [row["models"] for row in mine]
                for part, line in (("validation", "-"), ("test", ":")):
                    y = [row[f"{part}_{mode}_nmse"]["median"] for row in mine]
                    label = name if part == "validation" else None
                    ax.plot(at, y, line, color=color, marker="o", ms=3, label=label)
            ax.axvline(thesis, color=GREY, lw=0.8, ls="--")
            ax.set(title=title, xlabel="local models", yscale="log")
            _plain_log(ax)
            ax.set_xticks(sorted({row["models"] for row in found}))
        axes[0].set_ylabel("NMSE (6.8), median of the seeds")
        axes[1].plot([], [], ":", color=GREY, label="unseen record")
        axes[1].plot([], [], "--", color=GREY, lw=0.8, label="thesis's optimum")
        handles, labels = axes[1].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=6)
    return figure


def _plain_log(ax: Axes) -> None:
    """Ticks at 1, 2 and 5 of every decade, written out."""
    ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter(NullFormatter())


ALONE = {
    **{"oblique tree": ("D", "oblique", 0.15), "given tree": ("P", "given", -0.15)},
    **{"refined": ("*", "refined", 0.3)},
}
"""Marker and name of trees of one size, and how far aside they stand."""


def draw_forward(found: Sequence[dict], thesis: dict[str, dict[str, float]]) -> Figure:
    """Figure 7.6: R2 of the free run by the number of regions, medians over seeds."""
    colors = {"F": BLUE, "ERR": ORANGE}
    with use_style():
        figure, axes = canvas(10, 4.4, columns=len(thesis))
        for ax, (output, printed) in zip(axes, thesis.items(), strict=True):
            rows = [row for row in found if row["output"] == output]
            for how, color in colors.items():
                _tree_curve(ax, rows, how, color)
                label = f"thesis, {how}"
                ax.axhline(printed[how], color=color, lw=0.8, ls=":", label=label)
            for name, (color, marker) in MLP.items():
                y = _heights([row for row in rows if row["series"] == name])
                style = {"ls": "", "marker": marker, "ms": 6, "clip_on": False}
                ax.plot([0] * len(y), y, color=color, label=name, **style)
            ax.set(title=output, xlabel="regions")
            at = sorted({row["models"] for row in rows if row["models"]})
            ax.set_xticks([0, *at], ["MLP", *map(str, at)])
        axes[0].set_ylabel("R2 of the free run, validation")
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=6)
    return figure


def _heights(rows: Sequence[dict]) -> list[float]:
    return [max(row["validation_free_run"]["median"], LOWEST) for row in rows]


def _tree_curve(ax: Axes, rows: Sequence[dict], how: str, color: str) -> None:
    def points(name: str) -> tuple[list[float], list[float]]:
        mine = [row for row in rows if row["series"] == name]
        return [row["models"] for row in mine], _heights(mine)

    ax.plot(*points(f"axis tree, {how}"), color=color, marker="o", ms=3, label=how)
    for name, (marker, label, aside) in ALONE.items():
        series = f"axis tree, {how}, refined" if name == "refined" else f"{name}, {how}"
        style = {"ls": "", "marker": marker, "ms": 7, "mfc": "none"}
        at, y = points(series)
        at = [x + aside for x in at]
        ax.plot(at, y, color=color, label=f"{label}, {how}", **style)
