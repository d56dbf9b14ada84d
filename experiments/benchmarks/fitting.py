"""Time to a peer's validation error, beside fastcan and jax-sysid.

On `cascaded_tanks` and `ced_coupled_drives`, the end of each estimation record kept
back for validation: a global polynomial of 12 terms chosen by forward OLS and refined
on the free run, beside fastcan's multi-step fit of the same terms and two of
jax-sysid's recurrent networks. All run on one processor, in turn, round by round. The
time of a peer is that of its whole fit; ours is that from the beginning of the choice
of terms to the first step whose validation RMSE is no larger than the peer's. Test
records are scored once, at the end, and decide nothing.

Without compilation we are there 13 to 63 times sooner in processor time; at fastcan's
own training optimum, which is ours too, 8 and 12 times. With compilation we are later,
by 2 to 26 times: a first fit takes 12 to 13 s, nearly all of it compiling. Sooner is
not better in the test: the larger network of jax-sysid wins the tanks, fastcan the
drives, where validation prefers an early step of the search.

    python experiments/benchmarks/fitting.py --peers python_with_fastcan python_with_jax
"""

import argparse
import json
import os
import statistics
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from common import record, results_folder, worker
from fitting_data import SETS
from fitting_workers import WORKERS

ROUNDS, LIMIT, GAIN = 3, 900.0, 10.0
"""Rounds, seconds after which a peer is stopped, and the ratio aimed at."""

SIZES = {"jax-sysid, small": 1, "jax-sysid, documented": 5}
"""Neurons in each of the two layers."""

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

NOTES = {
    "times": "wall and processor seconds on one processor, imports not counted",
    "first": "the first fit of a process, compilation counted",
    "again": "without compilation: the same call once more (jaxnarx, fastcan), or less "
    "a fit of two steps, which is compilation and little else (jax-sysid)",
    "jaxnarx": "from the beginning of the choice of terms; every step is judged on the "
    "validation records, which is counted",
    "from_terms": "the same without the choice of terms, as fastcan is given them",
    "history": "the steps of the search that improved on all before",
    "validation of jax-sysid": "continues the training run, so its state needs no "
    "start; other runs begin with as many measured samples as the protocol allows, for "
    "jax-sysid by its own filter (`learn_x0`)",
    "ratio": "median over rounds of the peer's time over ours; null where not reached",
    "terms": "10, because with 12 fastcan's fit of the tanks runs away in validation "
    "(8e8 V), and any ratio would be met; not chosen by test errors",
    "optimum": "search on whole training records alone, no ridge, no validation: the "
    "problem fastcan solves; time from the chosen terms to within 0.1 % of its "
    "training RMSE",
    "rounds": "jax-sysid starts from another seed in each",
}


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description="Benchmark of fitting.")
    parser.add_argument("--smoke", action="store_true", help="few steps, one round")
    parser.add_argument(
        "--peers",
        nargs="+",
        default=[],
        metavar="PYTHON",
        help="compare with the peers these interpreters have",
    )
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    parser.add_argument("--note", default="", help="a remark kept with the figures")
    parser.add_argument("--worker", nargs=2, metavar=("NAME", "JSON"))
    chosen = parser.parse_args()
    if chosen.worker:
        name, options = chosen.worker
        print(json.dumps(WORKERS[name](**json.loads(options))))
        return
    os.environ.update(dict.fromkeys(THREADS, "1"))
    folder = results_folder(chosen.results, smoke=chosen.smoke)
    pythons, versions = _find(chosen.peers)
    options = {"folder": folder, "versions": versions, "note": chosen.note}
    for figures in measure(pythons, smoke=chosen.smoke):
        print(record("fitting", figures, **options))
        show(figures)


def _find(interpreters: list[str]) -> tuple[dict[str, str], dict[str, str]]:
    """The interpreter of every peer that is there, and the versions."""
    pythons, versions = {}, {}
    for python in interpreters:
        found = _run("installed", python)
        pythons |= dict.fromkeys(found, python)
        versions |= found
    return pythons, versions


