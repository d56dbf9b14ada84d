"""Figures of sweeps: pairs before and after, groups, heat maps, fronts."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from jaxnarx.errors import SpecError
from jaxnarx.shell.style import CYCLE, GREY, INK, RED, canvas, plain, styled
from jaxnarx.shell.trade_off_figure import trade_off
from jaxnarx.sweep import Comparison, SweepTable

WIDE = 5.0
"""Ratio of largest to smallest score from which its axis is logarithmic."""


def paired_scatter(comparison: Comparison, *, color: str | None = None) -> Figure:
    """Score after against before, a dot for each pair; below the diagonal is better.

    `color` names a label of the pairs that is shown as colour. Pairs of which one side
    failed are counted in the corner, the pair that lost most is circled.
    """
    x, y = comparison.before, comparison.after
    groups = [str(name[color]) if color else "" for name in comparison.labels]
    first, second = map(plain, comparison.levels)
    with styled():
        figure, (axes,) = canvas(4.6, 4.4)
        for i, group in enumerate(dict.fromkeys(groups)):
            own = np.array([name == group for name in groups])
            dots = {"ls": "", "marker": "o", "ms": 3.5, "mew": 0, "alpha": 0.75}
            tint, text = CYCLE[i % len(CYCLE)], plain(group) or None
            axes.plot(x[own], y[own], color=tint, label=text, **dots)
        _equal(axes, x, y)
        worst = comparison.worst
        ring = {"marker": "o", "ms": 9, "mfc": "none", "mec": RED, "ls": ""}
        axes.plot([worst["before"]], [worst["after"]], **ring, label="worst pair")
        axes.set_xlabel(f"{plain(comparison.score)}, {first}")
        axes.set_ylabel(f"{plain(comparison.score)}, {second}")
        axes.set_title(_verdict(comparison))
        figure.legend(loc="outside lower center", ncols=4)
    return figure


def strip(
    table: SweepTable, group: str, by: str, *, order: Sequence[object] | None = None
) -> Figure:
    """A score by group: every member a dot, and a box from quartile to quartile.

    Members that failed, or whose score is not finite, are counted above their group.
    The dots are spread sideways by their rank, not by chance.
    """
    score = np.where(table.okay, table.numbers(by), np.nan)
    found = table.column(group).tolist()
    names = list(order) if order is not None else list(dict.fromkeys(found))
    if not names:
        raise SpecError("the table has no rows to draw", field="table")
    with styled():
        figure, (axes,) = canvas(max(3.6, 1.0 + 0.9 * len(names)), 3.2)
        for i, name in enumerate(names):
            own = score[[value == name for value in found]]
            _box(axes, i, own[np.isfinite(own)], CYCLE[i % len(CYCLE)])
            if failed := int(np.sum(~np.isfinite(own))):
                where = {"xycoords": ("data", "axes fraction"), "ha": "center"}
                text = f"{failed} failed"
                axes.annotate(text, (i, 1.0), va="bottom", color=RED, size=8, **where)
        axes.set_xticks(range(len(names)), [plain(name, 20) for name in names])
        axes.grid(visible=False, axis="x")
        axes.set_xlim(-0.6, len(names) - 0.4)
        axes.set_xlabel(plain(group))
        axes.set_ylabel(plain(by))
        _logarithmic(axes.set_yscale, score)
    return figure


def heat_map(
    table: SweepTable,
    across: str,
    up: str,
    by: str,
    *,
    statistic: Callable[[np.ndarray], object] = np.median,
) -> Figure:
    """A score over two settings: the median (or another statistic) of each pair.

    Every cell says its number, and how many of its members failed, if any did.
    """
    score = np.where(table.okay, table.numbers(by), np.nan)
    x, y = table.column(across), table.column(up)
    columns, rows = _sorted(x), _sorted(y)
    values = np.full((len(rows), len(columns)), np.nan)
    failed = np.zeros(values.shape, int)
    for i, j in np.ndindex(values.shape):
        own = score[(y == rows[i]) & (x == columns[j])]
        known = own[np.isfinite(own)]
        failed[i, j] = len(own) - len(known)
        values[i, j] = statistic(known) if len(known) else np.nan
    with styled():
        figure, (axes,) = canvas(1.6 + 0.8 * len(columns), 1.3 + 0.5 * len(rows))
        image = axes.imshow(values, cmap="Blues", aspect="auto", origin="lower")
        _write(axes, values, failed)
        axes.set_xticks(range(len(columns)), [_tick(c) for c in columns])
        axes.set_yticks(range(len(rows)), [_tick(r) for r in rows])
        axes.grid(visible=False)
        axes.set_xlabel(plain(across))
        axes.set_ylabel(plain(up))
        figure.colorbar(image, ax=axes, label=plain(by))
    return figure


def sweep_front(
    table: SweepTable, by: str, costs: Sequence[str], *, group: str | None = None
) -> Figure:
    """A score against its costs, the members on the front joined; see `trade_off`."""
    score = np.where(table.okay, table.numbers(by), np.nan)
    groups = None if group is None else [str(v) for v in table.column(group)]
    numbers = {name: table.numbers(name) for name in costs}
    return trade_off(score, numbers, label=by, groups=groups)


def _equal(axes: Axes, x, y) -> None:
    """Both axes alike, logarithmic where the scores spread far, and their diagonal."""
    both = np.concatenate([x, y])
    for scale in (axes.set_xscale, axes.set_yscale):
        _logarithmic(scale, both)
    low, high = float(both.min()), float(both.max())
    if axes.get_xscale() == "log":
        low, high = low / 1.15, high * 1.15
    else:
        margin = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
        low, high = low - margin, high + margin
    axes.set_xlim(low, high)
    axes.set_ylim(low, high)
    axes.set_aspect("equal")
    axes.plot([low, high], [low, high], color=GREY, lw=0.8)
    if axes.get_xscale() == "log":
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=8))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter("")


def _logarithmic(set_scale: Callable[..., object], values) -> None:
    known = values[np.isfinite(values)]
    if len(known) and known.min() > 0 and known.max() > WIDE * known.min():
        set_scale("log")


def _box(axes: Axes, at: int, values: Float[np.ndarray, " _"], color: str) -> None:
    if not len(values):
        return
    rank = np.argsort(np.argsort(values, kind="stable"), kind="stable")
    aside = 0.25 * (2 * ((rank * 0.618) % 1) - 1) * min(1.0, len(values) / 10)
    dots = {"ls": "", "marker": "o", "ms": 3, "mew": 0, "alpha": 0.55}
    axes.plot(at + aside, values, color=color, **dots)
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
    edge = [at - 0.3, at + 0.3]
    axes.fill_between(edge, low, high, fc="none", ec=INK, lw=0.8)
    axes.plot(edge, [middle, middle], color=INK, lw=1.6)


def _write(axes: Axes, values, failed) -> None:
    """The number in every cell, in ink that reads on its colour."""
    known = values[np.isfinite(values)]
    half = (known.min() + known.max()) / 2 if len(known) else 0.0
    for i, j in np.ndindex(values.shape):
        text = f"{values[i, j]:.3g}" if np.isfinite(values[i, j]) else "-"
        text += f"\n{failed[i, j]} failed" if failed[i, j] else ""
        ink = "white" if np.isfinite(values[i, j]) and values[i, j] > half else INK
        axes.text(j, i, text, ha="center", va="center", color=ink, size=8)


def _verdict(comparison: Comparison) -> str:
    """What the figure shows, in its title."""
    share = f"better in {100 * comparison.improved.value:.0f} %"
    lines = [f"{len(comparison.before)} pairs, {share}"]
    ratio = comparison.ratio
    if np.isfinite(ratio.value):
        lines[0] += f", ratio {ratio.value:.3g} ({ratio.low:.3g} to {ratio.high:.3g})"
    failed = {
        comparison.levels[0]: comparison.failed_before,
        comparison.levels[1]: comparison.failed_after,
        "both": comparison.failed_both,
    }
    told = [f"{count} with {plain(name)}" for name, count in failed.items() if count]
    return "\n".join([*lines, *(["failed: " + ", ".join(told)] if told else [])])


def _sorted(values: np.ndarray) -> list:
    found = list(dict.fromkeys(values.tolist()))
    numbers = all(isinstance(v, int | float) for v in found)
    return sorted(found) if numbers else found


def _tick(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else plain(value, 20)
