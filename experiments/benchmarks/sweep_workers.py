"""What the sweep benchmark runs, each in a fresh process on one processor.

Only the standard library is imported here; the rest inside the functions.
"""

import importlib
import importlib.metadata
import importlib.util
import os
import statistics
import time
from pathlib import Path
from typing import Any

INPUT_LAGS, OUTPUT_LAGS, POOL, TERMS, MODELS, STEPS = 8, 3, 200, 8, 4, 10
PATIENCE = 300.0
"""Seconds to wait for the other processes."""


def versions() -> dict[str, str]:
    """Of the peer, where this interpreter has it."""
    found = importlib.util.find_spec("fastcan")
    return {"fastcan": importlib.metadata.version("fastcan")} if found else {}


def one_processor(number: int = 0) -> None:
    """Keep this process on one of its processors (Linux)."""
    if hasattr(os, "sched_setaffinity"):
        known = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {known[-1 - number % len(known)]})


def records(samples: int, count: int):
    """Two inputs in steps, and an output whose gain and speed depend on the first.

    Every member has parameters, inputs and noise of its own.
    """
    import numpy as np

    random = np.random.default_rng(0)
    hold = 10
    drawn = random.uniform(-1, 1, (count, samples // hold + 1, 2))
    u = np.repeat(drawn, hold, axis=1)[:, :samples]
    gain = random.uniform(0.8, 1.2, (count, 3))
    y = np.zeros((count, samples))
    for t in range(2, samples):
        x, w = u[:, t - 1, 0], u[:, t - 2, 1]
        pole = 0.75 - 0.15 * np.tanh(3 * x)
        drive = gain[:, 0] * np.tanh(2 * x) + gain[:, 1] * w * (1 + 0.5 * x * w)
        y[:, t] = pole * y[:, t - 1] + 0.1 * gain[:, 2] * y[:, t - 2] + 0.2 * drive
    return u, y + 0.01 * y.std() * random.normal(size=y.shape)


def make_work(samples: int, count: int, lanes: int, at_once: int) -> Any:
    """The sweep of that many members."""
    import dataclasses

    import jax

    jax.config.update("jax_enable_x64", True)
    import jaxnarx as jnx

    u, y = records(samples, count)
    data = {
        f"member {n}": jnx.Dataset.from_arrays(
            *([u[n]], [y[n][:, None]]),
            inputs=("u1", "u2"),
            outputs=("y",),
            sample_time=1.0,
        )
        for n in range(count)
    }
    fleet = jnx.Fleet.from_datasets(data, train=slice(None))
    pool = jnx.polynomial_pool(
        fleet.channels,
        input_lags=range(INPUT_LAGS),
        output_lags=range(1, OUTPUT_LAGS + 1),
        degree=2,
    )
    pool = dataclasses.replace(pool, factor=pool.factor[:POOL])
    method = jnx.Identification(
        pool=pool,
        select=jnx.ForwardOLS(max_terms=TERMS),
        grow=jnx.Lolimot(("u1[t-1]", "u2[t-2]"), max_models=MODELS, criterion="none"),
        # Everything moves from the first step on, and all steps are made.
        refine=jnx.SimulationError(
            horizons=(), max_steps=STEPS, train="joint", tolerance=0, patience=1000
        ),
    )
    return jnx.sweep.IdentificationWork(fleet, method, lanes=lanes, at_once=at_once)


def sweep(
    samples: int,
    fits: int,
    lanes: int,
    at_once: int,
    number: int = 0,
    processes: int = 1,
    folder: str = "",
) -> dict[str, Any]:
    """Rate of a sweep without compilation, and the time of that."""
    one_processor(number)
    begin = time.perf_counter()
    work = make_work(samples, fits, lanes, at_once)
    made = time.perf_counter()
    work.run(range(min(lanes, fits)))
    first = time.perf_counter() - made
    if processes > 1:
        _wait(Path(folder), number, processes)
    begin_run = time.perf_counter()
    rows = []
    for start in range(0, fits, lanes):
        part = range(start, min(start + lanes, fits))
        rows += work.run(part)
    seconds = time.perf_counter() - begin_run
    scores = [row["train_free_run"] for row in rows]
    once = seconds * min(lanes, fits) / fits
    return {
        "fits": fits,
        "seconds": round(seconds, 3),
        "fits_per_second": round(fits / seconds, 2),
        "compile_s": round(max(first - once, 0.0), 2),
        "fleet_s": round(made - begin, 2),
        "statuses": {
            s: [r["status"] for r in rows].count(s)
            for s in sorted({r["status"] for r in rows})
        },
        "median_start": float(
            f"{statistics.median(r['train_free_run_start'] for r in rows):.4g}"
        ),
        "median_nrmse": float(f"{statistics.median(scores):.4g}"),
        "pool": len(work.pool),
    }


def _wait(folder: Path, number: int, processes: int) -> None:
    """Until all processes have compiled."""
    (folder / f"{number}.ready").touch()
    end = time.perf_counter() + PATIENCE
    while len(list(folder.glob("*.ready"))) < processes:
        if time.perf_counter() > end:
            raise TimeoutError("the other process did not come")
        time.sleep(0.01)


def fastcan(samples: int, count: int, terms: int) -> dict[str, Any]:
    """Its selection and multi-step fit of the same records."""
    one_processor()
    import numpy as np

    narx = importlib.import_module("fastcan.narx")
    u, y = records(samples, count)

    def fit(n: int):
        begin = time.perf_counter()
        model = narx.make_narx(
            *(u[n], y[n]),
            n_terms_to_select=terms,
            max_delay=INPUT_LAGS - 1,
            poly_degree=2,
            verbose=0,
        )
        chosen = time.perf_counter()
        model.fit(u[n], y[n], coef_init="one_step_ahead")
        end = time.perf_counter()
        run = model.predict(u[n], y_init=y[n][: model.max_delay_])
        keep = slice(model.max_delay_, None)
        error = np.sqrt(np.mean((run[keep] - y[n][keep]) ** 2)) / np.std(y[n][keep])
        return chosen - begin, end - begin, float(error)

    fit(0)
    found = [fit(n) for n in range(count)]
    selection, total, error = zip(*found, strict=True)
    return {
        "fits": count,
        "fits_per_second": float(f"{count / sum(total):.4g}"),
        "selection_s": float(f"{statistics.median(selection):.4g}"),
        "median_nrmse": float(f"{statistics.median(error):.4g}"),
    }


WORKERS = {f.__name__: f for f in (sweep, fastcan, versions)}
