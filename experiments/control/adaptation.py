"""Adaptation after a change of the engine, and what it costs in C.

Virtual engines, five seeds each. A network is identified from four noisy records of
1,500 samples, of terms of second degree of filtered inputs or, with `--models
identify`, what `identify --preset quick` chooses. Then three parameters of the engine
change by 10 % up or down, and the network follows 60 s of another noisy record by
`jnx.linear.adapt` with its defaults. Free-run errors are those of a third record of the
changed engine without noise: of the network as it was, of the adapted one, with local
in place of joint estimation, of the same terms by least squares of the minute alone,
and of one that is identified anew from four records of the changed engine, ten times
the data. Ratios are those of the adapted one's errors to the last two; they shall be
1.2 at most.

Then the C of `jnx.linear.export_adaptation`: the difference of its coefficients to
those of `adapt`, and microseconds a sample for ten regions of eight terms, local and
joint.

    python experiments/control/adaptation.py [--beds vct pfi] [--seeds 1 2 3 4 5]
"""

import ctypes
import dataclasses
import functools
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

import jaxnarx as jnx
from jaxnarx.linear import Recursive

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "benchmarks"), str(HERE.parent / "calibration")]
from common import record, results_folder  # noqa: E402 # pyright: ignore
from tasks import TASKS, Bed, read_options  # noqa: E402 # pyright: ignore

SECONDS = 60.0
CHANGED, SHARE = 3, 0.1
LENGTH, SKIPPED = 1_500, 100
STREAM, TEST = 50, 60
"""Numbers of the record that teaches and of the one that judges."""
REGIONS, LAGGED = 10, 7
REPEATS = 20_000
BEDS = "vct", "pfi", "diesel"


def change(engine: Any, seed: int) -> tuple[Any, dict[str, float]]:
    """The engine with three parameters off, and by what factor."""
    random = np.random.default_rng(seed)
    names = random.choice(sorted(engine.varied), CHANGED, replace=False).tolist()
    ways = random.choice([1 - SHARE, 1 + SHARE], CHANGED).tolist()
    factors = dict(zip(names, ways, strict=True))
    for name, factor in factors.items():
        where = functools.partial(_leaf, name=name)
        engine = eqx.tree_at(where, engine, where(engine) * factor)
    return engine, factors


def _leaf(engine: Any, name: str) -> Any:
    return functools.reduce(getattr, name.split("."), engine)


def bed_rows(name: str, seed: int, small: bool, models: str) -> dict[str, Any]:
    """Errors of one bed and seed, by output."""
    length = 300 if small else LENGTH
    bed = Bed(TASKS[name], seed, length, models=models)
    network = bed.network()
    engine, factors = change(bed.engine, seed)
    new = Bed(TASKS[name], seed, length, engine=engine, models=models)
    count = min(length, round(SECONDS / bed.step))
    stream = new.measure({STREAM: new.excite(STREAM)[:count]})
    u = new.excite(TEST)
    test = jnx.Dataset.from_arrays(
        u,
        new.run(u),
        inputs=list(new.task.inputs),
        outputs=list(new.task.outputs),
        sample_time=new.step,
    )

    def error(network: jnx.Network) -> dict[str, float]:
        run, y = jnx.simulate(network, test).value.outputs[0], test.records[0].y
        left = np.sqrt(np.mean((y - run)[SKIPPED:] ** 2, axis=0)) / y.std(axis=0)
        return dict(zip(network.output_names, left.tolist(), strict=True))

    alone = Recursive(start=1e6, forgetting=1.0, excitation=0.0, growth=1e6)
    ways = {
        "adapted": Recursive(),
        "local": Recursive(estimation="local"),
        "refit of the minute": dataclasses.replace(alone, largest_index=None),
    }
    rows = {"as it was": error(network)}
    told: dict[str, Any] = {"changed": factors, "samples": count}
    for way, method in ways.items():
        found = jnx.linear.adapt(network, stream, method)
        rows[way] = error(found.value)
        told[f"status, {way}"] = found.status_name
    rows["identified anew"] = error(new.network())
    for way in ("identified anew", "refit of the minute"):
        ratio = {o: e / rows[way][o] for o, e in rows["adapted"].items()}
        told[f"ratio to {way}"] = ratio
    return told | {"errors": rows}


