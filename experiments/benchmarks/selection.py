"""Time, memory and matrix product rate of term selection, and peers on the same data.

41 lagged variables, degree 2 (903 terms) and 3 (13,244), 1,000 to 100,000 samples, 15
terms chosen, the pool counted; for this package also a million samples, where a dense
pool would take 106 GB. With `--peers` the same choice by SysIdentPy (FROLS), fastcan
(FastCan, LazyFastCan) and pysindy (STLSQ), in the same run and on the same numbers.

    python experiments/benchmarks/selection.py
    python experiments/benchmarks/selection.py --peers path/to/venv/bin/python
    python experiments/benchmarks/selection.py --cells 10000,3 --peers ...

It fails when SysIdentPy chooses other ordered terms in any cell that it can run.
"""

import dataclasses
import json
import math
import tempfile
from pathlib import Path
from typing import Any

from common import (
    available_memory,
    benchmark_parser,
    child,
    record,
    results_folder,
    target,
    worker,
)
from selection_data import TERMS, VARIABLES
from selection_workers import PEERS, WORKERS

LIMITS = {(100_000, 3): (4.0, 300.0), (1_000_000, 3): (60.0, 1000.0)}
"""Targets by (samples, degree): seconds after compilation, MB above the imports."""

RATIOS = {"SysIdentPy FROLS": 30.0, "fastcan FastCan": 15.0}
"""Targets at 10,000 samples, degree 3: the peer's wall time over ours, compiled."""

SHARE = 0.6
"""Target of the bare pass: nominal operations over the rate of matrix products."""

PEER_LIMIT = 300.0
"""Seconds after which a peer is stopped."""

COPIES = 6
"""Sizes of the pool that must be free before a dense peer is started."""

ALONE = 1_000_000
"""Samples from which the peers are not tried."""

SAME_TERMS = "SysIdentPy FROLS"
"""The peer whose ordered terms must be ours in every cell."""

NOTES = {
    "scope": (
        "from arrays to terms: dataset, pool, rows and search; imports excluded. "
        "Ratios are the peer's one call over the first call of jaxnarx, which "
        "compiles, and over the median of those after it; wall and processor time"
    ),
    "memory": (
        "peak of the process during the first call, compilation included, less its "
        "memory after the imports; reading the data is in it and stated by itself"
    ),
    "share": (
        "nominal operations of one bare pass, 2 * left rows * right variables * "
        "samples, per second over the faster of jax's and numpy's float64 matrix "
        "products; the package computes the part `computed` of them"
    ),
    "pysindy": (
        "sparse regression of the output on the polynomial library of the lagged "
        "variables, threshold 0.1: it has no order and no number of terms, so its "
        "terms are recorded and not compared"
    ),
}

Cell = tuple[int, int]


@dataclasses.dataclass(frozen=True)
class Sizes:
    """Cells (samples, degree), and how often and on what the bare pass is timed."""

    cells: tuple[Cell, ...]
    repeats: int
    contract: dict[str, int]


FULL = Sizes(
    tuple((n, d) for n in (1_000, 10_000, 100_000) for d in (2, 3)) + ((ALONE, 3),),
    3,
    {"samples": 100_000, "degree": 3, "repeats": 9, "matrix": 2048},
)
SMOKE = Sizes(
    ((1_000, 2),), 1, {"samples": 1_500, "degree": 2, "repeats": 1, "matrix": 256}
)


def main() -> None:
    """Run what the command line asks for."""
    parser = benchmark_parser("Benchmark of term selection.", "small, in seconds")
    parser.add_argument(
        "--cells",
        nargs="+",
        type=_cell,
        metavar="SAMPLES,DEGREE",
        help="only these, and no bare pass; use with --results",
    )
    parser.add_argument(
        "--bare", action="store_true", help="only the bare pass, a record of its own"
    )
    chosen = parser.parse_args()
    if chosen.worker:
        name, options = chosen.worker
        print(json.dumps(WORKERS[name](**json.loads(options))))
        return
    if chosen.cells and not chosen.results:
        parser.error("--cells needs --results: the record holds all cells")
    sizes = SMOKE if chosen.smoke else FULL
    if chosen.cells:
        sizes = dataclasses.replace(sizes, cells=tuple(chosen.cells), contract={})
    if chosen.bare:
        folder = results_folder(chosen.results, smoke=chosen.smoke)
        figures = _run("contract", **sizes.contract)
        print(record("selection_pass", figures, folder=folder, note=chosen.note))
        print(json.dumps(figures, indent=1))
        return
    versions = _installed(chosen.peers) if chosen.peers else {}
    figures = measure(sizes, chosen.peers, versions)
    folder = results_folder(chosen.results, smoke=chosen.smoke)
    print(
        record("selection", figures, folder=folder, versions=versions, note=chosen.note)
    )
    show(figures)
    if figures["other_terms"]:
        raise SystemExit(
            f"{SAME_TERMS} chose other ordered terms in: "
            + ", ".join(figures["other_terms"])
        )


