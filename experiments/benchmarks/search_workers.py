"""What the benchmark of the search runs, each in a fresh process.

Only the standard library is imported here; the rest inside the functions. Test records
are neither read nor scored.
"""

import importlib
import os
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from common import ROOT

sys.path.insert(0, str(ROOT / "experiments" / "open_sets"))
import peers  # noqa: E402 # pyright: ignore[reportMissingImports]
from packed import pack  # noqa: E402 # pyright: ignore[reportMissingImports]
from sets import OpenSet  # noqa: E402 # pyright: ignore[reportMissingImports]

DESCRIPTION = ROOT / "experiments" / "gengine1" / "gengine1.toml"
OUTPUT = "NOx"
COLUMNS, RECORDS, GROUPS, ROUNDS = 400, 20, 5, 3
"""Of the normal equations: columns, records, groups, and turns of every measurement."""
FEEDBACK = 1.0, -1.5, 0.6
"""A(q) that the columns are filtered by, a pair of complex poles."""
SMALL = 300
"""Samples that a smoke run keeps of a record."""


def digits(value: float) -> float:
    """Four of them."""
    return float(f"{value:.4g}")


def ready(cache: str = "") -> Any:
    """The package in float64, with a folder for its programs."""
    import jax

    jax.config.update("jax_enable_x64", True)
    if cache:
        jax.config.update("jax_compilation_cache_dir", cache)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    return importlib.import_module("jaxnarx")


# The search --------------------------------------------------------------------------


def measured(small: bool) -> Any:
    """Training records of `gengine1` with one output."""
    import jaxnarx as jnx
    from jaxnarx.data import Channels, match_channels

    split = jnx.read_split(DESCRIPTION)
    assert split.train is not None
    data, known = split.train, split.train.channels
    kept = tuple(c for c in known.outputs if c.name == OUTPUT)
    data = match_channels(data, Channels(known.inputs, kept))[0]
    if not small:
        return data
    return jnx.Dataset.from_arrays(
        [r.u[:SMALL] for r in data][:4],
        [r.y[:SMALL] for r in data][:4],
        inputs=known.input_names,
        outputs=[OUTPUT],
        sample_time=data.sample_time,
    )


def engine(bed: str, records: int, length: int) -> Any:
    """Records of a virtual engine with noise, and its first output."""
    from jaxnarx.data import Channels, match_channels

    virtual = importlib.import_module("virtual")
    data = virtual.engine(bed, train=records, length=length).train
    known = data.channels
    return match_channels(data, Channels(known.inputs, known.outputs[:1]))[0]


def counted() -> dict[str, int]:
    """Programs that are made from now on, and how many of them the folder held."""
    from jax import monitoring

    seen = {"programs": 0, "from_cache": 0}

    def heard(event: str, duration_secs: float, **kwargs: str | int) -> None:
        del duration_secs, kwargs
        seen["programs"] += event == "/jax/core/compile/backend_compile_duration"

    def hit(event: str, **kwargs: str | int) -> None:
        del kwargs
        seen["from_cache"] += event == "/jax/compilation_cache/cache_hits"

    monitoring.register_event_duration_secs_listener(heard)
    monitoring.register_event_listener(hit)
    return seen


def identify(
    source: str,
    sizes: list[int],
    preset: str,
    cache: str,
    small: bool,
    candidates: int | None = None,
) -> dict[str, Any]:
    """One search: seconds of the call, of the processors, candidates, what was chosen.

    `source` is `gengine1` or a virtual engine, of which `sizes` tells records and
    samples of each.
    """
    jnx = ready(cache)
    data = measured(small) if source == "gengine1" else engine(source, *sizes)
    seen = counted()
    begin, spent = time.perf_counter(), _processor()
    fit = jnx.identify(data, preset=preset, candidates=candidates)
    wall, spent = time.perf_counter() - begin, _processor() - spent
    board = fit.stats["leaderboard"]
    (output,) = board.outputs
    rows, chosen = board.of(output), board.choose(output)
    families: dict[str, int] = {}
    for row in rows:
        families[row.family] = families.get(row.family, 0) + 1
    tried = [row for row in rows if row.detail == "" or row.seconds > 0]
    return {
        "samples": data.samples,
        "records": len(data),
        "output": output,
        "preset": preset,
        "threads": os.environ.get(peers.THREADS[1], "as they come"),
        "seconds": round(wall, 1),
        "processor_s": round(spent, 1),
        "candidates": len(tried),
        "families": families,
        "seconds_a_candidate": round(wall / len(tried), 2),
        "slowest": _slowest(tried),
        "programs": seen["programs"],
        "compiled": seen["programs"] - seen["from_cache"],
        "status": fit.status_name,
        "chosen": chosen and f"{chosen.family}: {chosen.name}",
        "cross_validated_nrmse": chosen and digits(chosen.free_run),
    }


def _processor() -> float:
    """Processor seconds of this process and those that it has waited for."""
    used = [
        resource.getrusage(who)
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    ]
    return sum(u.ru_utime + u.ru_stime for u in used)