def summary(seeds: dict[str, Any]) -> dict[str, Any]:
    """Medians over seeds and outputs, and the ratios of errors."""
    rows = list(seeds.values())
    told: dict[str, Any] = {
        way: {
            output: float(np.median([row["errors"][way][output] for row in rows]))
            for output in rows[0]["errors"][way]
        }
        for way in rows[0]["errors"]
    }
    for way in ("identified anew", "refit of the minute"):
        ratios = [r for row in rows for r in row[f"ratio to {way}"].values()]
        told[f"ratio to {way}"] = {
            "median": float(np.median(ratios)),
            "worst": float(np.max(ratios)),
            "at most 1.2": f"{sum(r <= 1.2 for r in ratios)} of {len(ratios)}",
        }
    return told


def regions() -> tuple[jnx.Network, jnx.Dataset]:
    """Ten regions of eight terms, and a record."""
    random = np.random.default_rng(0)
    u = np.repeat(random.uniform(-1, 1, 600), 5)
    y = np.convolve(np.tanh(3 * u), 0.2 * 0.8 ** np.arange(40))[: len(u)]
    data = jnx.Dataset.from_arrays(
        u,
        y + 0.01 * random.normal(size=len(u)),
        inputs=["u"],
        outputs=["y"],
        sample_time=0.01,
    )
    pool = jnx.polynomial_pool(
        data.channels, input_lags=tuple(range(LAGGED)), output_lags=(), degree=1
    )
    method = jnx.Lolimot(scheduling=["u[t]"], max_models=REGIONS, patience=REGIONS)
    return jnx.grow(pool, data, method).value, data


def speed(small: bool) -> dict[str, Any]:
    """The C beside `adapt`, and its time a sample."""
    network, data = regions()
    told: dict[str, Any] = {
        "regions": int(np.sum(np.asarray(network.models[0].active)))
    }
    repeats = REPEATS // 100 if small else REPEATS
    for way in ("local", "joint"):
        method = Recursive(estimation=way)
        made = jnx.linear.export_adaptation(network, data, method, name="m")
        with tempfile.TemporaryDirectory() as folder:
            learn = _time_in_c(
                Path(folder), made.texts, "m_adapt(&a, u, y, &out)", repeats
            )
            run = _time_in_c(Path(folder), made.texts, "m_step(&s, u, &out)", repeats)
        told[way] = {
            "difference of coefficients": made.difference["c, adaptation"],
            "microseconds a sample": learn,
            "microseconds of the model alone": run,
        }
    return told


def _time_in_c(folder: Path, texts: Any, call: str, repeats: int) -> float:
    for name, text in texts.items():
        (folder / name).write_text(text)
    (folder / "time.c").write_text(TIMED.replace("CALL", call))
    sources = [str(folder / n) for n in ("m.c", "m_adapt.c", "time.c")]
    library = str(folder / f"{time.monotonic_ns()}.so")
    options = ["-std=c99", "-O2", "-fPIC", "-shared", f"-I{folder}"]
    subprocess.run(["cc", *options, *sources, "-lm", "-o", library], check=True)
    run = ctypes.CDLL(library).run
    run.restype = ctypes.c_double
    best = np.inf
    for _ in range(5):
        begun = time.perf_counter()
        run(ctypes.c_int(repeats))
        best = min(best, time.perf_counter() - begun)
    return 1e6 * best / repeats


TIMED = """#include "m_adapt.h"
#include <math.h>
double run(int n);
double run(int n)
{
    m_state s;
    m_adaptation a;
    m_out out;
    double u[1] = {0.1}, y[1] = {0.2}, total = 0.0;
    int t;
    m_begin(&s, u, y);
    for (t = 0; t < M_HISTORY; t++) m_observe(&s, u, y);
    m_adapt_begin(&a, &s);
    for (t = 0; t < n; t++) {
        u[0] = sin(0.37 * t) * sin(0.011 * t);
        y[0] = u[0];
        CALL;
        total += out.reported[0];
    }
    return total;
}
"""


def main() -> None:
    """Measure and record."""
    options = read_options(__doc__, list(BEDS), 5)
    jax.config.update("jax_enable_x64", True)
    folder = results_folder(options.results, smoke=options.smoke)
    figures: dict[str, Any] = {"models": options.models, "c": speed(options.smoke)}
    print(figures, flush=True)
    found: dict[str, dict[str, Any]] = {}
    for name in options.beds:
        for seed in options.seeds:
            row = bed_rows(name, seed, options.smoke, options.models)
            found.setdefault(name, {})[str(seed)] = row
            print(name, seed, row, flush=True)
            beds = {n: summary(rows) for n, rows in found.items()}
            names = {"quadratic": "adaptation", "identify": "adaptation_identified"}
            told = figures | {"summary": beds, "seeds": found}
            record(names[options.models], told, folder=folder)


if __name__ == "__main__":
    main()