def _cell(text: str) -> Cell:
    samples, degree = text.split(",")
    return int(samples), int(degree)


def _run(name: str, **options: Any) -> dict[str, Any]:
    script = Path(__file__).resolve()
    result, done = worker(str(script), "--worker", name, json.dumps(options))
    if result is None:
        raise SystemExit(f"the worker {name!r} failed:\n{done.stderr}")
    return result


def _installed(python: str) -> dict[str, str]:
    done = child([python, __file__, "--worker", "installed", "{}"])
    return json.loads(done.stdout) if done.code == 0 else {}


# Measuring ---------------------------------------------------------------------------


def measure(
    sizes: Sizes, python: str | None, versions: dict[str, str]
) -> dict[str, Any]:
    """The bare pass, every cell, and the targets they have."""
    figures: dict[str, Any] = {
        "variables": VARIABLES,
        "terms": TERMS,
        "notes": NOTES,
        "peers": "measured" if versions else "no peer is installed or asked for",
        "contraction": _run("contract", **sizes.contract) if sizes.contract else None,
        "cells": {},
    }
    with tempfile.TemporaryDirectory() as temporary:
        data = Path(temporary) / "data.npz"
        for cell in sizes.cells:
            name = _name(cell)
            figures["cells"][name] = one = _measure_cell(
                cell, sizes.repeats, data, python if versions else None, versions
            )
            print(f"{name}: {one['jaxnarx']['first']['compiled']}", flush=True)
    figures["other_terms"] = [
        name
        for name, one in figures["cells"].items()
        if one.get("peers", {}).get(SAME_TERMS, {}).get("same_ordered_terms") is False
    ]
    return figures | {"targets": _targets(figures), "at_least": _at_least(figures)}


def _name(cell: Cell) -> str:
    samples, degree = cell
    return f"{samples} samples, degree {degree}"


def _measure_cell(
    cell: Cell, repeats: int, data: Path, python: str | None, versions: dict[str, str]
) -> dict[str, Any]:
    samples, degree = cell
    compared = python is not None and samples < ALONE
    made = _run("data", path=str(data), samples=samples)
    own = {
        constant: _run(
            "select",
            path=str(data),
            degree=degree,
            constant=constant,
            repeats=repeats if samples < ALONE else 1,
        )
        for constant in (("first", "candidate") if compared else ("first",))
    }
    candidates = own["first"]["candidates"]
    result = {
        "samples": samples,
        "degree": degree,
        "candidates": candidates,
        "dense_pool_gb": round(8e-9 * samples * candidates, 2),
        "data_generation_s": made["seconds"],
        "jaxnarx": own,
    }
    if python is None or not compared:
        return result
    peers = {name: _peer(name, cell, data, python, versions, own) for name in PEERS}
    return result | {"peers": peers}


