"""Fits per second of a sweep: select, grow and refine fused into one program.

One fit is a pool of 220 cubic terms on a record of 1,000 samples, 8 terms, 4 local
models, 10 Levenberg-Marquardt steps on the free run, judged on 500 further samples and
scored on 500 more. Chunks of fits by the program, one after the other and side by side,
stand beside a Python loop over the same compiled fit; what compilation takes is told
apart. Two processes on a core each are compared with one. With `--peers`, fastcan fits
as many given terms on the same records by its multi-step objective, in ten evaluations
of its Jacobian: no choice of terms, one model, no validation.

    python experiments/benchmarks/sweep.py [--smoke] [--peers PYTHON] [--results DIR]
"""

import importlib
import importlib.metadata
import importlib.util
import json
import os
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from common import benchmark_parser, record, results_folder, target, worker

LENGTHS = (1000, 500, 500)
"""Samples to train on, to judge by, and to test with."""
SIZES = (1, 16, 32, 64, 256)
"""Fits in one call of the program."""
SIDE = (1, 16, 32, 64)
"""... and how many of them run side by side where not all go one after the other."""
ENGINES = 32
SECONDS = 10.0
"""Least time over which a rate is measured."""
READY = 150.0
"""Time [s] in which two processes must have compiled before they start together."""
PAIR_LIMIT = 1.7
SMOKE = {"lengths": (120, 60, 60), "sizes": (1, 2), "side": (2,), "seconds": 0.2}


