"""How fast the virtual engines run, and scipy's LSODA on the same right-hand side.

Every bed on one core after compilation, in seconds and times real time; 64 relatives of
the diesel by vmap, by chunks and one by one on two cores; and the diesel by LSODA, with
the right-hand side compiled by jax and called from scipy, and in plain Python.

    python experiments/benchmarks/engines.py
    python experiments/benchmarks/engines.py --only beds lsoda
"""

import argparse
import dataclasses
import json
import math
import os
import time
from collections.abc import Callable, Mapping
from typing import Any

from common import best_of, record, results_folder, target, worker
from plain_diesel import PlainDiesel

SEED = 1
REAL_TIME = 100.0
"""Target: gtdi at least as many times faster than the engine itself."""

DIESEL_SECONDS, FAMILY_SECONDS = 0.3, 5.0
"""Targets: 600 s of the diesel on one core, 64 of them on two."""

SEGMENT = 50
"""Samples of 0.1 s for which the inputs of the comparison with LSODA are held."""

RPM = math.pi / 30
PARTS = ("beds", "family", "lsoda")


@dataclasses.dataclass(frozen=True)
class Sizes:
    """How large everything is."""

    seconds: int = 600
    events: int = 3600
    engines: int = 64
    chunks: tuple[int, ...] = (1, 8, 16, 32, 64)
    repeats: int = 5


SMOKE = Sizes(10, 40, 3, (2,), 1)


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description="Benchmarks of the virtual engines.")
    parser.add_argument("--smoke", action="store_true", help="small, in seconds")
    parser.add_argument("--only", nargs="+", choices=PARTS, help="default: all")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    parser.add_argument("--note", default="", help="a remark kept with the figures")
    parser.add_argument("--worker", nargs=2, metavar=("NAME", "JSON"))
    chosen = parser.parse_args()
    if chosen.worker:
        name, options = chosen.worker
        print(json.dumps(WORKERS[name](**json.loads(options))))
        return
    sizes = SMOKE if chosen.smoke else Sizes()
    figures = {part: _run(part, sizes) for part in chosen.only or PARTS}
    figures["targets"] = _targets(figures)
    folder = results_folder(chosen.results, smoke=chosen.smoke)
    name = "_".join(["engines", *(chosen.only or ())])
    print(record(name, figures, folder=folder, note=chosen.note))
    print(json.dumps(figures, indent=1))


def _run(part: str, sizes: Sizes) -> dict[str, Any]:
    options = json.dumps(dataclasses.asdict(sizes))
    result, done = worker(__file__, "--worker", part, options)
    if result is None:
        raise SystemExit(f"the worker {part!r} failed:\n{done.stderr}")
    return result


def _targets(figures: Mapping[str, Any]) -> dict[str, Any]:
    found = {}
    if "beds" in figures:
        beds = figures["beds"]
        found["diesel_s"] = target(beds["diesel"]["run_s"]["best"], DIESEL_SECONDS)
        share = REAL_TIME / beds["gtdi"]["times_real_time"]
        found["gtdi_share_of_allowed_time"] = target(round(share, 3), 1.0)
    if "family" in figures:
        best = min(run["best"] for run in figures["family"]["family_run_s"].values())
        found["family_s"] = target(best, FAMILY_SECONDS)
    return found


# Workers, each in a fresh process ----------------------------------------------------


def beds(*, seconds: int, events: int, repeats: int, **_: Any) -> dict[str, Any]:
    """Each bed under its usual excitation, compiled, on one core."""
    cores = _one_core()
    jax = _jax()
    import numpy as np

    from jaxnarx.engines import BEDS

    run = jax.jit(lambda engine, inputs: engine.run(inputs))
    found: dict[str, Any] = {"cores": cores}
    for name, make in BEDS.items():
        engine = make()
        length = 10 * seconds if name == "diesel" else events
        inputs = jax.device_put(engine.excite(jax.random.key(SEED), length))
        begin = time.perf_counter()
        outputs = jax.block_until_ready(run(engine, inputs))
        first = time.perf_counter() - begin
        engine_time = _duration(engine, inputs, outputs)
        timed = best_of(_ready(run, engine, inputs), repeats, warm_up=0)
        found[name] = {
            "events": length,
            "engine_time_s": round(engine_time, 2),
            "first_call_s": round(first, 2),
            "run_s": timed,
            "times_real_time": round(engine_time / timed["best"], 1),
            "finite": bool(np.isfinite(outputs).all()),
        }
    return found


def family(
    *,
    seconds: int,
    engines: int,
    chunks: tuple[int, ...],
    repeats: int,
    **_: Any,
) -> dict[str, Any]:
    """Relatives of the diesel: one loop by vmap or lax.map, and `family_run`."""
    jax = _jax()
    import numpy as np

    from jaxnarx.engines import BEDS, family_run
    from jaxnarx.engines import family as make_family

    engine = BEDS["diesel"]()
    inputs = engine.excite(jax.random.key(SEED), 10 * seconds)
    members = make_family(engine, jax.random.key(SEED + 1), engines)

    def mapped(chunk: int | None) -> Callable[..., Any]:
        return jax.jit(
            lambda many, u: jax.lax.map(lambda e: e.run(u), many, batch_size=chunk)
        )

    repeats = min(repeats, 2)
    one_by_one = mapped(None)
    vmapped = jax.jit(jax.vmap(lambda e, u: e.run(u), in_axes=(0, None)))
    loops = {
        "vmap": best_of(_ready(vmapped, members, inputs), repeats),
        "lax.map": best_of(_ready(one_by_one, members, inputs), 1),
    }
    for chunk in chunks[1:-1]:
        loops[f"lax.map of {chunk}"] = best_of(
            _ready(mapped(chunk), members, inputs), repeats
        )
    alone = np.asarray(one_by_one(members, inputs))
    threads = {
        str(chunk): best_of(lambda c=chunk: family_run(members, inputs, chunk=c), 1)
        for chunk in chunks
    }
    together = family_run(members, inputs, chunk=chunks[-1])
    scale = np.abs(alone).max(axis=(0, 1))
    return {
        "engines": engines,
        "engine_time_s": seconds,
        "one_loop_s": loops,
        "family_run_s": threads,
        "family_run_note": "two threads; the key is the size of a chunk",
        "largest_difference": float(np.nanmax(np.abs(together - alone) / scale)),
        "finite": bool(np.isfinite(together).all()),
    }


