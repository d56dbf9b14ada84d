"""Time of free runs, of their gradients and of the normal equations, beside peers.

A network of 6 local models with 8 terms each (degree 2, two inputs, three output lags,
scheduled on the inputs) at 1,800 and 100,000 samples. With `--peers` the same collapsed
recursion as a numba loop, and free runs of an eight-term polynomial model by SysIdentPy
and fastcan on the same record; package and peers are measured in turn, round by round.

    python experiments/benchmarks/simulation.py
    python experiments/benchmarks/simulation.py --peers path/to/venv/bin/python
"""

import dataclasses
import json
import statistics
import sys
import tempfile
from pathlib import Path
from typing import Any

from common import benchmark_parser, record, results_folder, target, worker
from simulation_peers import PEERS, installed
from simulation_workers import WORKERS

LIMITS = {"loop over numba": 1.5, "gradient over free run": 2.5}
GAIN = 4.0
"""Least ratio of autodiff through the scan over the package's gradient."""

PEER_LIMIT = 300.0
"""Seconds after which a peer is stopped."""

NOTES = {
    "loop": "the run on coefficients G_t made before, as the numba loop has them",
    "free_run": "from lagged variables and parameters; so are loss and gradient",
    "numba": "the loop over the table of monomials, with anchors and bound, compiled",
    "polynomial peers": "one polynomial of eight terms, not a network: less work",
    "ratios": "medians over rounds of the ratio of best times within a round",
}


@dataclasses.dataclass(frozen=True)
class Sizes:
    """What is measured, and how often."""

    samples: tuple[int, ...]
    rounds: int
    repeats: int
    normal: dict[str, dict[str, int]]
    search: dict[str, int]


FULL = Sizes(
    (1_800, 100_000),
    3,
    15,
    {
        "normal_equations": {
            "models": 10,
            "terms": 6,
            "records": 20,
            "samples": 12_400,
            "repeats": 3,
        },
        "most_parameters": {
            "models": 32,
            "terms": 12,
            "records": 20,
            "samples": 50_000,
            "repeats": 1,
        },
    },
    {"members": 50, "samples": 1_800},
)
SMOKE = Sizes(
    (300,),
    1,
    2,
    {
        "normal_equations": {
            "models": 10,
            "terms": 6,
            "records": 2,
            "samples": 200,
            "repeats": 1,
        }
    },
    {"members": 3, "samples": 200},
)


def main() -> None:
    """Run what the command line asks for."""
    parser = benchmark_parser("Benchmark of simulation.", "small, in seconds")
    chosen = parser.parse_args()
    if chosen.worker:
        name, options = chosen.worker
        print(
            json.dumps(
                ({"installed": installed} | WORKERS | PEERS)[name](
                    **json.loads(options)
                )
            )
        )
        return
    sizes = SMOKE if chosen.smoke else FULL
    folder = results_folder(chosen.results, smoke=chosen.smoke)
    versions = _run("installed", chosen.peers) if chosen.peers else {}
    figures = measure(sizes, chosen.peers, versions)
    print(
        record(
            "simulation", figures, folder=folder, versions=versions, note=chosen.note
        )
    )
    show(figures)


def _run(name: str, python: str = sys.executable, /, **options: Any) -> dict[str, Any]:
    command = ["--worker", name, json.dumps(options)]
    script = str(Path(__file__).resolve())
    result, done = worker(script, *command, python=python)
    if result is None:
        raise SystemExit(f"the worker {name!r} failed:\n{done.stderr}")
    return result


def _peer(name: str, python: str, path: str, repeats: int) -> dict[str, Any]:
    options = json.dumps({"path": path, "repeats": repeats})
    script = str(Path(__file__).resolve())
    result, done = worker(
        script, "--worker", name, options, python=python, limit=PEER_LIMIT
    )
    if result is not None:
        return result
    return {"failed": (done.stderr.strip().splitlines() or ["stopped"])[-1]}


