"""Tables of performance, accuracy and reliability, from the recorded results alone.

No figure is typed: each table says which file it comes from, when that was made, on
what machine, and from which commit.
"""

from collections.abc import Callable, Iterator
from typing import Any

from markdown_tables import (
    EXPERIMENTS,
    RESULTS,
    give_or_take,
    loaded,
    number,
    source,
    table,
)
from uses import CALIBRATED, adaptation, calibration, control

ELSEWHERE = (
    *(f"calibration_{bed}" for bed in CALIBRATED),
    "calibration_robust",
    "adaptation",
    "bouc_wen",
    "control_speed",
    "control_tracking",
    "control_tracking_identified",
    "coverage",
    "coverage_coloured",
    "gengine1_identify",
    "recovery",
)
"""Results that are told in tables of their own."""


SILENT = ("aim", "aims", "at_least", "limits", "targets")
"""Names that say no more than that there is an aim."""


def made() -> dict[str, str]:
    """Every table, as a part of a page, by its file name."""
    parts: dict[str, Callable[[], str]] = {
        "_aims.md": aims,
        "_gengine1.md": gengine1,
        "_open_sets.md": open_sets,
        "_public.md": public,
        "_control.md": control,
        "_adaptation.md": adaptation,
        "_calibration.md": calibration,
        "_recovery.md": recovery,
        "_nelles.md": nelles,
        "_gains.md": gains,
        "_cubic.md": cubic,
        "_engine_sweep.md": engine_sweep,
        "_coverage.md": coverage,
        "_edge.md": edge,
        "_plans.md": plans,
        "_promised.md": promised,
        "_refinement.md": refinement,
    }
    return {name: part() for name, part in parts.items()}


# Performance ----------------------------------------------------------------------


def aims() -> str:
    """Every aim of every benchmark, and whether it is met."""
    told = []
    for path in sorted(RESULTS.glob("*.json")):
        if path.stem in ELSEWHERE:
            continue
        rows = [
            [name, number(aim["value"]), _limit(aim), "yes" if aim["met"] else "**no**"]
            for name, aim in _aims(loaded(path)["figures"], ())
        ]
        if rows:
            head = ["what", "measured", "aim", "met"]
            told.append(f"## {path.stem}\n\n{table(head, rows)}{source(path)}")
    return "\n".join(told)


def _aims(value: Any, names: tuple[str, ...]) -> Iterator[tuple[str, dict[str, Any]]]:
    if not isinstance(value, dict):
        return
    if {"value", "met"} <= value.keys():
        yield ", ".join(n for n in names if n not in SILENT), value
        return
    for name, part in value.items():
        yield from _aims(part, (*names, str(name)))


def _limit(aim: dict[str, Any]) -> str:
    if "at_least" in aim:
        return f"≥ {number(aim['at_least'])}"
    return f"≤ {number(aim['limit'])}"


# Accuracy -------------------------------------------------------------------------


def gengine1() -> str:
    """The measured engine: every output by every preset, beside others."""
    path = RESULTS / "gengine1_identify.json"
    figures = loaded(path)["figures"]
    presets = list(figures)
    rows = []
    for n, row in enumerate(figures["good"]["rows"]):
        own = [figures[p]["rows"][n] for p in presets]
        rows.append(
            [
                row["output"],
                number(row["test"]["one_step"]["rmse"], 2),
                *(number(r["test"]["free_run"]["rmse"]) for r in own),
                *(number(row["beside"][k]) for k in ("trees", "LSTM", "by hand")),
                number(row["operations"]),
            ]
        )
    means = {p: figures[p]["summary"]["mean NRMSE"] for p in presets}
    good = means["good"]
    rows.append(
        ["mean NRMSE", "", *(number(means[p]["jaxnarx"]) for p in presets)]
        + [number(good[k]) for k in ("trees", "LSTM", "by hand")]
        + [""]
    )
    head = ["output", "one step", *presets, "trees", "LSTM", "by hand", "operations"]
    return table(head, rows) + source(path)


