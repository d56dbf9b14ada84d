"""Does a selection find exactly the true terms, on inputs that vary slowly?

Ten-term systems of degree 2 on four AR(1) inputs with pole 0.95, equation noise 30 dB
below the output (see `recovery_systems.py`): a fresh random system for every seed, and
one system in as many seeds. Counted are the seeds whose chosen terms, the constant
left aside, are exactly the true ten.

The methods of jaxnarx run with default settings; `ForwardOLS` is told the number of
terms, and so is fastcan, which has no rule of its own. SysIdentPy chooses the size
with its own rule (`order_selection`, here with BIC, up to 25 terms).

    python experiments/benchmarks/recovery.py --peers path/to/venv/bin/python
"""

import dataclasses
import functools
import importlib
import importlib.metadata
import importlib.util
import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from common import benchmark_parser, record, results_folder, worker
from recovery_pool import DEGREE, HISTORY, INPUT_LAGS, INPUTS, OUTPUT_LAGS, name

TRUE = 10
FIXED = 0
"""Seed of the one system that is drawn once."""
LARGEST = 25
"""Sizes that SysIdentPy's criterion may choose among."""
BEAM = 10
"""Paths that fastcan's beam search follows."""
ENOUGH = 0.9
"""Target: share of exact sets on fresh systems."""

Choice = Callable[[Any, Any], list[str]]
"""From inputs and output of one seed to the names of the chosen terms."""


@dataclasses.dataclass(frozen=True)
class Sizes:
    """How many seeds at which lengths."""

    kinds: tuple[str, ...] = ("fresh", "fixed")
    samples: tuple[int, ...] = (1_000, 10_000)
    seeds: int = 25


SMOKE = Sizes(("fresh",), (1_000,), 2)


def main() -> None:
    """Run what the command line asks for."""
    parser = benchmark_parser("Exact recovery of true terms.", "small, in seconds")
    parser.add_argument("--seeds", type=int, help="seeds of every cell")
    chosen = parser.parse_args()
    if chosen.worker:
        name, options = chosen.worker
        print(json.dumps(WORKERS[name](**json.loads(options))))
        return
    sizes = SMOKE if chosen.smoke else Sizes()
    if chosen.seeds:
        sizes = dataclasses.replace(sizes, seeds=chosen.seeds)
    figures, versions = measure(sizes, chosen.peers)
    folder = results_folder(chosen.results, smoke=chosen.smoke)
    print(
        record("recovery", figures, folder=folder, versions=versions, note=chosen.note)
    )
    _show(figures)


# Every cell --------------------------------------------------------------------------


def measure(sizes: Sizes, peers: str | None) -> tuple[dict[str, Any], dict[str, str]]:
    """All methods on the same numbers, cell by cell; versions of the peers."""
    figures: dict[str, Any] = {
        "counted": "seeds whose chosen terms are the true ten, constant left aside",
        "true_terms": TRUE,
        "told_the_size": ["jaxnarx ForwardOLS", "fastcan greedy", "fastcan beam"],
        "cells": {},
    }
    versions = {} if peers is None else _run("installed", peers)
    python = peers if versions else None
    for kind in sizes.kinds:
        for samples in sizes.samples:
            with tempfile.TemporaryDirectory() as folder:
                cell = _cell(kind, samples, sizes.seeds, Path(folder), python)
            figures["cells"][f"{kind} systems, N = {samples}"] = cell
    if python is None:
        figures["peers"] = "skipped: no peer was asked for or is installed"
    figures["targets"] = _targets(figures["cells"])
    return figures, versions


def _cell(kind: str, samples: int, seeds: int, folder: Path, peers: str | None):
    path = folder / "data.npz"
    made = _run("data", path=str(path), kind=kind, samples=samples, seeds=seeds)
    chosen = _run("own", path=str(path))
    if peers is not None:
        chosen |= _run("peers", peers, path=str(path))
    return {
        "samples": samples,
        "seeds": seeds,
        "systems": made["terms"],
        "methods": {
            method: _score(found, made["terms"]) for method, found in chosen.items()
        },
    }


def _score(found: dict[str, Any], truth: list[list[str]]) -> dict[str, Any]:
    """Exact sets, and what is missing and too many in the others."""
    wrong = {}
    for seed, (chosen, terms) in enumerate(zip(found["terms"], truth, strict=True)):
        got = set(chosen) - {"1"}
        if got != set(terms):
            wrong[str(seed)] = {
                "missing": sorted(set(terms) - got),
                "extra": sorted(got - set(terms)),
            }
    return {
        "exact": len(truth) - len(wrong),
        "missing_mean": sum(len(w["missing"]) for w in wrong.values()) / len(truth),
        "extra_mean": sum(len(w["extra"]) for w in wrong.values()) / len(truth),
        "seconds": found["seconds"],
        "wrong": wrong,
    }


def _targets(cells: dict[str, Any]) -> dict[str, Any]:
    """Exact sets over all fresh systems by the default `Backward`, and the limit."""
    fresh = [cell for key, cell in cells.items() if key.startswith("fresh")]
    exact = sum(cell["methods"]["jaxnarx Backward"]["exact"] for cell in fresh)
    least = ENOUGH * sum(cell["seeds"] for cell in fresh)
    return {"exact": exact, "least": least, "met": exact >= least}


def _run(name: str, python: str = sys.executable, **options: Any) -> dict[str, Any]:
    arguments = ["--worker", name, json.dumps(options)]
    result, done = worker(__file__, *arguments, python=python)
    if result is None:
        raise SystemExit(f"the worker {name!r} failed:\n{done.stderr}")
    return result


