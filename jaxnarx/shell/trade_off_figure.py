"""Error against cost, the structures marked that no other beats."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from jaxnarx.evaluation.cost import pareto
from jaxnarx.shell.style import CYCLE, INK, canvas, plain, styled

Numbers = Sequence[float | int | None] | np.ndarray
"""A list or array of numbers; None where one is not known."""

FEW = 30.0
"""Ratio of largest to smallest cost from which its axis is logarithmic."""


def trade_off(
    fitness: Numbers,
    costs: Mapping[str, Numbers],
    *,
    label: str = "NRMSE",
    groups: Sequence[str] | None = None,
    larger_is_better: bool = False,
) -> Figure:
    """Fitness of structures against each of their costs, one panel a cost.

    As the thesis's figures 6.6 and 6.7: `costs` by name, such as regressors,
    multiplications and local models; `groups` names what each structure belongs to (a
    method), drawn in one colour. The line joins the structures of a panel that no other
    beats in both. Unknown values (None, NaN, infinite) are left out.
    """
    value = _numbers(fitness)
    members = np.array(
        ["" if g is None else str(g) for g in groups or [""] * len(value)]
    )
    with styled():
        figure, axes = canvas(9.0, 3.1, columns=len(costs), sharey=True)
        for ax, (name, cost) in zip(axes, costs.items(), strict=True):
            _panel(ax, _numbers(cost), value, members, larger_is_better)
            ax.set_xlabel(plain(name))
        axes[0].set_ylabel(plain(label))
        found = [ax.get_legend_handles_labels() for ax in axes]
        lines = {t: h for pair in found for h, t in zip(*pair, strict=True)}
        figure.legend(lines.values(), lines.keys(), loc="outside upper left", ncols=6)
    return figure


def front(
    cost: Float[np.ndarray, " points"],
    fitness: Float[np.ndarray, " points"],
    larger_is_better: bool = False,
) -> Bool[np.ndarray, " points"]:
    """The structures that no other beats in cost and fitness together."""
    return pareto(np.stack([cost, -fitness if larger_is_better else fitness], axis=1))


def _numbers(values: Numbers) -> np.ndarray:
    number = np.array([np.nan if v is None else v for v in values], float)
    return np.where(np.isfinite(number), number, np.nan)


def _panel(axes: Axes, cost, value, members, larger_is_better: bool) -> None:
    known = np.isfinite(cost) & np.isfinite(value)
    cost, value, members = cost[known], value[known], members[known]
    best = front(cost, value, larger_is_better)
    order = np.argsort(cost[best], kind="stable")
    way = {"color": INK, "lw": 0.9, "drawstyle": "steps-post", "label": "front"}
    axes.plot(cost[best][order], value[best][order], **way)
    for i, name in enumerate(dict.fromkeys(members.tolist())):
        own, dots = members == name, {"marker": "o", "ms": 4.5, "ls": ""}
        color, text = CYCLE[i % len(CYCLE)], plain(name) if name else None
        axes.plot(cost[own], value[own], color=color, mfc="none", **dots)
        axes.plot(cost[own & best], value[own & best], color=color, label=text, **dots)
    if len(cost) and cost.min() > 0 and cost.max() > FEW * cost.min():
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter("{x:g}")
    elif np.all(cost == np.round(cost)):
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