def open_sets() -> str:
    """Public sets and virtual engines, 32 outputs, by the same command."""
    path = RESULTS / "open_sets.json"
    rows = []
    for row in loaded(path)["figures"]["rows"]:
        part = next(iter(row["jaxnarx"]["test"]))
        columns = ("jaxnarx", "best linear", "trees", "SysIdentPy BIC")
        tests = [(row.get(c) or {}).get("test", {}).get(part) or {} for c in columns]
        left_out = row["jaxnarx"]["free_run"], row["jaxnarx"]["standard_error"]
        rows.append(
            [
                f"{row['set']} {row['output']}",
                row["jaxnarx"]["family"],
                give_or_take(*(number(v, 2) for v in left_out if v is not None)),
                *(number(test.get("nrmse")) for test in tests),
            ]
        )
    head = ["set", "chosen", "left out", "test", "linear", "trees", "SysIdentPy, BIC"]
    return table(head, rows) + source(path)


def public() -> str:
    """Public sets beside published figures and peers; NRMSE of whole tests."""
    path = RESULTS / "public.json"
    rows = []
    columns = ("hidden states", "identify", "GRU", "jax-sysid", "fastcan")
    figures = loaded(path)["figures"]
    for row in figures["rows"]:
        for part in row["hidden states"]["test"]:
            found = [
                (row.get(c) or {}).get("test", {}).get(part, {}).get("rmse")
                for c in columns
            ]
            known = [
                entry["rmse"][part]
                for entry in figures["published"].get(row["set"], [])
                if entry["rmse"].get(part) is not None
            ]
            name = f"{row['set']} {row['output']}, {part} [{row['unit']}]"
            best = number(min(known)) if known else "–"
            rows.append([name, *map(number, found), best])
    head = ["set, part [unit]", *columns, "published, best found"]
    return table(head, rows) + source(path)


def recovery() -> str:
    """How often the exact set of true terms is found."""
    path = RESULTS / "recovery.json"
    cells = loaded(path)["figures"]["cells"]
    methods = list(next(iter(cells.values()))["methods"])
    rows = [
        [m, *(f"{c['methods'][m]['exact']} of {c['seeds']}" for c in cells.values())]
        for m in methods
    ]
    return table(["method", *cells], rows) + source(path)


def nelles() -> str:
    """Four test processes with noise: LOLIMOT as grown, and refined."""
    path = EXPERIMENTS / "nelles" / "results" / "nelles_processes.json"
    rows = []
    for name, row in loaded(path)["figures"]["summary"].items():
        kinds = [k for k in ("LOLIMOT", "joint", "staged") if k in row]
        cells = [_spread(row[k]["free_run"]) for k in kinds]
        lost = sum(row[k]["diverged"] for k in kinds)
        rows.append([name, *cells, str(lost)])
    head = ["process", "LOLIMOT", "refined jointly", "refined in stages", "diverged"]
    return table(head, rows) + source(path)


def _spread(row: dict[str, float]) -> str:
    ends = number(row["least"], 2), number(row["largest"], 2)
    return f"{number(row['median'])} ({ends[0]} to {ends[1]})"


def gains() -> str:
    """What refinement of everything gains over LOLIMOT on virtual engines."""
    path = EXPERIMENTS / "refinement" / "results" / "engines.json"
    rows = [
        [
            bed,
            str(row["seeds"]),
            number(row["median_gain"]),
            number(row["worst_gain"]),
            str(row["validation_worse"]),
            f"{row['only_lolimot_diverged']} / {row['refined_diverged']}",
        ]
        for bed, row in loaded(path)["figures"]["summary"].items()
    ]
    head = ["bed", "seeds", "median factor", "worst", "validation worse"]
    return table([*head, "diverged before / after"], rows) + source(path)


def cubic() -> str:
    """One step says little: a cubic model of NOx, before and after the free run."""
    path = RESULTS / "gengine1.json"
    found = loaded(path)["figures"]["cubic NOx"]
    rows = []
    for name in found["free_run"]:
        one, free = (found[mode][name]["pooled"] for mode in ("one_step", "free_run"))
        run = number(free["rmse"], 2) if free["rmse"] else free["status"]
        rows.append([name, number(one["rmse"], 2), run])
    return table(["cubic model of NOx", "one step", "free run"], rows) + source(path)


def engine_sweep() -> str:
    """One model or four, and what refined borders are worth, on sister engines."""
    path = EXPERIMENTS / "engine_sweep" / "results" / "engine_sweep.json"
    beds = loaded(path)["figures"]["beds"]
    kinds = {
        "one model": "one model",
        "four regions": "LOLIMOT",
        "borders refined": "refined",
    }
    rows = []
    for bed, found in beds.items():
        scores = [found["test_free_run"][kind] for kind in kinds.values()]
        cells = [
            f"{number(s['median'])} ({number(s['p5'], 2)} to {number(s['p95'], 2)})"
            for s in scores
        ]
        ratio = found["comparisons"]["refined against LOLIMOT"]["ratio"]
        low, high = (number(v) for v in ratio[1:])
        rows.append([bed, *cells, f"{number(ratio[0])} [{low}, {high}]"])
    head = ["bed", *kinds, "borders refined over not"]
    return table(head, rows) + source(path)


