"""Measure what an accelerator gains: the same calls on every device of this machine.

Fleets of networks (6 local models with 8 terms each, records of 1,000 samples) run
freely and give gradients side by side; normal equations of one network on many records;
the products of a forward search; whole identifications of a sweep. On the processor a
fleet goes one after the other too (`map`), whatever is faster there. Differences
between devices stand beside the times. Without an accelerator the processor alone is
measured.

    python experiments/benchmarks/accelerator.py [--smoke] [--results DIR]
"""

import dataclasses
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

from common import benchmark_parser, record, results_folder
from simulation_workers import make_network, make_records
from sweep_workers import make_work


@dataclasses.dataclass(frozen=True)
class Sizes:
    """What is measured; of normal equations (models, terms, records, samples)."""

    fleets: tuple[int, ...]
    samples: int
    normal: tuple[tuple[int, int, int, int], ...]
    pool: tuple[int, int, int]
    sweep: tuple[int, int, tuple[int, ...]]
    repeats: int


FULL = Sizes(
    (1, 64, 1024, 8192),
    1_000,
    ((10, 6, 20, 12_400), (32, 12, 512, 2_000)),
    (42, 8, 100_000),
    (1_000, 16, (256, 1024)),
    5,
)
SMOKE = Sizes((2,), 60, ((2, 8, 2, 60),), (6, 2, 500), (150, 2, (2,)), 1)


def time_call(call: Callable[[], Any], repeats: int) -> tuple[dict[str, float], Any]:
    """First and best wall time [s] of a call, and what it gave."""
    import jax

    times, found = [], None
    for _ in range(repeats + 1):
        begin = time.perf_counter()
        found = jax.block_until_ready(call())
        times.append(time.perf_counter() - begin)
    row = {"first_s": times[0], "best_s": min(times[1:])}
    return {k: float(f"{v:.4g}") for k, v in row.items()}, found


def fleet_calls(size: int, samples: int) -> dict[str, Any]:
    """Free runs and gradients of networks that differ in their coefficients."""
    import equinox as eqx
    import jax
    import jax.numpy as jnp
    import numpy as np

    from jaxnarx.models import run_record
    from jaxnarx.refinement import freeze

    network = make_network(6, 8)
    drive, anchor, _ = make_records(network, samples)
    v, x, measured, anchor = jax.tree.map(
        lambda a: a[0], (drive.v, drive.x, drive.measured, anchor)
    )
    factors = 1 + 0.01 * np.random.default_rng(0).normal(size=size)
    where = lambda n: n.models[0].local.coefficient  # noqa: E731
    moving, fixed = eqx.partition(network, freeze(network))
    repeated = jax.tree.map(lambda a: jnp.repeat(a[None], size, axis=0), moving)
    shape = (size,) + (1,) * where(network).ndim
    coefficient = where(repeated) * factors.reshape(shape)
    stacked = eqx.tree_at(where, repeated, coefficient)
    given = stacked, v, x, measured, anchor

    def run(moving, v, x, measured, anchor):
        return run_record(eqx.combine(moving, fixed), v, x, measured, anchor)

    def loss(moving, *records):
        counted = jnp.cumsum(records[3])[:, None] > 0
        error = run(moving, *records) - records[2]
        return jnp.sum(jnp.where(counted, error, 0.0) ** 2)

    def side_by_side(one):
        return jax.jit(jax.vmap(one, in_axes=(0, None, None, None, None)))

    def in_turn(one):
        return jax.jit(lambda all, *rest: jax.lax.map(lambda m: one(m, *rest), all))

    calls = {"free run": run, "gradient": jax.value_and_grad(loss)}
    return {
        name: (given, {"vmap": side_by_side(one), "map": in_turn(one)})
        for name, one in calls.items()
    }


def normal_calls(models: int, terms: int, records: int, samples: int) -> Any:
    """J'J and J'r of one network on many records."""
    import jax.numpy as jnp

    from jaxnarx.refinement.gauss_newton import normal_equations
    from jaxnarx.refinement.layout import make_layout

    network = make_network(models, terms)
    drive, anchor, _ = make_records(network, samples, records)
    layout = make_layout(network, None, (0.1, 10.0))
    given = layout, layout.gather(network), drive, anchor, jnp.ones_like(drive.measured)
    return given, {"one call": normal_equations}


def product_calls(variables: int, vectors: int, samples: int) -> Any:
    """Products of all terms of degree 3 with some vectors, the pool never formed."""
    from functools import partial

    import jax
    import jax.numpy as jnp
    import numpy as np

    from jaxnarx.arrays.contraction import contract

    random = np.random.default_rng(0)
    v = random.normal(size=(variables, samples))
    v[0] = 1.0
    given = jnp.asarray(v), jnp.asarray(random.normal(size=(vectors, samples)))
    return given, {"one call": jax.jit(partial(contract, degree=3))}


