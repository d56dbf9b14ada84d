"""Fits per second of a sweep: chunks, a Python loop, two processes, and fastcan.

1,000 fits of 1,000 samples: eight of 200 terms by forward orthogonal least squares,
four local models by LOLIMOT, ten Levenberg-Marquardt steps on the free run, scores.
Every measurement is a fresh process on one processor; compilation is told apart, and
the time per fit includes what the host does to records and rows.

Chunks of 1 to 256 fits in one call, one after the other (`map`) or side by side
(`vmap`); a chunk of one is the Python loop over the same compiled fit. Two processes
at the same time, each on a processor of its own, against one of them. With `--peers`
fastcan chooses as many terms from its own pool of that size and trains them on the free
run of the same records: eight, which is one local model, and 32, which is as many
coefficients; its fit has no local models, and goes on to its own end.

    python experiments/benchmarks/sweep.py [--smoke] [--peers PYTHON] [--results DIR]
"""

import json
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from common import benchmark_parser, record, results_folder, target, worker
from sweep_workers import WORKERS

FITS, SAMPLES = 1000, 1000
FEW = 128
"""Fits of any other measurement, or one chunk if that is more."""
CHUNKS = (
    *((size, "map") for size in (1, 16, 32, 64, 256)),
    *((size, "vmap") for size in (16, 64, 256)),
)
MAIN = 32
"""The chunk that is given all fits, as `map`."""
ROUNDS = 3
"""Turns of one process and two."""
PEER_FITS = {8: 10, 32: 2}
"""Terms that fastcan chooses, and how many records it is given."""
LIMITS = {"two_over_one": 1.7}


def call(name: str, *arguments: Any, python: str = sys.executable) -> Any:
    """A worker's answer, or None with its complaint on the terminal."""
    with tempfile.NamedTemporaryFile("w", suffix=".json") as file:
        json.dump(arguments, file)
        file.flush()
        script = str(Path(__file__).resolve())
        answer, done = worker(script, "--worker", name, file.name, python=python)
    if answer is None:
        print(done.stderr[-800:], file=sys.stderr)
    return answer


def chunk_table(samples: int, few: int, chunks) -> list[dict[str, Any]]:
    """Every chunk size in a process of its own."""
    rows = []
    for lanes, batch in chunks:
        at_once = lanes if batch == "vmap" else 1
        main = (lanes, batch) == (MAIN, "map")
        fits = FITS if main else lanes * max(1, few // lanes)
        found = call("sweep", samples, fits, lanes, at_once)
        rows.append({"chunk": lanes, "batch": batch} | (found or {}))
        print(json.dumps(rows[-1]), flush=True)
    return rows


def processes(samples: int, fits: int, lanes: int, rounds: int) -> dict[str, Any]:
    """The rate of two processes that run at the same time over that of one.

    Taken in turns, and the median ratio is the figure: on a shared machine one
    round says little.
    """
    pairs: list[tuple[float, float]] = []
    for _ in range(rounds):
        one, two = (rate_of(count, samples, fits, lanes) for count in (1, 2))
        if one is None or two is None:
            return {}
        pairs.append((one, two))
    ratios = sorted(round(two / one, 2) for one, two in pairs)
    ratio = ratios[len(ratios) // 2]
    # `target` wants what is small to be good.
    limit = target(round(1 / ratio, 4), round(1 / LIMITS["two_over_one"], 4))
    rates = [[round(rate, 2) for rate in pair] for pair in pairs]
    found = {"one_and_two": rates, "ratios": ratios, "ratio": ratio}
    return found | {"one_over_two": limit}


def rate_of(count: int, samples: int, fits: int, lanes: int) -> float | None:
    """Fits per second of so many processes that begin together; None on failure."""
    with tempfile.TemporaryDirectory() as folder:
        asked = [
            (samples, fits, lanes, 1, number, count, folder) for number in range(count)
        ]
        with ThreadPoolExecutor(count) as threads:
            found = list(threads.map(lambda a: call("sweep", *a), asked))
    if None in found:
        return None
    # The slower one ends the work.
    return count * fits / max(row["seconds"] for row in found)


def measure(options: Any) -> dict[str, Any]:
    """All figures; a smaller set for `--smoke`."""
    small = options.smoke
    samples, few = (150, 2) if small else (SAMPLES, FEW)
    chunks = ((1, "map"), (2, "vmap")) if small else CHUNKS
    begin = time.perf_counter()
    table = chunk_table(samples, few, chunks)
    figures: dict[str, Any] = {"chunks": table}
    rates = {(r["chunk"], r["batch"]): r.get("fits_per_second") for r in table}
    rate, loop = rates.get((MAIN, "map"), 0.0), rates.get((1, "map"), 0.0)
    if not small:
        figures["processes"] = processes(samples, 4 * few, MAIN, ROUNDS)
        print(json.dumps(figures["processes"]), flush=True)
    if rate and loop:
        figures["over_python_loop"] = round(rate / loop, 2)
    if options.peers:
        peers = {8: 1} if small else PEER_FITS
        figures["fastcan"] = {
            f"{terms} terms": call(
                "fastcan", samples, count, terms, python=options.peers
            )
            for terms, count in peers.items()
        }
        for row in figures["fastcan"].values():
            if row and rate:
                row["times_faster"] = round(rate / row["fits_per_second"], 1)
        print(json.dumps(figures["fastcan"]), flush=True)
    figures["seconds"] = round(time.perf_counter() - begin, 1)
    return figures


def main() -> None:
    """Measure and record."""
    parser = benchmark_parser(__doc__ or "", "two short fits")
    options = parser.parse_args()
    if options.worker:
        name, path = options.worker
        print(json.dumps(WORKERS[name](*json.loads(Path(path).read_text()))))
        return
    versions = call("versions", python=options.peers) if options.peers else {}
    figures = measure(options)
    folder = results_folder(options.results, smoke=options.smoke)
    record("sweep", figures, folder=folder, versions=versions, note=options.note)


if __name__ == "__main__":
    main()