def _run(name: str, python: str = sys.executable, /, **options: Any) -> dict[str, Any]:
    result = _try(name, python, **options)
    if "failed" in result:
        raise SystemExit(f"the worker {name!r} failed: {result['failed']}")
    return result


def _try(name: str, python: str, /, **options: Any) -> dict[str, Any]:
    script, text = str(Path(__file__).resolve()), json.dumps(options)
    result, done = worker(script, "--worker", name, text, python=python, limit=LIMIT)
    if result is not None:
        return result
    return {"failed": (done.stderr.strip().splitlines() or ["stopped"])[-1]}


def measure(pythons: dict[str, str], *, smoke: bool) -> Iterator[dict[str, Any]]:
    """The figures after every round over the data sets."""
    data = Path(os.environ.get("JAXNARX_DATA", "../shared/data")).resolve()
    with tempfile.TemporaryDirectory() as temporary:
        sets = {
            name: _prepare(name, data, str(Path(temporary) / f"{name}.npz"))
            for name in list(SETS)[: 1 if smoke else None]
        }
        for n in range(1 if smoke else ROUNDS):
            for name, one in sets.items():
                if "skipped" not in one:
                    one["rounds"].append(_round(name, one, pythons, n, smoke))
                    one["rows"] = _rows(one["rounds"])
            yield {
                "notes": NOTES,
                "processors": 1,
                "peers": sorted(pythons) or "no peer is installed or asked for",
                "sets": {
                    name: {k: v for k, v in one.items() if k not in ("path", "factors")}
                    for name, one in sets.items()
                },
                "at_least": _aims(sets),
            }


def _prepare(name: str, data: Path, path: str) -> dict[str, Any]:
    if not (data / SETS[name]["file"]).is_file():
        return {"skipped": f"JAXNARX_DATA does not hold {name}"}
    prepared = _run("prepare", name=name, folder=str(data), path=path)
    return prepared | {"unit": SETS[name]["unit"], "path": path, "rounds": []}


def _round(
    name: str, one: dict[str, Any], pythons: dict[str, str], n: int, smoke: bool
) -> dict[str, Any]:
    """Every method once, in fresh processes."""
    options = {"name": name, "path": one["path"]}
    found = {"jaxnarx": _run("own", smoke=smoke, **options)}
    if (python := pythons.get("fastcan")) is not None:
        found["fastcan"] = _try("fastcan", python, factors=one["factors"], **options)
    if (python := pythons.get("jax-sysid")) is not None:
        for row, neurons in SIZES.items():
            found[row] = _try("jax-sysid", python, neurons=neurons, seed=n, **options)
    print(name, "round", n + 1, flush=True)
    return found