def lsoda(*, seconds: int, repeats: int, **_: Any) -> dict[str, Any]:
    """The diesel without dead times, inputs held for 5 s, by three ways."""
    cores = _one_core()
    jax = _jax()
    import jax.numpy as jnp
    import numpy as np

    from jaxnarx.engines import Diesel, solve

    engine = Diesel(egr_delay=jnp.asarray(0.0), vgt_delay=jnp.asarray(0.0))
    levels = _levels(engine, -(-10 * seconds // SEGMENT))
    inputs = jnp.repeat(jnp.asarray(levels), SEGMENT, axis=0)
    start = np.asarray(engine.steady_state(inputs[0]))
    derivative = jax.jit(lambda y, u: engine.derivative(y, u))
    plain = PlainDiesel(engine)
    step = np.asarray(derivative(start, levels[1]))
    agreement = np.abs(plain(start, levels[1]) - step) / (np.abs(step) + 1e-9)
    run = jax.jit(lambda u: engine.run(u))

    def accurate(state, row):
        times = jnp.arange(SEGMENT + 1) * 0.1
        path = solve(lambda y: engine.derivative(y, row), state, times)
        return path[-1], path[:-1]

    reference = jax.jit(lambda u: jax.lax.scan(accurate, jnp.asarray(start), u)[1])
    path = np.asarray(reference(jnp.asarray(levels))).reshape(-1, 8)
    fixed = np.asarray(run(inputs))
    scale = np.abs(path).max(axis=0)

    def by_jax(state, row):
        return np.asarray(derivative(state, row))

    timed, errors, calls = {}, {}, {}
    for name, rate in {"jax": by_jax, "python": plain}.items():
        begin = time.perf_counter()
        found, count = _lsoda(rate, start, levels)
        timed[name] = round(time.perf_counter() - begin, 3)
        errors[name] = float((np.abs(found - path) / scale).max())
        calls[name] = count
    own = best_of(_ready(run, inputs), repeats)
    states = fixed[:, [0, 1, 7, 6]] * [1e5, 1e5, 1.0, RPM]
    columns = [0, 1, 2, 4]  # p_im, p_em, X_im and turbo speed are outputs too
    gap = np.abs(states - path[:, columns]) / scale[columns]
    return {
        "cores": cores,
        "engine_time_s": len(inputs) / 10,
        "tolerance": "LSODA rtol 1e-6, atol 1e-9 of each state's size; restarted at "
        "every change of the inputs; differences are from steps with rtol 1e-8, "
        "relative to the largest value of a state",
        "fixed_step_s": own,
        "fixed_step_difference": float(gap.max()),
        "lsoda_s": timed,
        "lsoda_calls": calls,
        "lsoda_difference": errors,
        "ratio_to_fixed_step": {
            name: round(value / own["best"], 1) for name, value in timed.items()
        },
        "plain_rate_difference": float(agreement.max()),
    }


WORKERS: dict[str, Callable[..., dict[str, Any]]] = {
    "beds": beds,
    "family": family,
    "lsoda": lsoda,
}


def _lsoda(rate: Callable[..., Any], start: Any, levels: Any) -> tuple[Any, int]:
    """States every 0.1 s, and the calls of `rate` it took."""
    import numpy as np
    from scipy.integrate import solve_ivp

    times = np.arange(SEGMENT + 1) * 0.1
    state, rows, count = start, [], 0
    size = np.maximum(np.abs(start), 1e-3)
    for row in levels:
        found = solve_ivp(
            lambda t, y, row=row: rate(y, row),
            (0.0, times[-1]),
            state,
            method="LSODA",
            t_eval=times,
            rtol=1e-6,
            atol=1e-9 * size,
        )
        assert found.success, found.message
        rows.append(found.y.T[:-1])
        state, count = found.y[:, -1], count + found.nfev
    return np.concatenate(rows), count


def _levels(engine: Any, count: int) -> Any:
    """`count` rows of inputs, uniform over the usual ranges."""
    import numpy as np

    low, high = np.asarray(list(engine.ranges.values())).T
    return np.random.default_rng(SEED).uniform(low, high, (count, len(low)))


def _duration(engine: Any, inputs: Any, outputs: Any) -> float:
    """What the events last on the engine [s]."""
    import numpy as np

    if engine.event is None:
        return len(inputs) * engine.sample_time
    names = engine.channels.input_names + engine.channels.output_names
    speed = np.concatenate([inputs, outputs], axis=1)[:, names.index("speed")]
    return float(np.sum(engine.event / (6.0 * speed)))


def _ready(function: Callable[..., Any], *arguments: Any) -> Callable[[], None]:
    import jax

    return lambda: jax.block_until_ready(function(*arguments))


def _one_core() -> int:
    """Keep this process on one core, before jax counts them; how many it has now."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 0


def _jax() -> Any:
    import jax

    jax.config.update("jax_enable_x64", True)
    return jax


if __name__ == "__main__":
    main()