def make_data(path: str, kind: str, samples: int, seeds: int) -> dict[str, Any]:
    """Inputs and outputs of all seeds of a cell into an npz file; their true terms."""
    import numpy as np
    from recovery_systems import make

    fixed = FIXED if kind == "fixed" else None
    made = [make(seed, samples, fixed=fixed) for seed in range(seeds)]
    systems, u, y = zip(*made, strict=True)
    np.savez(path, u=np.stack(u), y=np.stack(y))
    return {"terms": [system.names for system in systems]}


def _choose_all(path: str, methods: dict[str, Choice]) -> dict[str, Any]:
    """Chosen terms of every seed; seconds of the first choice and their median.

    The first one of jaxnarx compiles.
    """
    import numpy as np

    with np.load(path) as saved:
        records = list(zip(saved["u"], saved["y"], strict=True))
    result = {}
    for method, choose in methods.items():
        terms, seconds = [], []
        for u, y in records:
            begin = time.perf_counter()
            terms.append(choose(u, y))
            seconds.append(time.perf_counter() - begin)
        shown = {"first": seconds[0], "median": float(np.median(seconds))}
        result[method] = {
            "terms": terms,
            "seconds": {key: float(f"{value:.3g}") for key, value in shown.items()},
        }
    return result


# The package -------------------------------------------------------------------------


def run_own(path: str) -> dict[str, Any]:
    """Every method of jaxnarx on all seeds."""
    import jax

    from jaxnarx import Backward, ForwardOLS, StepwiseF

    jax.config.update("jax_enable_x64", True)
    methods = {
        "jaxnarx Backward": Backward(),
        "jaxnarx StepwiseF": StepwiseF(),
        "jaxnarx ForwardOLS": ForwardOLS(max_terms=TRUE + 1),
    }
    choices = {key: functools.partial(_select, m) for key, m in methods.items()}
    return _choose_all(path, choices)


def _select(method: Any, u: Any, y: Any) -> list[str]:
    from jaxnarx import Dataset, polynomial_pool, select

    data = Dataset.from_arrays(
        u, y[:, None], inputs=INPUTS, outputs=("y",), sample_time=1.0
    )
    lags = {"input_lags": INPUT_LAGS, "output_lags": OUTPUT_LAGS}
    pool = polynomial_pool(data.channels, **lags, degree=DEGREE)
    chosen = select(pool, data, method).value
    names = pool.variable_names
    factors = pool.factor[chosen.terms(0)]
    return [name(names[f - 1] for f in row if f) for row in factors]


# Peers -------------------------------------------------------------------------------


def installed() -> dict[str, str]:
    """Versions of the peers this interpreter has, and of their numpy."""
    found = {
        package: importlib.metadata.version(package)
        for package in ("sysidentpy", "fastcan")
        if importlib.util.find_spec(package) is not None
    }
    if found:
        found["numpy of the peers"] = importlib.metadata.version("numpy")
    return found


def run_peers(path: str) -> dict[str, Any]:
    """Those that are installed, on all seeds."""
    found, methods = installed(), {}
    if "sysidentpy" in found:
        methods["SysIdentPy FROLS with BIC"] = _frols
    if "fastcan" in found:
        methods["fastcan greedy"] = functools.partial(_fastcan, beam=1)
        methods["fastcan beam"] = functools.partial(_fastcan, beam=BEAM)
    return _choose_all(path, methods)


def _frols(u: Any, y: Any) -> list[str]:
    structure = importlib.import_module("sysidentpy.model_structure_selection")
    basis = importlib.import_module("sysidentpy.basis_function")
    estimation = importlib.import_module("sysidentpy.parameter_estimation")
    model = structure.FROLS(
        basis_function=basis.Polynomial(degree=DEGREE),
        ylag=list(OUTPUT_LAGS),
        xlag=[list(INPUT_LAGS)] * len(INPUTS),
        order_selection=True,
        info_criteria="bic",
        n_info_values=LARGEST,
        estimator=estimation.LeastSquares(),
    ).fit(X=u, y=y[:, None])
    channels = ("y", *INPUTS)
    return [
        name(f"{channels[c // 1000 - 1]}[t-{c % 1000}]" for c in row if c)
        for row in model.final_model.astype(int).tolist()
    ]


def _fastcan(u: Any, y: Any, *, beam: int) -> list[str]:
    import numpy as np

    fastcan = importlib.import_module("fastcan")
    narx = importlib.import_module("fastcan.narx")
    signals = np.column_stack([u, y])
    lags = [(i, d) for i in range(len(INPUTS)) for d in INPUT_LAGS]
    lags += [(len(INPUTS), d) for d in OUTPUT_LAGS]
    lagged = narx.make_time_shift_features(signals, np.array(lags))[HISTORY:]
    ids = narx.make_poly_ids(len(lags), DEGREE)
    search = fastcan.FastCan(TRUE, beam_width=beam, verbose=0)
    search.fit(narx.make_poly_features(lagged, ids), y[HISTORY:, None])
    names = [f"{(*INPUTS, 'y')[i]}[t-{d}]" for i, d in lags]
    rows = np.asarray(ids)[np.asarray(search.indices_)].tolist()
    return [name(names[f] for f in row if f >= 0) for row in rows]


WORKERS = {
    "data": make_data,
    "own": run_own,
    "installed": installed,
    "peers": run_peers,
}


def _show(figures: dict[str, Any]) -> None:
    for key, cell in figures["cells"].items():
        print(f"\n{key}: exact sets of {cell['seeds']} (missing, extra on average)")
        for method, row in cell["methods"].items():
            means = f"{row['missing_mean']:.2f}, {row['extra_mean']:.2f}"
            seconds = f"{row['seconds']['median']:g} s"
            print(f"  {method:28} {row['exact']:3}  ({means})  {seconds}")


if __name__ == "__main__":
    main()