def records(seed: int, lengths: tuple[int, ...]):
    """Inputs and outputs of a second-order process with a bent gain."""
    import numpy as np

    rng = np.random.default_rng(seed)
    pole = 0.6 + 0.1 * rng.uniform()
    us, ys = [], []
    for length in lengths:
        u = np.repeat(rng.uniform(-1, 1, (length // 10 + 1, 2)), 10, axis=0)[:length]
        y = np.zeros(length)
        for t in range(2, length):
            y[t] = pole * y[t - 1] + 0.15 * y[t - 2] * u[t - 1, 0]
            y[t] += np.tanh(2 * u[t - 1, 0]) + 0.3 * u[t - 2, 1] ** 2
        us.append(u)
        ys.append((y + 0.02 * rng.normal(size=length))[:, None])
    return us, ys


def make_work(lengths: tuple[int, ...], engines: int, lanes: int, at_once: int):
    """The sweep of `engines` under one case."""
    import jax

    import jaxnarx as jnx

    jax.config.update("jax_enable_x64", True)
    made = {
        f"engine {n}": jnx.Dataset.from_arrays(
            *records(n, lengths), inputs=["a", "b"], outputs=["y"], sample_time=0.1
        )
        for n in range(engines)
    }
    fleet = jnx.Fleet.from_datasets(made, train=[0], validation=[1], test=[2])
    method = jnx.Identification(
        ["a[t-1]", "b[t-1]"], input_lags=(0, 1, 2), output_lags=(1, 2, 3), degree=3
    )
    return jnx.IdentificationWork(fleet, method, lanes=lanes, at_once=at_once)


def rate(
    lengths: tuple[int, ...], lanes: int, at_once: int, seconds: float
) -> dict[str, Any]:
    """Seconds of the first call, and fits per second of the following ones.

    With one lane to a call this is the Python loop over the same compiled fit.
    """
    work = make_work(tuple(lengths), min(ENGINES, max(lanes, 4)), lanes, at_once)
    count = len(work.members)
    begin = time.perf_counter()
    rows = work.run([n % count for n in range(lanes)])
    first = time.perf_counter() - begin
    # Members are prepared once; here they are, all of them.
    for n in range(count):
        work.prepared(n)
    fits, begin, taken = 0, time.perf_counter(), 0.0
    while taken < seconds:
        work.run([(fits + n) % count for n in range(lanes)])
        fits += lanes
        taken = time.perf_counter() - begin
    return {
        "lanes": lanes,
        "at_once": at_once,
        "first_call_s": round(first, 2),
        "fits_per_s": float(f"{fits / taken:.4g}"),
        "fits": fits,
        "okay": sum(row["status"] in ("ok", "no_improvement") for row in rows),
        "load": round(os.getloadavg()[0], 1),
    }


def pinned(
    lengths: tuple[int, ...], core: int, start: float, seconds: float
) -> dict[str, Any]:
    """Fits per second on one core, measured from the time `start` on."""
    os.sched_setaffinity(0, {sorted(os.sched_getaffinity(0))[core]})
    work = make_work(tuple(lengths), 4, 16, 1)
    work.run(range(4))
    late = time.time() > start
    time.sleep(max(0.0, start - time.time()))
    fits, begin, taken = 0, time.perf_counter(), 0.0
    while taken < seconds:
        work.run([n % 4 for n in range(16)])
        fits += 16
        taken = time.perf_counter() - begin
    return {"fits_per_s": float(f"{fits / taken:.4g}"), "late": late}


def factors(lengths: tuple[int, ...]) -> list[list[tuple[int, int]]]:
    """(signal, lag) of the factors of every term that the first engine is given."""
    work = make_work(tuple(lengths), 1, 1, 1)
    pool = work.pool_of_all
    (row,) = work.run([0])
    table = [(s, d) for s, d in pool.variables]
    return [[table[i - 1] for i in pool.factor[t] if i] for t in row["term_index"]]


def fastcan(
    lengths: tuple[int, ...], terms: list[list[tuple[int, int]]], seconds: float
) -> dict[str, Any]:
    """Fits per second of given terms by its multi-step objective."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    narx = importlib.import_module("fastcan.narx")
    us, ys = zip(*(records(n, tuple(lengths)) for n in range(4)), strict=True)
    degree = max(len(row) for row in terms)
    rows = [[*row, *([(-1, -1)] * (degree - len(row)))] for row in terms if row]

    def fit(n: int):
        model = narx.NARX(
            feat_ids=[[s for s, _ in row] for row in rows],
            delay_ids=[[d for _, d in row] for row in rows],
            fit_intercept=[] in terms,
        )
        u, y = us[n][0], ys[n][0][:, 0]
        return model.fit(u, y, coef_init="one_step_ahead", max_nfev=10)

    fit(0)
    fits, begin, taken = 0, time.perf_counter(), 0.0
    while taken < seconds:
        fit(fits % 4)
        fits += 1
        taken = time.perf_counter() - begin
    return {"terms": len(terms), "fits_per_s": float(f"{fits / taken:.4g}")}


def versions() -> dict[str, str]:
    """Of the peer, where this interpreter has it."""
    found = importlib.util.find_spec("fastcan")
    return {"fastcan": importlib.metadata.version("fastcan")} if found else {}


WORKERS = {f.__name__: f for f in (rate, pinned, factors, fastcan, versions)}


def call(name: str, *arguments: Any, python: str = sys.executable) -> Any:
    """A worker's answer, or None with its complaint on the terminal."""
    with tempfile.NamedTemporaryFile("w", suffix=".json") as file:
        json.dump(arguments, file)
        file.flush()
        script = str(Path(__file__).resolve())
        answer, done = worker(script, "--worker", name, file.name, python=python)
    if answer is None:
        print(done.stderr[-600:], file=sys.stderr)
    return answer


def pairs(lengths: tuple[int, ...], seconds: float, ready: float) -> dict[str, Any]:
    """One process on one core, then two on two."""
    if len(os.sched_getaffinity(0)) < 2:
        return {"skipped": "one core"}
    one = call("pinned", lengths, 0, 0.0, seconds)
    start = time.time() + ready
    with ThreadPoolExecutor(2) as pool:
        both = [pool.submit(call, "pinned", lengths, n, start, seconds) for n in (0, 1)]
        two = [run.result() for run in both]
    if one is None or None in two:
        return {"failed": True}
    ratio = sum(r["fits_per_s"] for r in two) / one["fits_per_s"]
    return {
        "one": one["fits_per_s"],
        "two": [r["fits_per_s"] for r in two],
        "together": not any(r["late"] for r in two),
        "times": round(ratio, 2),
        "at_least": PAIR_LIMIT,
        "met": ratio >= PAIR_LIMIT,
    }


def measure(smoke: bool, peers: str | None) -> dict[str, Any]:
    """All figures, every one by a process of its own."""
    lengths = SMOKE["lengths"] if smoke else LENGTHS
    seconds = SMOKE["seconds"] if smoke else SECONDS
    sizes, side = (SMOKE["sizes"], SMOKE["side"]) if smoke else (SIZES, SIDE)
    found: dict[str, Any] = {
        "lengths": list(lengths),
        "in turn": [],
        "side by side": [],
    }
    for lanes in sizes:
        found["in turn"].append(call("rate", lengths, lanes, 1, seconds))
        print(json.dumps(found["in turn"][-1]), flush=True)
    for lanes in side:
        if lanes > 1:
            found["side by side"].append(call("rate", lengths, lanes, lanes, seconds))
            print(json.dumps(found["side by side"][-1]), flush=True)
    loop, *chunks = [r["fits_per_s"] for r in found["in turn"] if r]
    if chunks:
        found["seconds_for_1000"] = target(round(1000 / max(chunks), 1), 60.0)
        found["times_the_loop"] = round(max(chunks) / loop, 2)
    found["processes"] = pairs(lengths, seconds, 60.0 if smoke else READY)
    print(json.dumps(found["processes"]), flush=True)
    if peers:
        terms = call("factors", lengths)
        found["fastcan"] = call("fastcan", lengths, terms, seconds, python=peers)
        print(json.dumps(found["fastcan"]), flush=True)
    return found


def main() -> None:
    """Measure and record."""
    parser = benchmark_parser(__doc__ or "", "short records, two chunk sizes")
    options = parser.parse_args()
    if options.worker:
        name, path = options.worker
        print(json.dumps(WORKERS[name](*json.loads(Path(path).read_text()))))
        return
    found = call("versions", python=options.peers) if options.peers else {}
    figures = measure(options.smoke, options.peers)
    folder = results_folder(options.results, smoke=options.smoke)
    record("sweep", figures, folder=folder, versions=found, note=options.note)


if __name__ == "__main__":
    main()
