"""How long the search for a model takes, and how much memory, beside trees and FROLS.

Every part is a fresh process (the fourth is two):

    quick        `identify(data, preset="quick")` of 10,000 samples of a virtual engine,
                 one output: no program compiled before, and again.
    short        the same of 600 to 10,000 samples of a bed with two inputs: processor
                 seconds with no program compiled before, and again.
    one_input    `identify(data, preset="good")` of 1,000 samples of a bed with one
                 input, no program compiled before.
    engine       one output of `gengine1` (248,000 samples) by `quick` and by `good`, no
                 program compiled before; memory of the process and all that it starts.
                 With `--peers PYTHON` the same records by histogram gradient boosting
                 of scikit-learn on lagged inputs and by FROLS of SysIdentPy, on one
                 core, as the table of open sets is made (`../open_sets/peers.py`).
    equations    normal equations of 400 columns on 248,000 samples: from the factors
                 of the terms through feedback to products, as a share of the rate of a
                 matrix product of the same shapes, with one thread and with all.
    candidates   `identify(data, preset="best", candidates=100)` of 2,000 samples when
                 its programs are compiled. The preset has fewer than a hundred: seconds
                 of one are told, and a hundred times that.

    python experiments/benchmarks/search.py [--smoke] [--peers PYTHON] [--only PART ...]

Aims are those of two cores that do nothing else. Where something else runs, threads of
OpenBLAS wait for one another: OPENBLAS_NUM_THREADS=1 then, which is kept in the record.
On a machine with three others at work `quick` took 19 s so, and 121 s with two threads.
Columns formed all at once, as they were at first, make the whole of the normal
equations .44 of the rate of the matrix product; in pieces that the cache holds, .72.
"""

import json
import os
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any

from common import benchmark_parser, record, results_folder, target, worker
from search_workers import OUTPUT, SMALL, WORKERS

PARTS = ("quick", "short", "one_input", "equations", "candidates", "engine")
BED = "pfi-dyno"
TWO_INPUTS, SHORT, THREE = "pfi-cc", (600, 2_000, 10_000), 3
"""A bed, samples of all records together, and how many these are."""
ONE_INPUT, THOUSAND = "pfi", 1_000
"""A bed and the samples of its two records together."""
RECORDS, LENGTH, FEW = 4, 2500, 500
"""Records of the virtual engine, samples of each, and where candidates are counted."""
SAMPLES, COLUMNS, HUNDRED = 248_000, 400, 100
SMOKED = 4
"""Candidates of every search of a smoke run."""
COLD, WARM, GOOD = {600: 20.0, 10_000: 40.0}, {600: 10.0}, 120.0
"""Aims: processor seconds of `quick` on so many samples of two inputs with nothing
compiled and with everything, and of `good` on one input with nothing."""
QUICK, ENGINE, MEGABYTES = 40.0, {"quick": 90.0, "good": 360.0}, 2000.0
HALF, CANDIDATES = 0.5, 180.0
"""Aims: processor seconds of `quick`, of both presets and memory on the engine, share
of the matrix product rate, seconds of a hundred candidates."""
FROLS_SAMPLES = 10_000, 250_000
"""Samples that FROLS is given: as for the open sets, and all of them as it comes."""
LIMIT = 3600.0
WATCH = 0.1
"""Seconds between looks at the memory."""


def call(name: str, *arguments: Any, python: str = sys.executable) -> dict[str, Any]:
    """A worker's answer with its peak memory, or what it said when it failed."""
    script, text = str(Path(__file__).resolve()), json.dumps(arguments)
    with Memory() as memory:
        answer, done = worker(
            script, "--worker", name, text, python=python, limit=LIMIT
        )
    if answer is None:
        lines = done.stderr.strip().splitlines() or ["ended without a word"]
        return {"failed": lines[-1]}
    return answer | {
        "process_s": round(done.wall, 1),
        "peak_mb": round(max(done.peak, memory.peak) / 1e6),
    }


class Memory:
    """Largest resident memory of all processes below this one, looked at now and
    then [bytes]; Linux only."""

    def __init__(self):
        self.peak, self._end = 0, threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> "Memory":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._end.wait(WATCH):
            self.peak = max(self.peak, below(os.getpid()))