def measure_on(device: Any, given: Any, ways: Any, repeats: int) -> Any:
    """Times of every way on a device, and what the last one gave there."""
    import equinox as eqx
    import jax

    arrays, fixed = eqx.partition(given, eqx.is_array)
    there = eqx.combine(jax.device_put(arrays, device), fixed)
    rows, found = {}, None
    for way, call in ways.items():
        if way == "map" and device.platform != "cpu":
            continue  # an accelerator has nothing to gain from one after the other
        rows[way], found = time_call(lambda call=call: call(*there), repeats)
    return rows, found


def difference(one: Any, two: Any) -> float:
    """Largest difference, relative to the largest value of each array."""
    import jax
    import numpy as np

    worst = 0.0
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(two), strict=True):
        a, b = np.asarray(a), np.asarray(b)
        scale = max(float(np.max(np.abs(a))), 1e-300)
        worst = max(worst, float(np.max(np.abs(a - b))) / scale)
    return float(f"{worst:.2g}")


def measure_call(given: Any, ways: Any, repeats: int) -> dict[str, Any]:
    """One kind of call on all kinds of devices."""
    rows: dict[str, Any] = {}
    results = []
    for device in devices():
        timing, found = measure_on(device, given, ways, repeats)
        rows[device.platform] = timing
        results.append(found)
    return rows | compare_devices(rows, results)


def compare_devices(rows: dict[str, Any], results: list[Any]) -> dict[str, Any]:
    """How much faster the accelerator is, and how far its numbers are away."""
    if len(results) < 2:
        return {}
    best = [min(way["best_s"] for way in rows[d.platform].values()) for d in devices()]
    return {
        "times_faster": float(f"{best[0] / best[1]:.3g}"),
        "difference": difference(*results),
    }


def sweeps(
    samples: int, few: int, chunks: tuple[int, ...]
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Whole identifications per second, records and rows included; on the processor in
    turn too."""
    import jax

    for size in chunks:
        for device in devices():
            ways = {"vmap": size}
            if device.platform == "cpu":
                # Side by side a processor is slower: once is enough.
                ways = {"map": 1} | (ways if size == chunks[0] else {})
            for way, at_once in ways.items():
                # In turn a few say what all would.
                count = size if way == "vmap" else min(size, few)
                work = make_work(samples, count, count, min(at_once, count))
                with jax.default_device(device):
                    timing, fits = time_call(lambda work=work: rows_of(work), 1)
                scores = [r["train_free_run"] for r in fits[:few]]
                yield (
                    f"{size} {device.platform} {way}",
                    timing
                    | {
                        "fits_per_second": float(f"{count / timing['best_s']:.4g}"),
                        "scores": [float(f"{s:.6g}") for s in scores],
                    },
                )


def rows_of(work: Any) -> list[dict[str, Any]]:
    """All rows of a sweep in one chunk."""
    return work.run(range(len(work.members)))


def devices() -> list[Any]:
    """The processor, and the accelerator if there is one."""
    import jax

    first = jax.devices()[0]
    return [jax.devices("cpu")[0], *([] if first.platform == "cpu" else [first])]


def measure(sizes: Sizes) -> Iterator[dict[str, Any]]:
    """All figures so far, after every one."""
    calls: dict[str, Any] = {}
    for size in sizes.fleets:
        for name, call in fleet_calls(size, sizes.samples).items():
            calls[f"{name}, {size} networks"] = call
    for shape in sizes.normal:
        models, terms, records, samples = shape
        parameters = models * (terms + 4)
        name = f"normal equations, {parameters} parameters, {records} x {samples}"
        calls[name] = normal_calls(*shape)
    variables, vectors, samples = sizes.pool
    name = f"search, {variables} variables, {vectors} vectors, {samples} samples"
    calls[name] = product_calls(*sizes.pool)
    figures: dict[str, Any] = {"devices": [d.device_kind for d in devices()]}
    for name, (given, ways) in calls.items():
        figures[name] = measure_call(given, ways, sizes.repeats)
        print(name, figures[name], flush=True)
        yield figures
    for name, row in sweeps(*sizes.sweep):
        figures["sweep"] = figures.get("sweep", {}) | {name: row}
        print(name, row, flush=True)
        yield figures


def main() -> int:
    """Measure and record."""
    import jax

    jax.config.update("jax_enable_x64", True)
    parser = benchmark_parser("What an accelerator gains.", "small, in seconds")
    options = parser.parse_args()
    folder = results_folder(options.results, smoke=options.smoke)
    # After every figure: such machines are often there for minutes only.
    for figures in measure(SMOKE if options.smoke else FULL):
        record("accelerator", figures, folder=folder, note=options.note)
    return 0


if __name__ == "__main__":
    sys.exit(main())
