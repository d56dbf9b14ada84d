"""Orders of ARX models: one factorisation for all, and a regression for each.

    speed     10 x 10 x 10 structures (n_a, n_b, n_k) on 10,000 samples, ours and a loop
              of numpy's lstsq on the columns of each structure (a peer with a batched
              search is not known)
    orders    20 seeds of the thesis's own transfer function (4.46), n_a = n_b = n_k =
              6, duty 0.38 to 0.41 by APRBS, equation noise of 1 rpm, 10,000 samples:
              how often MDL and AIC find the orders, by hold times
    spectra   coherence by Welch on the same record, ours and scipy's

The loop takes the columns from one table, so that it pays for factorisations only.

    python experiments/benchmarks/order_search.py [--smoke] [--results DIR]
"""

import json
import time
from collections.abc import Callable
from typing import Any

from common import benchmark_parser, best_of, record, results_folder, target, worker

LIMIT_SECONDS, LIMIT_MISSES = 2.0, 2
SEEDS, SAMPLES, ORDERS = 20, 10_000, 10
HOLDS = ((1, 20), (5, 40), (10, 100), (20, 200))
"""Shortest and longest hold of the APRBS [samples]; the target is that of the
second."""
AIM = (5, 40)
B = [0.0] * 6 + [40.98, 15.69, 23.6, 18.99, 20.27, 65.12]
A = [1, -0.4303, -0.3422, -0.2126, -0.1174, -0.0136, 0.143]
NOTES = {
    "seconds": "best of the repeats; first is the first call of the process, "
    "compilation included",
    "difference": "largest relative difference of the unexplained variances between "
    "ours and the loop",
    "orders": "seeds, of all, in which the criterion names (6, 6, 6)",
}


def system(seed: int, hold: tuple[int, int], samples: int):
    """Duty and speed [rpm] of (4.46) in steady operation."""
    import jax
    import numpy as np
    import scipy.signal

    from jaxnarx.excitation import aprbs

    key, before = jax.random.key(seed), 200
    u = np.asarray(aprbs(key, samples + before, hold=hold, amplitude=(0.38, 0.41)))
    e = np.random.default_rng(seed).normal(size=len(u))
    w = scipy.signal.lfilter(B, A, u - 0.395)
    y = 1000 + np.asarray(w) + scipy.signal.lfilter([1], A, e)
    return u[before:], y[before:]


def dataset(u, y):
    """One record of them."""
    import jaxnarx as jnx

    units = {"speed": "rpm"}
    channels = {"inputs": ["duty"], "outputs": ["speed"], "units": units}
    return jnx.Dataset.from_arrays(u, y, sample_time=0.03, **channels)


def loop(u, y, top: int):
    """Unexplained variance [%] of every structure by its own lstsq."""
    import numpy as np

    first = 2 * top - 1
    at = np.arange(first, len(y))
    past = np.stack([y[at - k] for k in range(1, top + 1)], axis=1)
    lags = np.stack([u[at - k] for k in range(1, 2 * top)], axis=1)
    one, target = np.ones((len(at), 1)), y[at]
    total = np.sum((target - target.mean()) ** 2)
    found = np.zeros((top, top, top))
    for na in range(1, top + 1):
        for nk in range(1, top + 1):
            for nb in range(1, top + 1):
                own = [past[:, :na], lags[:, nk - 1 : nk - 1 + nb], one]
                x = np.concatenate(own, axis=1)
                theta = np.linalg.lstsq(x, target, rcond=None)[0]
                sse = np.sum((target - x @ theta) ** 2)
                found[na - 1, nb - 1, nk - 1] = 100 * sse / total
    return found


def timed(call: Callable[[], Any]) -> tuple[Any, float]:
    """The result and the seconds of one call."""
    begin = time.perf_counter()
    result = call()
    return result, float(f"{time.perf_counter() - begin:.4g}")


def speed(samples: int, top: int) -> dict[str, Any]:
    """Both searches on one record, and both coherences."""
    import jax
    import numpy as np

    jax.config.update("jax_enable_x64", True)
    import scipy.signal

    from jaxnarx.linear import search_orders, spectra

    u, y = system(0, AIM, samples)
    data, grid = dataset(u, y), range(1, top + 1)

    def ours():
        return search_orders(data, na=grid, nb=grid, nk=grid).value

    found, first = timed(ours)
    expected, seconds = timed(lambda: loop(u, y, top))
    own = np.zeros_like(expected)
    own[found.na - 1, found.nb[:, 0] - 1, found.nk[:, 0] - 1] = found.unexplained
    segment = min(1024, samples // 8)
    settings = {"fs": 1 / 0.03, "window": "hann", "nperseg": segment}
    return {
        "structures": len(found),
        "samples": found.samples,
        "first": first,
        "ours": best_of(ours, 5),
        "lstsq loop": seconds,
        "difference": float(np.abs(own / expected - 1).max()),
        "coherence, ours": best_of(lambda: spectra(data, segment=segment), 5),
        "coherence, scipy": best_of(
            lambda: scipy.signal.coherence(u, y, **settings), 5
        ),
    }


def orders(hold: list[int], seeds: int, samples: int) -> dict[str, Any]:
    """How often the criteria find (6, 6, 6) with one range of hold times."""
    import jax

    jax.config.update("jax_enable_x64", True)
    from jaxnarx.linear import search_orders

    chosen: dict[str, list] = {"mdl": [], "aic": []}
    for seed in range(seeds):
        u, y = system(seed, (hold[0], hold[1]), samples)
        found = search_orders(dataset(u, y)).value
        for name, row in chosen.items():
            row.append(found.orders(found.best_place(name)))
    hits = {name: sum(o == (6, 6, 6) for o in row) for name, row in chosen.items()}
    others = sorted({str(o) for o in chosen["mdl"] if o != (6, 6, 6)})
    return {"hold": hold, "seeds": seeds, **hits, "mdl, others": others}


WORKERS = {"speed": speed, "orders": orders}


def run(name: str, **options: Any) -> dict[str, Any]:
    """A worker's figures, or why there are none."""
    found, done = worker(__file__, "--worker", name, json.dumps(options))
    if found is None:
        return {"failed": done.stderr.strip().splitlines()[-1:]}
    print(name, found, flush=True)
    return found


def measure(*, smoke: bool) -> dict[str, Any]:
    """All rows, and the targets."""
    samples = 2000 if smoke else SAMPLES
    fast = run("speed", samples=samples, top=3 if smoke else ORDERS)
    holds = (AIM,) if smoke else HOLDS
    seeds = 2 if smoke else SEEDS
    rows = [run("orders", hold=h, seeds=seeds, samples=samples) for h in holds]
    aim = next((r for r in rows if r.get("hold") == list(AIM)), {})
    missed = aim["seeds"] - aim["mdl"] if "mdl" in aim else None
    return {
        "speed": fast,
        "orders": rows,
        "notes": NOTES,
        "targets": {
            "seconds": target(fast.get("ours", {}).get("best"), LIMIT_SECONDS),
            "seeds missed by MDL": target(missed, LIMIT_MISSES),
        },
    }


def main() -> None:
    """Run what the command line asks for."""
    parser = benchmark_parser("Orders of ARX models.", "few structures and seeds")
    chosen = parser.parse_args()
    if chosen.worker:
        name, options = chosen.worker
        print(json.dumps(WORKERS[name](**json.loads(options))))
        return
    folder = results_folder(chosen.results, smoke=chosen.smoke)
    figures = measure(smoke=chosen.smoke)
    path = record("order_search", figures, folder=folder, note=chosen.note)
    print(path, figures["targets"])


if __name__ == "__main__":
    main()