# Reliability ----------------------------------------------------------------------


def coverage() -> str:
    """How many samples the 95 % bands cover."""
    told = []
    for name in ("coverage", "coverage_coloured"):
        path = RESULTS / f"{name}.json"
        figures = loaded(path)["figures"]
        parts = list(next(iter(figures["coverage"].values())))
        rows = [
            [kind, *(_share(row[part]) for part in parts)]
            for kind, row in figures["coverage"].items()
        ]
        noise = "white" if name == "coverage" else "coloured"
        title = f"**{noise} noise, {figures['sets']} simulated data sets**\n\n"
        told.append(title + table(["bands of", *parts], rows) + source(path))
    return "\n".join(told)


def _share(row: dict[str, Any]) -> str:
    miss = "" if row["met"] else " **(no)**"
    return (
        f"{100 * row['share']:.1f}\u00a0±\u00a0{100 * row['standard_error']:.1f}{miss}"
    )


def edge() -> str:
    """The 90 % intervals and the index of the domain, output by output."""
    path = RESULTS / "edge.json"
    rows = []
    for bed, entry in loaded(path)["figures"].items():
        for output, row in entry["outputs"].items():
            wild = [row[k]["wild"] for k in ("flag", "hold", "linear") if k in row]
            lost = sum(w["diverged"] + w["not finite"] for w in wild)
            rows.append(
                [
                    f"{bed} {output}",
                    f"{100 * row['intervals']['held']:.1f}",
                    number(row["intervals"]["half width"], 2),
                    number(row[row["policy"]]["spearman"], 2),
                    number(row["rate certified"]),
                    f"{lost} of {sum(w['records'] for w in wild):,}",
                ]
            )
    head = ["output", "held, %", "half width", "index and error"]
    return table([*head, "certified rate", "wild records lost"], rows) + source(path)


def plans() -> str:
    """A planned record beside one that fills the space, bed by bed."""
    path = RESULTS / "plans.json"
    rows = []
    for bed, entry in loaded(path)["figures"].items():
        (output,), seeds = entry["asked"]["limits"], entry["seeds"]
        outside = [100 * seed["outside"] for seed in seeds]
        rows.append(
            [
                f"{bed} {output}",
                *(number(entry[name]) for name in ("before", "filling", "plan")),
                number(entry["ratio, geometric mean"]),
                f"{entry['seeds with a lower error']} of {len(seeds)}",
                f"{entry['limit: plans that broke it']} of {len(seeds)}",
                f"{min(outside):.0f} to {max(outside):.0f}",
            ]
        )
    head = ["output", "before", "filling", "plan", "plan over filling"]
    head += ["lower error", "limit broken", "outside, %"]
    return table(head, rows) + source(path)


def promised() -> str:
    """Errors on test records over those promised by records left out."""
    path = RESULTS / "open_sets.json"
    summary = loaded(path)["figures"]["summary"]
    rows = [[name, number(value)] for name, value in summary["flattered by"].items()]
    note = (
        f"Of {summary['rows']} outputs {len(summary['diverged'])} diverge on a test "
        f"record, {len(summary['worse than linear'])} are worse than the best linear "
        f"model, and {len(rows)} are worse on the test than was promised:\n\n"
    )
    return note + table(["set and output", "test over left out"], rows) + source(path)


def refinement() -> str:
    """Accuracy of the measured engine: what was promised, what was kept."""
    path = RESULTS / "gengine1_identify.json"
    rows = []
    for row in loaded(path)["figures"]["good"]["rows"]:
        told, kept = row["cross_validated"], row["test"]["free_run"]["nrmse"]
        spread = (
            f"{number(told['chosen'])}\u00a0±\u00a0{number(told['standard_error'], 2)}"
        )
        ratio = number(kept / told["chosen"], 2)
        rows.append([row["output"], row["chosen"], spread, number(kept), ratio])
    head = ["output", "chosen", "left out", "test", "ratio"]
    return table(head, rows) + source(path)
