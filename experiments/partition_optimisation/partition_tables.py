"""Tables of the partitions: curves over models, starts beside the best, comparisons."""

import sys
from pathlib import Path
from typing import Any

import numpy as np

from jaxnarx.sweep import paired_comparison

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "fleets"))
from fleet_runs import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    Row,
    compared,
    rounded,
    spread,
    table_of,
)

BEST = "best found"
STARTS = ("scattered", "random", "cluster")
GREEDY = ("lolimot", "tree")


def chosen(rows: list[Row]) -> list[Row]:
    """Of every member the refined start that its validation record prefers: of each
    kind of start, and of all, the greedy ones too, with the same number of models."""
    drawn = [r for r in rows if r["partition"] in STARTS and r["train"] == "staged"]
    sizes = {r["models"] for r in drawn}
    greedy = [
        r
        for r in rows
        if r["partition"] in GREEDY and r["train"] == "staged" and r["models"] in sizes
    ]
    kinds = {
        f"{kind}, chosen": [r for r in drawn if r["partition"] == kind]
        for kind in STARTS
    }
    kinds[BEST] = drawn + greedy
    return [best for kind, own in kinds.items() for best in preferred(own, kind)]


def preferred(rows: list[Row], kind: str) -> list[Row]:
    """The row of every member with the least validation error, as one of `kind`.

    A run that diverges on the test record alone competes: the choice must not know.
    """
    groups: dict[tuple, list[Row]] = {}
    for r in rows:
        key = r["problem"], r["engine"], r["models"]
        groups.setdefault(key, []).append(r)
    best = [min(own, key=lambda r: r["validation_free_run"]) for own in groups.values()]
    return [r | {"from": r["partition"], "partition": kind} for r in best]


def curves(rows: list[Row]) -> list[dict[str, Any]]:
    """Test errors over the number of models, of the greedy partitions."""
    groups: dict[tuple, list[Row]] = {}
    for r in rows:
        if r["partition"] in GREEDY:
            key = r["problem"], r["partition"], r["train"], r["models"]
            groups.setdefault(key, []).append(r)
    names = ("problem", "partition", "train", "models")
    return [
        dict(zip(names, key, strict=True))
        | {"free_run": spread(own), "one_step": spread(own, "test_one_step")}
        for key, own in groups.items()
    ]


def needed(rows: list[Row]) -> list[dict[str, Any]]:
    """Fewest models of every way that reach the median test error of 8 models of
    LOLIMOT with refined coefficients, and of LOLIMOT as grown; None: none does."""
    medians = {
        (c["problem"], c["partition"], c["train"], c["models"]): c["free_run"].get(
            "median", np.inf
        )
        for c in curves(rows)
    }
    ways = dict.fromkeys(key[:3] for key in medians)
    found = []
    for problem, partition, train in ways:
        own = {
            k[3]: v for k, v in medians.items() if k[:3] == (problem, partition, train)
        }
        row: dict[str, Any] = {
            "problem": problem,
            "partition": partition,
            "train": train,
        }
        for name, aim in (("as grown", "none"), ("coefficients", "coefficients")):
            aims = [v for k, v in medians.items() if k[:3] == (problem, "lolimot", aim)]
            good = [m for m, v in own.items() if v <= min(aims)]
            row[f"to reach LOLIMOT {name}"] = {
                "error": rounded(min(aims)),
                "models": min(good, default=None),
            }
        found.append(row)
    return found


def starts(rows: list[Row]) -> list[dict[str, Any]]:
    """Spread of every kind of start at the number of models where all are tried; for
    the greedy ones the share of drawn starts that end better."""
    sizes = {r["models"] for r in rows if r["partition"] in STARTS}
    groups: dict[tuple, list[Row]] = {}
    for r in rows:
        if r["models"] in sizes:
            key = r["problem"], r["partition"], r["train"]
            groups.setdefault(key, []).append(r)
    found = []
    for (problem, partition, train), own in groups.items():
        row = {"problem": problem, "partition": partition, "train": train}
        row |= {"free_run": spread(own), "one_step": spread(own, "test_one_step")}
        if partition in GREEDY and train == "staged":
            row["share of drawn starts that end better"] = beaten(rows, own)
        if partition == BEST:
            kinds = [r["from"] for r in own]
            row["from"] = {kind: kinds.count(kind) for kind in dict.fromkeys(kinds)}
        found.append(row)
    return found


def beaten(rows: list[Row], greedy: list[Row]) -> dict[str, float]:
    """Share of refined drawn starts of the same member with a smaller error."""
    shares: dict[str, list[bool]] = {"validation": [], "test": []}
    for one in greedy:
        for r in rows:
            same = (r["problem"], r["engine"]) == (one["problem"], one["engine"])
            if same and r["partition"] in STARTS and r["train"] == "staged":
                for name, found in shares.items():
                    found.append(r[f"{name}_free_run"] < one[f"{name}_free_run"])
    return {k: rounded(float(np.mean(v))) for k, v in shares.items() if v}


def comparisons(rows: list[Row]) -> list[dict[str, Any]]:
    """Pairs over all problems and members, resampled by member."""
    ways = [r | {"how": f"{r['partition']}, {r['train']}"} for r in rows]
    # A single model has no partition: it would count as a tie.
    table = table_of([r for r in ways if r["models"] > 1])
    sizes = {r["models"] for r in rows if r["partition"] in STARTS}
    asked = [
        *((f"{g}, coefficients", f"{g}, staged", ["models"]) for g in GREEDY),
        *(
            (f"{s}, coefficients", f"{s}, staged", ["seed"])
            for s in ("random", "cluster")
        ),
        ("lolimot, none", "tree, none", ["models"]),
        ("lolimot, coefficients", "tree, coefficients", ["models"]),
        ("lolimot, staged", "tree, staged", ["models"]),
        *(("lolimot, staged", f"{s}, chosen, staged", ["models"]) for s in STARTS),
        ("lolimot, staged", f"{BEST}, staged", ["models"]),
        ("tree, staged", f"{BEST}, staged", ["models"]),
    ]
    there = set(table.column("how").tolist())
    found = []
    for before, after, more in asked:
        if {before, after} <= there:
            own = table.where(how=[before, after])
            own = own if more == ["models"] else own.where(models=list(sizes))
            settings = {
                "factor": "how",
                "levels": (before, after),
                "by": "test_free_run",
            }
            pair = ["problem", "engine", *more]
            block = ["problem", "engine"]
            both = paired_comparison(own, pair=pair, block=block, **settings)
            found.append({"of": after, "to": before, **compared(both)})
    return found