def below(process: int) -> int:
    """Resident memory of all processes that this one or its children started."""
    parents, sizes = {}, {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:  # it has ended
            continue
        number = int(path.parent.name)
        parents[number], sizes[number] = int(fields[1]), int(fields[21])
    family = {process}
    while more := {n for n, p in parents.items() if p in family} - family:
        family |= more
    pages = sum(sizes[n] for n in family - {process})
    return pages * os.sysconf("SC_PAGE_SIZE")


def quick(chosen: Any, space: Path) -> dict[str, Any]:
    """A virtual engine, with an empty folder of programs and with a full one."""
    sizes = [RECORDS, SMALL if chosen.smoke else LENGTH]
    preset, cache = "linear" if chosen.smoke else "quick", str(space / "quick")
    found: dict[str, Any] = {"engine": BED}
    for name in ("cold", "warm"):
        run = call("identify", BED, sizes, preset, cache, *limited(chosen))
        found[name] = run | aim(run, "processor_s", QUICK)
    return found


def short(chosen: Any, space: Path) -> dict[str, Any]:
    """Processor seconds of `quick`, with an empty folder of programs and a full one."""
    found: dict[str, Any] = {"engine": TWO_INPUTS}
    for samples in SHORT[:1] if chosen.smoke else SHORT:
        cache, preset = str(space / str(samples)), "linear" if chosen.smoke else "quick"
        sizes = [THREE, samples // THREE]
        for name, limits in (("cold", COLD), ("warm", WARM)):
            run = call("identify", TWO_INPUTS, sizes, preset, cache, *limited(chosen))
            if samples in limits:
                run |= aim(run, "processor_s", limits[samples])
            found[f"{samples} samples, {name}"] = run
            print(samples, name, json.dumps(run), flush=True)
    return found


def one_input(chosen: Any, space: Path) -> dict[str, Any]:
    """`good` with nothing compiled."""
    sizes = [2, SMALL if chosen.smoke else THOUSAND // 2]
    preset, cache = "linear" if chosen.smoke else "good", str(space / "one")
    run = call("identify", ONE_INPUT, sizes, preset, cache, *limited(chosen))
    return {"engine": ONE_INPUT} | run | aim(run, "processor_s", GOOD)


def limited(chosen: Any) -> tuple[bool, int | None]:
    """Whether records are cut, and most candidates."""
    return chosen.smoke, SMOKED if chosen.smoke else None


def engine(chosen: Any, space: Path) -> dict[str, Any]:
    """The measured engine by two presets, then by the peers."""
    if not (
        Path(os.environ.get("JAXNARX_DATA", "../shared/data")) / "gengine1"
    ).is_dir():
        return {"skipped": "gengine1 is not in JAXNARX_DATA"}
    found: dict[str, Any] = {}
    for preset, limit in ENGINE.items():
        name = "linear" if chosen.smoke else preset
        cache = str(space / name)
        run = call("identify", "gengine1", [], name, cache, *limited(chosen))
        found[preset] = run | aim(run, "processor_s", limit)
        if "peak_mb" in run:
            found[preset]["peak_mb_aim"] = target(run["peak_mb"], MEGABYTES)
        print(preset, json.dumps(found[preset]), flush=True)
    if chosen.peers:
        found["peers"] = compared(chosen, space, found)
    return found


def compared(chosen: Any, space: Path, ours: dict[str, Any]) -> dict[str, Any]:
    """The peers on the same records: seconds, and ours as a multiple of theirs."""
    have = call("installed", python=chosen.peers)
    path = str(space / "gengine1.npz")
    about = call("prepare", path, chosen.smoke)
    asked = {
        "trees": ("trees", "scikit-learn", 0),
        "FROLS": ("SysIdentPy", "sysidentpy", FROLS_SAMPLES[0]),
        "FROLS, all samples": ("SysIdentPy", "sysidentpy", FROLS_SAMPLES[1]),
        "FROLS with BIC": ("SysIdentPy BIC", "sysidentpy", FROLS_SAMPLES[0]),
    }
    found: dict[str, Any] = {"versions": have}
    for name, (worker_name, package, samples) in asked.items():
        if package not in have or "failed" in about:
            found[name] = {"skipped": f"{package} is missing"}
            continue
        options = worker_name, path, samples, chosen.smoke
        run = call("peer", *options, python=chosen.peers)
        for preset in ENGINE:
            run |= ratio(preset, ours[preset], run)
        found[name] = run
        print(name, json.dumps(run), flush=True)
    return found


def ratio(preset: str, ours: dict[str, Any], theirs: dict[str, Any]) -> dict[str, Any]:
    """Our seconds over theirs, of the clock and of the processors."""
    if "failed" in ours or "failed" in theirs:
        return {}
    return {
        f"{preset} over it": {
            key: round(ours[key] / max(theirs[key], 0.1), 2)
            for key in ("seconds", "processor_s")
        }
    }


def equations(chosen: Any, space: Path) -> dict[str, Any]:
    """Normal equations, with one thread and with all."""
    length, columns = (4_000, 40) if chosen.smoke else (SAMPLES, COLUMNS)
    found: dict[str, Any] = {}
    for threads in sorted({1, os.cpu_count() or 1}):
        run = call("equations", length, columns, threads)
        if "failed" not in run:
            # Of the processors: what else runs there takes both by the same measure.
            share = run["share_of_the_product"]["by processor seconds"]
            run["aim"] = {"value": share, "at_least": HALF, "met": share >= HALF}
        found["1 thread" if threads == 1 else "all threads"] = run
    return found


def candidates(chosen: Any, space: Path) -> dict[str, Any]:
    """Twice the same search; the second has all programs."""
    preset, most = ("linear", SMOKED) if chosen.smoke else ("best", HUNDRED)
    sizes = [RECORDS, SMALL if chosen.smoke else FEW]
    found: dict[str, Any] = {"engine": BED, "asked_for": most}
    for name in ("cold", "warm"):
        options = preset, str(space / "candidates"), chosen.smoke, most
        run = call("identify", BED, sizes, *options)
        found[name] = run
        print(name, json.dumps(run), flush=True)
    if "seconds_a_candidate" in run:
        hundred = round(HUNDRED * run["seconds"] / run["candidates"], 1)
        found["a_hundred"] = target(hundred, CANDIDATES)
    return found


def aim(run: dict[str, Any], key: str, limit: float) -> dict[str, Any]:
    """The figure beside its limit."""
    return {"aim": target(run.get(key), limit)}


def failures(figures: Any) -> list[str]:
    """What has failed anywhere."""
    if not isinstance(figures, dict):
        return []
    own = [figures["failed"]] if "failed" in figures else []
    return own + [text for value in figures.values() for text in failures(value)]


def main() -> int:
    """Measure and record."""
    parser = benchmark_parser("Seconds and memory of the search.", "everything tiny")
    parser.add_argument("--only", nargs="+", choices=PARTS, help="default: all")
    chosen = parser.parse_args()
    if chosen.worker:
        name, arguments = chosen.worker
        print(json.dumps(WORKERS[name](*json.loads(arguments))))
        return 0
    figures: dict[str, Any] = {"output of gengine1": OUTPUT}
    every = quick, short, one_input, equations, candidates, engine
    measures = {f.__name__: f for f in every}
    folder = results_folder(chosen.results, smoke=chosen.smoke)
    # Some parts are recorded apart: a record is that of one run.
    name = "_".join(["search", *(chosen.only or ())])
    versions: dict[str, str] = {}
    for part in chosen.only or PARTS:
        with tempfile.TemporaryDirectory() as space:
            figures[part] = measures[part](chosen, Path(space))
        print(part, json.dumps(figures[part]), flush=True)
        found = figures[part].get("peers", {}).pop("versions", {})
        versions |= {k: v for k, v in found.items() if isinstance(v, str)}
        record(name, figures, folder=folder, versions=versions, note=chosen.note)
    failed = failures(figures)
    print("\n".join(failed), file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
