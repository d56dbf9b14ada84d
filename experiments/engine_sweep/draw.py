"""Figures of the engine sweep."""

from typing import Any

import numpy as np
from beds import BEDS
from matplotlib.figure import Figure

from jaxnarx.shell.figures.style import (
    BLUE,
    GREY,
    ORANGE,
    canvas,
    plain_text,
    use_style,
)

Row = dict[str, Any]
COLOURS = {"engine": BLUE, "noise": ORANGE, "excitation": GREY}
SAID = {
    "engine": "engines",
    "noise": "nominal, other noise",
    "excitation": "nominal, other excitation",
}
SHOWN, DOTS = 9, 48
"""Terms of a panel, and members of one."""
STRUCTURES = {
    "nominal terms": "nominal terms,\nown regions",
    "own": "own, refitted",
    "nominal": "nominal, refitted",
    "sister": "sister's, refitted",
    "as it is": "nominal network",
}


def draw_terms(found: dict[str, Any]) -> Figure:
    """Shares of the terms chosen most often."""
    count = len(found)
    lines, columns = -(-count // 2), min(2, count)
    with use_style():
        figure, axes = canvas(8.0, 2.3 * lines + 0.4, rows=lines, columns=columns)
        for axis, (bed, answers) in zip(axes, found.items(), strict=False):
            share = dict(list(answers["terms"]["share"].items())[:SHOWN])
            at = np.arange(len(share))
            for group, colour in COLOURS.items():
                values = [100 * own[group] for own in share.values()]
                mark = "s" if group == "engine" else "o"
                axis.plot(values, -at, mark, color=colour, ms=4.5, label=SAID[group])
            axis.set_yticks(-at, [plain_text(term) for term in share], fontsize=7)
            axis.set_xlim(-3, 103)
            axis.set_title(f"{bed}: {BEDS[bed].output}")
            axis.set_xlabel("members with the term [%]")
        figure.legend(
            *axes[0].get_legend_handles_labels(),
            **{"loc": "outside lower center", "ncols": len(COLOURS), "fontsize": 8},
        )
    return figure


def draw_partitions(rows: list[Row], beds: list[str]) -> Figure:
    """Refined centres, one panel for each group and bed, as many members in each."""
    shared = {"sharex": True, "sharey": True}
    with use_style():
        figure, axes = canvas(8.0, 5.6, rows=3, columns=len(beds), **shared)
        for n, (group, colour) in enumerate(COLOURS.items()):
            for axis, bed in zip(axes[n * len(beds) :], beds, strict=False):
                names = BEDS[bed].settings["grow.scheduling"]
                own = [
                    np.reshape(r["centre"], (-1, len(names)))
                    for r in rows
                    if (r["bed"], r["structure"]) == (bed, "refined")
                    and r["engine"].startswith(group)
                    and r["centre"]
                ]
                points = np.concatenate(own[:DOTS]).T
                axis.scatter(*points, s=5, color=colour, alpha=0.6, lw=0)
                axis.set_title(f"{bed}, {SAID[group]}", fontsize=7)
                axis.set_ylabel(plain_text(names[1]), fontsize=7)
                axis.set_xlabel(plain_text(names[0]), fontsize=7)
                axis.grid(False)
    return figure


def draw_transfer(rows: list[Row]) -> Figure:
    """Test error with another's structure over that with the own one."""
    beds = list(dict.fromkeys(r["bed"] for r in rows))
    with use_style():
        figure, axes = canvas(8.0, 3.2, columns=len(beds), sharey=True)
        for axis, bed in zip(axes, beds, strict=True):
            score = {
                (r["structure"], r["engine"]): r["test_free_run"]
                for r in rows
                if r["bed"] == bed and r["engine"].startswith("engine")
            }
            ratios = [_ratios(score, structure) for structure in STRUCTURES]
            axis.axhline(1.0, color=GREY, lw=0.8)
            axis.boxplot(ratios, showfliers=False, whis=(5, 95), widths=0.6)
            labels = [
                f"{s} ({len(r)})"
                for s, r in zip(STRUCTURES.values(), ratios, strict=True)
            ]
            axis.set_xticks(np.arange(len(labels)) + 1, labels, rotation=90, fontsize=7)
            axis.set_yscale("log")
            axis.set_title(f"{bed}: {BEDS[bed].output}")
        axes[0].set_ylabel("test NRMSE over that of\nown terms and regions, refined")
    return figure


def _ratios(score: dict[tuple[str, str], Any], structure: str) -> list[float]:
    """Over the engine's own refined network, where both run."""
    found = []
    for (name, engine), value in score.items():
        own = score.get(("refined", engine))
        if name == structure and value is not None and own is not None:
            found.append(value / own if np.isfinite(own) else np.nan)
    return [x for x in found if np.isfinite(x)]
