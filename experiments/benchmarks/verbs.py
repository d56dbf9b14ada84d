"""A Python loop over the verbs against one program for all engines.

The fits are those of the benchmark of sweeps: choice of terms, growth, refinement of
everything. `verbs` are `select`, `grow` and `refine`, which do what the program does;
`identify` makes the domain of every network too. All run in this process on one
processor, after a first call of each that compiles; the best of some rounds in turns,
in processor seconds of a fit.

    python experiments/benchmarks/verbs.py [--smoke]
"""

import argparse
import time
from typing import Any

import sweep_workers
from common import record, results_folder, target

SAMPLES, FITS, ROUNDS = (400, 1_000, 4_000), 16, 3
AIM = 1.5
"""Seconds of the loop over those of the program."""


def of_size(samples: int, fits: int, rounds: int) -> dict[str, Any]:
    """Both ways with records of one length."""
    import jaxnarx as jnx

    work = sweep_workers.make_work(samples, fits, fits, 1)
    data = [work.fleet.dataset(n) for n in range(fits)]

    method = work.method

    def verbs() -> None:
        for one in data:
            chosen = jnx.select(method.pool, one, method.select).value
            grown = jnx.grow(chosen, one, method.grow).value
            jnx.refine(grown, one, method.refine)

    def identify() -> None:
        for one in data:
            jnx.identify(one, method)

    ways = {
        "program": lambda: work.run(range(fits)),
        "verbs": verbs,
        "identify": identify,
    }
    best: dict[str, float] = {}
    for call in ways.values():
        call()
    for _ in range(rounds):
        for name, call in ways.items():
            begin = time.process_time()
            call()
            seconds = (time.process_time() - begin) / fits
            best[name] = min(seconds, best.get(name, seconds))
    return {
        "seconds a fit": {name: round(value, 5) for name, value in best.items()},
        "verbs over program": target(round(best["verbs"] / best["program"], 2), AIM),
        "identify over program": round(best["identify"] / best["program"], 2),
    }


def main() -> None:
    """Measure and record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--smoke", action="store_true", help="short records, few fits")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    options = parser.parse_args()
    sweep_workers.one_processor()
    sizes = (200,) if options.smoke else SAMPLES
    fits, rounds = (2, 1) if options.smoke else (FITS, ROUNDS)
    figures = {f"{n} samples": of_size(n, fits, rounds) for n in sizes}
    for name, row in figures.items():
        print(name, row)
    record(
        "verbs", figures, folder=results_folder(options.results, smoke=options.smoke)
    )


if __name__ == "__main__":
    main()