def measure(
    sizes: Sizes, python: str | None, versions: dict[str, str]
) -> dict[str, Any]:
    """Every size, the normal equations, and the structure search."""
    present = [name for name in PEERS if name in versions]
    lengths = {
        f"{n} samples": _length(n, sizes, python, present) for n in sizes.samples
    }
    return {
        "model": "6 local models x 8 terms, degree 2, 3 output lags, 2 inputs",
        "notes": NOTES,
        "peers": present or "no peer is installed or asked for",
        "lengths": lengths,
        **{name: _run("normal", **size) for name, size in sizes.normal.items()},
        "search": _run("search", **sizes.search),
    } | _targets(lengths)


def _length(
    samples: int, sizes: Sizes, python: str | None, present: list[str]
) -> dict[str, Any]:
    rounds = []
    with tempfile.TemporaryDirectory() as temporary:
        path = str(Path(temporary) / "data.npz")
        for n in range(sizes.rounds):
            # Autodiff takes seconds a call at the longer size: once is enough there.
            autodiff = n == 0 or samples < 10_000
            repeats = sizes.repeats if samples < 10_000 else max(1, sizes.repeats // 3)
            options = {"path": path, "samples": samples, "repeats": repeats}
            one = {"jaxnarx": _run("model", autodiff=autodiff, **options)}
            for name in present:
                one[name] = _peer(name, str(python), path, repeats)
            rounds.append(one)
    return {"rounds": rounds, "ratios": _ratios(rounds)}


def _ratios(rounds: list[dict[str, Any]]) -> dict[str, float]:
    """Medians over the rounds of best time over best time."""
    found: dict[str, list[float]] = {}
    for one in rounds:
        ours = {k: row["best"] for k, row in one["jaxnarx"]["times"].items()}
        pairs = {
            "gradient over free run": ("loss_and_gradient", "free_run"),
            "autodiff over gradient": ("autodiff", "loss_and_gradient"),
        }
        for name, (above, below) in pairs.items():
            if above in ours:
                found.setdefault(name, []).append(ours[above] / ours[below])
        for peer in PEERS:
            if "free_run" not in one.get(peer, {}):
                continue
            theirs = one[peer]["free_run"]["best"]
            own = (
                ours["loop"] / theirs if peer == "numba" else theirs / ours["free_run"]
            )
            name = "loop over numba" if peer == "numba" else f"{peer} over free run"
            found.setdefault(name, []).append(own)
    return {name: round(statistics.median(row), 3) for name, row in found.items()}


def _targets(lengths: dict[str, Any]) -> dict[str, Any]:
    """The figures that have a limit, from above and from below."""
    above, below = {}, {}
    for size, row in lengths.items():
        for name, limit in LIMITS.items():
            if name in row["ratios"]:
                above[f"{name}, {size}"] = target(row["ratios"][name], limit)
        value = row["ratios"].get("autodiff over gradient")
        if value is not None:
            name = f"autodiff over gradient, {size}"
            below[name] = {"value": value, "at_least": GAIN, "met": value >= GAIN}
    return {"targets": above, "at_least": below}


def show(figures: dict[str, Any]) -> None:
    """Everything as text."""
    for size, row in figures["lengths"].items():
        print(size)
        last = row["rounds"][0]
        for name, times in last["jaxnarx"]["times"].items():
            print(f"  {name:20s}{1e3 * times['best']:12.3f} ms")
        for peer in PEERS:
            if "free_run" in last.get(peer, {}):
                print(f"  {peer:20s}{1e3 * last[peer]['free_run']['best']:12.3f} ms")
        for name, ratio in row["ratios"].items():
            print(f"  {name:30s}{ratio:8.2f}")
    for normal in (figures[name] for name in FULL.normal if name in figures):
        print(
            f"J'J of {normal['parameters']} parameters, {normal['samples']} samples: "
            f"{normal['times']['best']} s, peak {normal['peak_mb']} MB"
        )
    search = figures["search"]
    print(
        f"{search['networks']} networks: {search['programs']} programs, "
        f"{search['seconds']} s, of which compiling {search['compiling_s']} s"
    )
    for name, one in (figures["targets"] | figures["at_least"]).items():
        print(f"{name}: {one['value']} ({'met' if one['met'] else 'missed'})")


if __name__ == "__main__":
    main()
