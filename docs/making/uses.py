"""Tables of what models are used for: control, calibration, adaptation."""

from typing import Any

from markdown_tables import RESULTS, loaded, number, source, table

CALIBRATED = "vct", "pfi", "gtdi", "diesel"
"""Beds of calibration."""
CONTROLLED = {
    "engine": "the engine of the records",
    "engine, efforts tuned": "the same, efforts tuned",
    "feedforward of chapter 7": "the same, by the inverse model alone",
    "without a limit": "the same, without a limit",
    "without preview": "the same, references known as they come",
    "constant references": "the same, behind steps of constant references",
    "sisters": "engines with other parameters",
    "sisters, efforts tuned": "these, efforts tuned",
    "sisters, constant": "these, behind steps of constant references",
}


def control() -> str:
    """Virtual engines steered by networks of their records, and what a step takes."""
    tracked = ""
    for stem, models in TRACKED.items():
        path, rows = RESULTS / f"{stem}.json", []
        for title, told in loaded(path)["figures"]["summary"].items():
            at = next((k for k in CONTROLLED if title.endswith(f", {k}")), None)
            if at is None:
                continue
            for name, value in told.items():
                left = name.endswith(", left")
                if name in SILENT_OF_CONTROL or left != ("constant" in at):
                    continue
                cells = number(value["median"]), number(value["worst"])
                task = title.removesuffix(f", {at}")
                rows.append([task, CONTROLLED[at], name.removesuffix(", left"), *cells])
        head = [f"bed and commands, {models}", "steered", "target", "median", "worst"]
        tracked += table(head, rows) + source(path) + "\n"
    speed = RESULTS / "control_speed.json"
    timed = loaded(speed)["figures"]
    times = [[name, number(v)] for name, v in timed.items() if isinstance(v, float)]
    return tracked + table(["a sample", ""], times) + source(speed)


def calibration() -> str:
    """Maps optimised through models, and what the engines made of them; then maps for
    a fleet."""
    told = []
    head = ["way", "promised", "realised", "missed", "at worst", "broken", "kept"]
    head += ["another cycle", "broken there"]
    for bed in CALIBRATED:
        path, rows = RESULTS / f"calibration_{bed}.json", []
        figures = loaded(path)["figures"]
        for way, one in figures["summary"].items():
            here, there = one["cycle"], one["another"]
            promised = one["objective, promised"]
            rows.append(
                [
                    way,
                    number(sorted(promised)[len(promised) // 2]),
                    number(here["objective, median"]),
                    number(100 * here["promise missed by, median"], 2),
                    number(100 * here["promise missed by, worst"], 2),
                    number(100 * max(here["limit broken by, worst"], 0.0), 2),
                    f"{here['limits kept to a percent']} of {len(promised)}",
                    number(there["objective, median"]),
                    number(100 * max(there["limit broken by, worst"], 0.0), 2),
                ]
            )
        told.append(f"### {bed}\n\n{table(head, rows)}{source(path)}")
    path = RESULTS / "calibration_robust.json"
    found = loaded(path)["figures"]
    fleet, names = found["summary"], list(next(iter(found["summary"].values())))
    rows = []
    for title, one in fleet.items():
        bed, way = title.split(", ", 1)
        seeds = [ways[way.rsplit(", ", 1)[0]] for ways in found["beds"][bed].values()]
        kept = sum(run["status"] != "infeasible" for run in seeds)
        cells = [number(one[n]) for n in names]
        rows.append([title, f"{kept} of {len(seeds)}", *cells])
    shares = table(["bed, way, cycle", "limits met on the models", *names], rows)
    return "\n".join([*told, f"### Fleets\n\n{shares}{source(path)}"])


def adaptation() -> str:
    """Free-run errors before and after adaptation, and what it takes in C."""
    path = RESULTS / "adaptation.json"
    told, rows = loaded(path)["figures"], []
    for bed, ways in told["summary"].items():
        for output in ways["as it was"]:
            cells = (number(ways[w][output]) for w in ADAPTED)
            rows.append([bed, output, *cells])
    tables = table(["engine", "output", *ADAPTED], rows) + source(path)
    ratios = [
        [bed, title.removeprefix("ratio to "), *_ratio(one)]
        for bed, ways in told["summary"].items()
        for title, one in ways.items()
        if title.startswith("ratio")
    ]
    head = ["engine", "error over that of", "median", "worst", "at most 1.2"]
    tables += "\n" + table(head, ratios) + source(path)
    timed = [
        [way, *(number(v) for v in one.values())]
        for way, one in told["c"].items()
        if isinstance(one, dict)
    ]
    names = next(one for one in told["c"].values() if isinstance(one, dict))
    return tables + "\n" + table(["in C", *names], timed) + source(path)


ADAPTED = "as it was", "adapted", "refit of the minute", "identified anew"


def _ratio(told: dict[str, Any]) -> list[str]:
    return [number(told["median"]), number(told["worst"]), told["at most 1.2"]]


TRACKED = {
    "control_tracking": "model of cubic terms",
    "control_tracking_identified": "model of the search",
}
"""Results of tracking, and the models that steered."""
SILENT_OF_CONTROL = ("seconds", "largest excess")
"""Figures that the table leaves out."""