def _peer(
    name: str,
    cell: Cell,
    data: Path,
    python: str,
    versions: dict[str, str],
    own: dict[str, Any],
) -> dict[str, Any]:
    key, package, constant, dense = PEERS[name]
    samples, degree = cell
    if package not in versions:
        return {"skipped": f"{package} is not installed"}
    need = 8 * COPIES * math.comb(VARIABLES + degree, degree) * samples
    if dense and need > available_memory():
        return {"skipped": f"needs about {need / 1e9:.1f} GB of free memory"}
    arguments = [key, json.dumps({"path": str(data), "degree": degree})]
    script = str(Path(__file__).resolve())
    result, done = worker(
        script, "--worker", *arguments, python=python, limit=PEER_LIMIT
    )
    if result is None:
        if done.wall >= PEER_LIMIT:
            return {"skipped": f"stopped after {PEER_LIMIT:g} s"}
        return {"failed": (done.stderr.strip().splitlines() or ["no message"])[-1]}
    mine = own[constant or "first"]
    result |= {
        "ratio_to_first_call": _ratio(result, mine["first_call"], "wall_s"),
        "ratio_to_compiled": _ratio(result, mine["compiled"], "wall_s"),
        "processor_ratio_to_compiled": _ratio(result, mine["compiled"], "cpu_s"),
    }
    return result | (_agreement(result["chosen"], mine, constant) if constant else {})


def _ratio(peer: dict[str, Any], mine: dict[str, Any], key: str) -> float:
    # Below a clock tick of processor time nothing can be said but "at least".
    return round(peer[key] / max(mine[key], 1e-3), 2)


def _agreement(chosen: list[str], mine: dict[str, Any], constant: str):
    equal = [a == b for a, b in zip(chosen, mine["chosen"], strict=False)]
    return {
        "constant": constant,
        "same_ordered_terms": chosen == mine["chosen"],
        "equal_up_to": equal.index(False) if False in equal else len(equal),
    }


def _targets(figures: dict[str, Any]) -> dict[str, Any]:
    """Figures that have an upper limit."""
    found = {}
    for cell, (seconds, megabytes) in LIMITS.items():
        if (one := figures["cells"].get(_name(cell))) is not None:
            run = one["jaxnarx"]["first"]
            found[f"{_name(cell)}, s"] = target(run["compiled"]["wall_s"], seconds)
            found[f"{_name(cell)}, MB"] = target(
                run["memory"]["above_imports_mb"], megabytes
            )
    return found


def _at_least(figures: dict[str, Any]) -> dict[str, Any]:
    """Figures that have a lower limit."""
    found = {}
    if (bare := figures["contraction"]) is not None:
        found["share of the matrix product rate"] = _above(bare["share"], SHARE)
    peers = figures["cells"].get(_name((10_000, 3)), {}).get("peers", {})
    for name, ratio in RATIOS.items():
        if "ratio_to_compiled" in peers.get(name, {}):
            found[f"times {name}"] = _above(peers[name]["ratio_to_compiled"], ratio)
    return found


def _above(value: float, limit: float) -> dict[str, Any]:
    return {"value": value, "at_least": limit, "met": value >= limit}


# Tables ------------------------------------------------------------------------------


def show(figures: dict[str, Any]) -> None:
    """Everything as text."""
    if (bare := figures["contraction"]) is not None:
        print(
            f"one pass {bare['pass_s']} s, {bare['nominal_gflops']} GFLOP/s nominal, "
            f"{bare['share']} of the matrix product rate; symmetry gains "
            f"{bare['gain_of_symmetry']} times; {bare['vectors']} vectors at once: "
            f"{bare['share_with_vectors']}"
        )
    print(f"{'wall [s]':>30s}{'CPU [s]':>10s}{'MB':>8s}{'ratio':>9s}")
    for name, cell in figures["cells"].items():
        print(f"{name}: {TERMS} of {cell['candidates']} terms")
        for constant, run in cell["jaxnarx"].items():
            _row(f"constant {constant}", run["compiled"], run["memory"], "")
        for peer, run in cell.get("peers", {}).items():
            if "wall_s" not in run:
                print(f"  {peer:20s} {run.get('skipped') or run.get('failed')}")
                continue
            same = {True: "same terms", False: "other terms"}
            said = same.get(run.get("same_ordered_terms"), "")
            _row(peer, run, run["memory"], f"{run['ratio_to_compiled']:8.1f} x  {said}")
    for name, one in (figures["targets"] | figures["at_least"]).items():
        print(f"{name}: {one['value']} ({'met' if one['met'] else 'missed'})")


def _row(name: str, times: dict[str, Any], used: dict[str, float], end: str) -> None:
    print(
        f"  {name:20s}{times['wall_s']:8.3f}{times['cpu_s']:10.3f}"
        f"{used['above_imports_mb']:8.0f}{end}"
    )


if __name__ == "__main__":
    main()