def _slowest(rows: list[Any]) -> dict[str, float]:
    """Seconds of the five candidates that took longest."""
    ranked = sorted(rows, key=lambda row: -row.seconds)[:5]
    return {f"{row.family}: {row.name}": row.seconds for row in ranked}


# Peers -------------------------------------------------------------------------------


def prepare(path: str, small: bool) -> dict[str, Any]:
    """Write the training records for the peers, no test records."""
    ready()
    data = measured(small)
    about = OpenSet("gengine1", data, {}, {}, "training records alone", "nothing")
    return pack(about, Path(path))


def peer(name: str, path: str, samples: int, small: bool) -> dict[str, Any]:
    """Seconds of a peer, one core, as for the open sets; FROLS of so many samples."""
    peers.SAMPLES = samples
    begin, spent = time.perf_counter(), _processor()
    found = peers.PEERS[name][0](path, OUTPUT, small)
    wall, spent = time.perf_counter() - begin, _processor() - spent
    found.pop("test")
    return found | {"seconds": round(wall, 1), "processor_s": round(spent, 1)}


# Normal equations --------------------------------------------------------------------


def equations(length: int, columns: int, threads: int) -> dict[str, Any]:
    """Normal equations of the free run of one region, and their parts, beside a matrix
    product of the same shapes [GFLOP/s].

    All figures count the products of every column with every other, two operations at
    a sample; symmetry spares nearly half of them. Taken in turns, the best of each.
    """
    _limit(threads)
    ready()
    import numpy as np

    from jaxnarx.partition.closed_form.design_matrix import BlockDesign

    signals = _signals(length, columns, every=1)
    thinned = _signals(length, columns, every=12)
    empty = BlockDesign.of(signals, np.array(FEEDBACK))
    sparse = BlockDesign.of(thinned, np.array(FEEDBACK))
    block = empty.block(())
    others = [np.random.default_rng(0).normal(size=c.shape) for c in block.columns]
    pairs = list(zip(block.columns, others, strict=True))
    calls: dict[str, Callable[[], Any]] = {
        "matrix product": lambda: [c @ o.T for c, o in pairs],
        "product alone": lambda: [c @ c.T for c in block.columns],
        "columns alone": lambda: empty.block(()),
        "whole": lambda: empty.extend(empty.block(())),
        "as the search does it, every 12th sample": lambda: sparse.extend(
            sparse.block(())
        ),
    }
    best = _in_turns(calls)
    samples = int(empty.equations.samples.sum())
    work = 2e-9 * columns**2 * samples
    shares = [best["matrix product"][k] / best["whole"][k] for k in range(2)]
    rates = {n: work / best[n][0] for n in ("matrix product", "product alone", "whole")}
    return {
        "threads": threads,
        "columns": columns,
        "samples": samples,
        "shapes": [list(c.shape) for c in block.columns],
        "seconds": {name: digits(wall) for name, (wall, _) in best.items()},
        "processor_s": {name: digits(spent) for name, (_, spent) in best.items()},
        "gflop_per_s": {name: round(rate, 1) for name, rate in rates.items()},
        "share_of_the_product": {
            "by the clock": round(shares[0], 3),
            "by processor seconds": round(shares[1], 3),
        },
        "computed_products": round((columns + 1) / (2 * columns), 3),
    }


def _limit(threads: int) -> None:
    """Threads of linear algebra; before numpy is imported."""
    os.environ.update(dict.fromkeys(peers.THREADS, str(threads)))


def _in_turns(calls: dict[str, Callable[[], Any]]) -> dict[str, tuple[float, float]]:
    """Wall and processor seconds of every call, the least of several rounds."""
    best: dict[str, tuple[float, float]] = {}
    for _ in range(ROUNDS):
        for name, call in calls.items():
            begin, spent = time.perf_counter(), _processor()
            call()
            now = time.perf_counter() - begin, _processor() - spent
            old = best.get(name, now)
            best[name] = min(old[0], now[0]), min(old[1], now[1])
    return best


def _signals(length: int, columns: int, every: int) -> Any:
    """Products of lagged random inputs over some records, which are grouped in turn."""
    import dataclasses

    import numpy as np

    import jaxnarx as jnx
    from jaxnarx.partition.closed_form.signals import make_signals
    from jaxnarx.regressors import Variables, polynomial_pool

    random = np.random.default_rng(0)
    lengths = [length // RECORDS] * RECORDS
    data = jnx.Dataset.from_arrays(
        [random.normal(size=(n, 3)) for n in lengths],
        [random.normal(size=(n, 1)) for n in lengths],
        inputs=("u1", "u2", "u3"),
        outputs=("y",),
        sample_time=0.1,
    )
    pool = polynomial_pool(data.channels, input_lags=range(9), output_lags=(), degree=2)
    assert len(pool) >= columns
    pool = dataclasses.replace(pool, factor=pool.factor[:columns])
    labels = [np.full(n, k % GROUPS) for k, n in enumerate(lengths)]
    parts = labels, np.eye(GROUPS, dtype=bool)
    scheduling = Variables.of([(0, 0, None)])
    return make_signals(data, pool, scheduling, *parts, history=8, every=every)


WORKERS = {f.__name__: f for f in (identify, prepare, peer, equations, peers.installed)}
