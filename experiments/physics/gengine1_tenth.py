"""Signs of gains on a tenth of the records of a measured gasoline engine.

    python experiments/physics/gengine1_tenth.py [--runs DIR]

Two of the twenty training records train, with the preset `quick`, with the signs below
and without them. Everything is chosen on these two records; the six test records are
scored when both searches have ended. (They were scored once before, with the columns of
four outputs mistaken for others; the models are the same.) Wrong gains are counted at
operating points of all twenty training records, where the model's domain knows them:
mostly other points than those at which signs were asked.

The signs were written down before any result was seen. Channels are standardised, which
keeps signs; ignition is the advance, as control units count it.
"""

import argparse
import statistics
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax

import jaxnarx as jnx
from jaxnarx.data import match_channels
from jaxnarx.identification import Physics

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / folder) for folder in ("gengine1", "benchmarks")]
from common import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    ROOT,
    record,
    results_folder,
)
from identify import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    DESCRIPTION,
    errors,
    shown,
    small,
)

SIGNS = {
    "PN": (Physics(decreases_with=["lambda"]), "soot forms where the mixture is rich"),
    "CO": (Physics(decreases_with=["lambda"]), "air that is missing leaves CO"),
    "NOx": (
        Physics(increases_with=["load", "ignition"]),
        "a fuller cylinder and an earlier spark burn hotter",
    ),
    "O2": (Physics(increases_with=["lambda"]), "air that is not needed remains"),
    "T_exhaust": (
        Physics(increases_with=["speed", "load"], decreases_with=["ignition"]),
        "more fuel in less time; an earlier spark leaves less heat to the exhaust",
    ),
    "T_catalyst": (
        Physics(increases_with=["speed", "load"]),
        "it is heated by the exhaust gas",
    ),
}
"""Signs and their reasons. CO2 has its peak where the mixture burns fully, and unburnt
hydrocarbons rise on either side of it: nothing is asked of them."""
EVERY = 10
"""Every tenth record trains."""
POINTS = 200
"""Operating points at which gains are counted."""
MOST_LOSS = 0.02
"""Share of its error that an output may lose."""


def row_of(
    fits: dict[str, Any],
    name: str,
    data: jnx.Dataset,
    scores: dict[str, Any],
    points: int,
) -> dict[str, Any]:
    """Compare what was chosen for an output with signs and without, and its errors."""
    physics, reason = SIGNS[name]
    out: dict[str, Any] = {"output": name, "asked": str(physics), "reason": reason}
    for how, fit in fits.items():
        row = fit.stats["leaderboard"].choose(name)
        counted = jnx.evaluation.count_wrong_signs(
            fit.value, data, {name: physics}, points=points
        )[name]
        out[how] = {
            "chosen": f"{row.family}: {row.name}",
            "cross-validated": row.free_run,
            "nested": row.nested,
            "the same without constraints": row.unconstrained,
            "changed": row.detail,
            "test": scores[how][name]["free_run"],
            "wrong gains": counted.wrong,
            "known gains": counted.known,
        }
    before, after = (out[how]["test"]["nrmse"] for how in ("without", "with"))
    return out | {"change": after / before - 1}


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The aims, and whether they are met."""
    medians = {
        how: statistics.median(row[how]["test"]["nrmse"] for row in rows)
        for how in ("without", "with")
    }
    wrong = {how: sum(row[how]["wrong gains"] for row in rows) for how in medians}
    changes = [row["change"] for row in rows]
    return {
        "median NRMSE on test records": medians,
        "wrong gains": wrong | {"known": sum(r["with"]["known gains"] for r in rows)},
        "median change": statistics.median(changes),
        "worst change": max(changes),
        "no wrong gain": wrong["with"] == 0,
        "median is lower": medians["with"] < medians["without"],
        "none is over 2 % worse": max(changes) <= MOST_LOSS,
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Search with signs and without, count, score, record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=Path, default=ROOT / "runs", metavar="DIR")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    parser.add_argument("--smoke", action="store_true", help="one output, few samples")
    options = parser.parse_args(arguments)
    jax.config.update("jax_enable_x64", True)
    split = jnx.read_split(DESCRIPTION)
    assert split.train is not None and split.test is not None
    every, test, preset, points = split.train, split.test, "quick", POINTS
    if options.smoke:
        every, test, preset, points = small(every), small(test[:1]), "linear", 10
    names = [n for n in every.channels.output_names if n in SIGNS]
    signs = {name: SIGNS[name][0] for name in names}
    fits = {}
    for how, physics in (("without", None), ("with", signs)):
        fits[how] = jnx.identify(
            every[::EVERY],
            preset=preset,
            outputs=names,
            physics=physics,
            folder=options.runs / f"physics-gengine1-{preset}-{how}",
            progress=shown,
        )
    # `errors` takes outputs by their places: the network has no others than these.
    scores = {
        how: errors(fit.value, match_channels(test, fit.value.channels)[0])
        for how, fit in fits.items()
    }
    rows = [row_of(fits, name, every, scores, points) for name in names]
    for row in rows:
        figures = [row[how]["test"]["nrmse"] for how in ("without", "with")]
        gains = [row[how]["wrong gains"] for how in ("without", "with")]
        print(f"{row['output']:10s} NRMSE {figures}, wrong gains {gains}")
    print(summary(rows))
    record(
        "physics_gengine1",
        {"preset": preset, "rows": rows, "summary": summary(rows)},
        folder=results_folder(options.results, smoke=options.smoke),
    )


if __name__ == "__main__":
    main()
