"""Figures of the engine sweep."""

from typing import Any

import numpy as np
from beds import BEDS
from matplotlib.figure import Figure

from jaxnarx.shell.style import BLUE, GREY, ORANGE, canvas, plain, styled

Row = dict[str, Any]
COLOURS = {"engine": BLUE, "noise": ORANGE, "excitation": GREY}
SAID = {
    "engine": "engines",
    "noise": "nominal, other noise",
    "excitation": "nominal, other excitation",
}
SHOWN = 12
STRUCTURES = ("nominal terms", "own", "nominal", "sister", "as it is")


def draw_terms(found: dict[str, Any]) -> Figure:
    """Shares of the terms chosen most often."""
    with styled():
        figure, axes = canvas(
            9.5,
            3.0 * -(-len(found) // 2),
            rows=-(-len(found) // 2),
            columns=min(2, len(found)),
        )
        for axis, (bed, answers) in zip(axes, found.items(), strict=False):
            share = dict(list(answers["terms"]["share"].items())[:SHOWN])
            at = np.arange(len(share))
            for group, colour in COLOURS.items():
                values = [100 * own[group] for own in share.values()]
                mark = "s" if group == "engine" else "o"
                axis.plot(values, -at, mark, color=colour, ms=4.5, label=SAID[group])
            axis.set_yticks(-at, [plain(term) for term in share], fontsize=7)
            axis.set_xlim(-3, 103)
            axis.set_title(f"{bed}: {BEDS[bed].output}")
            axis.set_xlabel("members with the term [%]")
        axes[0].legend(loc="lower right", fontsize=7)
    return figure


def draw_partitions(rows: list[Row], found: dict[str, Any]) -> Figure:
    """Refined centres of all members, one panel for each bed and group."""
    with styled():
        figure, axes = canvas(
            9.5,
            2.4 * len(found),
            rows=len(found),
            columns=3,
            sharex="row",
            sharey="row",
        )
        for line, bed in enumerate(found):
            names = BEDS[bed].settings["scheduling"]
            for axis, (group, colour) in zip(
                axes[3 * line :], COLOURS.items(), strict=False
            ):
                own = [
                    np.reshape(r["centre"], (-1, len(names)))
                    for r in rows
                    if r["bed"] == bed
                    and r["structure"] == "refined"
                    and r["engine"].startswith(group)
                    and r["centre"]
                ]
                points = np.concatenate(own)
                size = 4 if group == "engine" else 8
                axis.scatter(
                    *points.T, s=size, color=colour, alpha=0.5, lw=0, rasterized=True
                )
                axis.set_title(f"{bed}, {SAID[group]}: {len(own)}")
                axis.set_xlabel(plain(names[0]))
            axes[3 * line].set_ylabel(plain(names[1]))
    return figure


def draw_transfer(rows: list[Row]) -> Figure:
    """Test error with another's structure over that with the own one."""
    beds = list(dict.fromkeys(r["bed"] for r in rows))
    with styled():
        figure, axes = canvas(9.5, 3.2, columns=len(beds), sharey=True)
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
                f"{s} ({len(r)})" for s, r in zip(STRUCTURES, ratios, strict=True)
            ]
            axis.set_xticks(np.arange(len(labels)) + 1, labels, rotation=60, fontsize=7)
            axis.set_yscale("log")
            axis.set_title(f"{bed}: {BEDS[bed].output}")
        axes[0].set_ylabel("test NRMSE over that of\nown terms and regions, refined")
    return figure


def _ratios(score: dict[tuple[str, str], Any], structure: str) -> list[float]:
    """Over the engine's own refined network, where both run."""
    found = []
    for (name, engine), value in score.items():
        own = score.get(("refined", engine))
        if name == structure and None not in (value, own):
            found.append(value / own if np.isfinite([value, own]).all() else np.nan)
    return [x for x in found if np.isfinite(x)]