def _rows(rounds: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians over the rounds."""
    own = [one["jaxnarx"] for one in rounds]
    rows = {"jaxnarx": _summary([run["again"] for run in own])}
    rows["jaxnarx"] |= {
        key: _median_times([run[key]["total"] for run in own])
        for key in ("first", "again")
    }
    return rows | {peer: _against(peer, rounds) for peer in list(rounds[0])[1:]}


def _median(values: list[Any], digits: int = 4) -> float | None:
    """Median of `values`; None where one of them is missing."""
    if not values or any(value is None for value in values):
        return None
    return float(f"{statistics.median(values):.{digits}g}")


def _median_times(times: list[dict[str, float]]) -> dict[str, float | None]:
    return {kind: _median([t[kind] for t in times]) for kind in ("wall", "cpu")}


def _summary(runs: list[dict[str, Any]]) -> dict[str, Any]:
    parts = runs[0]["rmse"]
    return {
        "parameters": runs[0]["parameters"],
        "rmse": {p: _median([run["rmse"][p]["all"] for run in runs], 5) for p in parts},
        "test_records": [
            _median(list(values), 5)
            for values in zip(
                *(r["rmse"]["test"]["records"] for r in runs), strict=True
            )
        ],
    }


def _against(peer: str, rounds: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians of a peer, and how long we take to its validation error."""
    failures = [one[peer]["failed"] for one in rounds if "failed" in one[peer]]
    if failures:
        return {"failed": failures[0]}
    row = _summary([one[peer] for one in rounds])
    if peer == "fastcan":
        row["optimum"] = _optimum(rounds)
    for key in ("first", "again"):
        times = [one[peer][key] for one in rounds]
        ours, bare = [], []
        for one in rounds:
            found = _reached(one["jaxnarx"][key], one[peer]["rmse"]["validation"])
            ours.append(found[0])
            bare.append(found[1])
        row[key] = _median_times(times) | {
            "ours": _median_times(ours),
            "ratio": _ratios(times, ours),
            "ratio_from_terms": _ratios(times, bare),
            "reached_in": sum(t["wall"] is not None for t in ours),
        }
    return row


def _optimum(rounds: list[dict[str, Any]]) -> dict[str, Any]:
    """How long we take from the terms to fastcan's training error."""
    times = [one["fastcan"]["again"] for one in rounds]
    limits = [1.001 * one["fastcan"]["rmse"]["train"]["all"] for one in rounds]
    ours = [
        _reached(one["jaxnarx"]["optimum"], {"all": limit})[1]
        for one, limit in zip(rounds, limits, strict=True)
    ]
    runs = [one["jaxnarx"]["optimum"] for one in rounds]
    return {
        "ours": _median_times(ours),
        "ratio": _ratios(times, ours),
        "our_rmse": _summary(runs)["rmse"],
    }


def _reached(run: dict[str, Any], error: dict[str, Any]) -> tuple[dict[str, Any], ...]:
    """Our time to the error, from the beginning and from the chosen terms."""
    limit = float("inf") if error["all"] is None else error["all"]
    kinds = ("wall", "cpu")
    for row in run["history"]:
        if row["validation"] <= limit:
            total = {kind: row[kind] for kind in kinds}
            return total, {k: total[k] - run["selection"][k] for k in kinds}
    return dict.fromkeys(kinds), dict.fromkeys(kinds)


def _ratios(theirs: list[Any], ours: list[Any]) -> dict[str, float | None]:
    return {
        kind: _median(
            [
                None if b[kind] is None else a[kind] / b[kind]
                for a, b in zip(theirs, ours, strict=True)
            ],
            3,
        )
        for kind in ("wall", "cpu")
    }


def _aims(sets: dict[str, Any]) -> dict[str, Any]:
    """Ratios of processor time, with and without compilation, beside the aim."""
    aims = {}
    for name, one in sets.items():
        for peer, row in one.get("rows", {}).items():
            if peer == "jaxnarx" or "failed" in row:
                continue
            for key, text in (("first", "with"), ("again", "without")):
                value = row[key]["ratio"]["cpu"]
                aims[f"{peer}, {name}, {text} compilation"] = {
                    "value": value,
                    "at_least": GAIN,
                    "met": value is not None and value >= GAIN,
                }
    return aims


def show(figures: dict[str, Any]) -> None:
    """The table."""
    for name, one in figures["sets"].items():
        if "skipped" in one:
            print(one["skipped"])
            continue
        print(f"{name} [{one['unit']}], processor seconds first / again")
        for peer, row in one["rows"].items():
            if "failed" in row:
                print(f"  {peer:24s} failed: {row['failed']}")
                continue
            times = " / ".join(_text(row[k]["cpu"]) for k in ("first", "again"))
            rmse = row["rmse"]
            line = f"  {peer:24s}{row['parameters']:3d} parameters  {times:>17s} s"
            line += f"  validation {_text(rmse['validation'])}"
            line += f"  test {_text(rmse['test'])}"
            if peer != "jaxnarx":
                ratios = (_text(row[k]["ratio"]["cpu"]) for k in ("first", "again"))
                line += f"  ratio {' / '.join(ratios)}"
            print(line)
            if "optimum" in row:
                best = row["optimum"]
                texts = [_text(best["ratio"]["cpu"]), _text(best["our_rmse"]["train"])]
                print(f"    to its training optimum: ratio {' with '.join(texts)}")
    if isinstance(figures["peers"], str):
        print(figures["peers"])


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


if __name__ == "__main__":
    main()
