"""SysIdentPy's documented Bouc-Wen example, by its own protocol, with it and with us.

A simulated magneto-rheological damper: control voltage E, velocity v and sign(v) give
the force f. SysIdentPy documents a free-run RRSE of 0.045104 for FROLS with its default
order selection (AIC among up to 15 terms): degree 3 and lag 1 of every channel, rows
400 to 1999 to identify, rows 2001 to 3599 unseen, every channel divided by its largest
absolute value in the first part.

    RRSE = sqrt(sum (f - f_hat)^2 / sum (f - mean f)^2)

over the unseen rows but the first, which starts the run. The scaling changes nothing
here: polynomial terms follow a gain, and so does the RRSE. Nothing is chosen by the
unseen part.

    python experiments/benchmarks/bouc_wen.py --peers path/to/venv/bin/python

The file comes from `$JAXNARX_DATA/bouc_wen_sysidentpy`; without it nothing is run.
"""

import importlib
import importlib.metadata
import importlib.util
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

from common import benchmark_parser, record, results_folder, target, worker

FILE = "bouc_wen_sysidentpy/boucwen_histeretic_system.csv"
INPUTS, OUTPUT = ("E", "v", "sign_v"), "f"
IDENTIFY, UNSEEN = slice(400, 2000), slice(2001, 3600)
PARTS = {"identification": IDENTIFY, "unseen": UNSEEN}
SAMPLE_TIME, DEGREE, TERMS = 0.002, 3, 15
PUBLISHED = 0.045104


def main() -> None:
    """Run what the command line asks for."""
    parser = benchmark_parser("SysIdentPy's Bouc-Wen example.", "less simulation")
    chosen = parser.parse_args()
    if chosen.worker:
        name, options = chosen.worker
        print(json.dumps(WORKERS[name](**json.loads(options))))
        return
    folder = results_folder(chosen.results, smoke=chosen.smoke)
    figures, versions = measure(chosen.peers, smoke=chosen.smoke)
    print(
        record("bouc_wen", figures, folder=folder, versions=versions, note=chosen.note)
    )
    _show(figures)


def measure(peers: str | None, *, smoke: bool) -> tuple[dict[str, Any], dict[str, str]]:
    """Rows of every method, and the version of the peer."""
    path = Path(os.environ.get("JAXNARX_DATA", "../shared/data")) / FILE
    if not path.is_file():
        return {"skipped": "JAXNARX_DATA does not hold bouc_wen_sysidentpy"}, {}
    rows = _run("own", path=str(path.resolve()), smoke=smoke)
    versions: dict[str, str] = {}
    if peers is not None:
        versions = _run("installed", peers)
        if versions:
            rows |= _run("sysidentpy", peers, path=str(path.resolve()))
    figures: dict[str, Any] = {
        "identified_on": [IDENTIFY.start, IDENTIFY.stop],
        "free_run_over": [UNSEEN.start, UNSEEN.stop],
        "published_rrse": PUBLISHED,
        "rows": rows,
    }
    if "SysIdentPy FROLS with AIC" in rows:
        theirs = rows["SysIdentPy FROLS with AIC"]["terms"]
        ours = rows["jaxnarx ForwardOLS"]["terms"]
        same = list(map(_reduced, ours)) == list(map(_reduced, theirs))
        figures["same_ordered_terms"] = same
        assert same, f"ordered terms differ: {ours} and {theirs}"
    # Published with six decimals; equal terms differ from it by rounding alone.
    limit = PUBLISHED + 5e-7
    figures["targets"] = {
        name: target(row["unseen_rrse"], limit) for name, row in rows.items()
    }
    return figures, versions


def _run(name: str, python: str = sys.executable, **options: Any) -> dict[str, Any]:
    arguments = ["--worker", name, json.dumps(options)]
    result, done = worker(__file__, *arguments, python=python)
    if result is None:
        raise SystemExit(f"the worker {name!r} failed:\n{done.stderr}")
    return result


def _columns(path: str):
    """Inputs E, v, sign(v) and output f of the whole file."""
    import numpy as np

    table = np.loadtxt(path, delimiter=",", skiprows=1)
    _, v, _, voltage, force = table.T
    return np.column_stack([voltage, v, np.sign(v)]), force


def _rrse(measured: Any, simulated: Any) -> float:
    import numpy as np

    error = np.sum((measured - simulated) ** 2)
    return float(np.sqrt(error / np.sum((measured - measured.mean()) ** 2)))


def _term(variables: list[str]) -> str:
    return "*".join(sorted(variables)) or "1"


def _reduced(term: str) -> str:
    """The term without squares of sign(v), which is 1 or -1 in every row used.

    v and v sign(v)^2 are one column: which of them is taken is a matter of rounding.
    """
    sign = f"{INPUTS[2]}[t-1]"
    factors = [factor for factor in term.split("*") if factor != sign]
    return _term(factors + [sign] * (term.count(sign) % 2))


# The package -------------------------------------------------------------------------


def run_own(path: str, smoke: bool) -> dict[str, Any]:
    """Every method of jaxnarx by the same protocol, then its terms refined.

    A smoke run leaves out the refinement and the two that `recovery.py` runs, and gives
    the choice on the free run few terms.
    """
    import jax

    from jaxnarx import (
        Backward,
        Dataset,
        ForwardOLS,
        SimulationError,
        SimulationOLS,
        StepwiseF,
        polynomial_pool,
        refine,
        select,
    )

    jax.config.update("jax_enable_x64", True)
    u, f = _columns(path)
    parts = {
        key: Dataset.from_arrays(
            u[part],
            f[part, None],
            inputs=INPUTS,
            outputs=(OUTPUT,),
            sample_time=SAMPLE_TIME,
        )
        for key, part in PARTS.items()
    }
    train = parts["identification"]
    pool = polynomial_pool(
        train.channels, input_lags=(1,), output_lags=(1,), degree=DEGREE
    )
    methods = {
        "jaxnarx ForwardOLS": ForwardOLS(max_terms=TERMS, constant="candidate"),
        "jaxnarx Backward": Backward(),
        "jaxnarx StepwiseF": StepwiseF(),
        "jaxnarx SimulationOLS": SimulationOLS(max_terms=5 if smoke else TERMS),
    }
    if smoke:
        del methods["jaxnarx Backward"], methods["jaxnarx StepwiseF"]
    rows = {}
    for name, method in methods.items():
        begin = time.perf_counter()
        chosen = select(pool, train, method)
        seconds = time.perf_counter() - begin
        # Selection on the free run has refined its coefficients on the way.
        network = chosen.stats.get("network") or _network(chosen.value, train)
        rows[name] = {
            **_free_runs(network, parts, f),
            "status": chosen.status_name,
            "seconds": float(f"{seconds:.3g}"),
            "terms": _texts(pool, chosen.value.terms(0)),
        }
        if not smoke:
            fit = refine(network, train, SimulationError())
            rows[f"{name}, refined"] = {
                **_free_runs(fit.value, parts, f),
                "status": fit.status_name,
                "terms": rows[name]["terms"],
            }
    return rows


def _network(selection: Any, train: Any):
    """The chosen terms with their least-squares coefficients as a model."""
    from jaxnarx import Global, grow

    return grow(selection, train, Global()).value


def _texts(pool: Any, terms: list[int]) -> list[str]:
    names = pool.variable_names
    return [_term([names[i - 1] for i in pool.factor[t] if i]) for t in terms]


def _free_runs(network: Any, parts: dict[str, Any], f: Any) -> dict[str, Any]:
    """RRSE of the free run of every part, and samples held by the feedback bound."""
    from jaxnarx import simulate

    found = {}
    for key, data in parts.items():
        run = simulate(network, data).value
        found[f"{key}_rrse"] = _rrse(f[PARTS[key]][1:], run[0][1:, 0])
        found[f"{key}_limited"] = int(run.limited[0].sum())
    return found


# The peer ----------------------------------------------------------------------------


def installed() -> dict[str, str]:
    """Version of SysIdentPy in this interpreter, if it is there."""
    if importlib.util.find_spec("sysidentpy") is None:
        return {}
    return {"sysidentpy": importlib.metadata.version("sysidentpy")}


def run_sysidentpy(path: str) -> dict[str, Any]:
    """The documented setting."""
    structure = importlib.import_module("sysidentpy.model_structure_selection")
    basis = importlib.import_module("sysidentpy.basis_function")
    estimation = importlib.import_module("sysidentpy.parameter_estimation")
    u, f = _columns(path)
    u = u / abs(u[IDENTIFY]).max(axis=0)
    f = (f / abs(f[IDENTIFY]).max())[:, None]
    begin = time.perf_counter()
    model = structure.FROLS(
        xlag=[[1]] * len(INPUTS),
        ylag=1,
        basis_function=basis.Polynomial(degree=DEGREE),
        estimator=estimation.LeastSquares(),
        info_criteria="aic",
    ).fit(X=u[IDENTIFY], y=f[IDENTIFY])
    seconds = time.perf_counter() - begin
    row: dict[str, Any] = {}
    for key, part in PARTS.items():
        simulated = model.predict(X=u[part], y=f[part][:1])
        row[f"{key}_rrse"] = _rrse(f[part][1:], simulated[1:])
    channels = (OUTPUT, *INPUTS)
    chosen = [
        _term([f"{channels[c // 1000 - 1]}[t-{c % 1000}]" for c in code if c])
        for code in model.final_model.astype(int).tolist()
    ]
    return {
        "SysIdentPy FROLS with AIC": row
        | {"seconds": float(f"{seconds:.3g}"), "terms": chosen}
    }


WORKERS = {"own": run_own, "installed": installed, "sysidentpy": run_sysidentpy}


def _show(figures: dict[str, Any]) -> None:
    print(f"published RRSE: {PUBLISHED}")
    for name, row in figures.get("rows", {}).items():
        texts = f"identification {row['identification_rrse']:.6f}"
        print(
            f"  {name:32} {len(row['terms']):2} terms  {texts}  "
            f"unseen {row['unseen_rrse']:.6f}"
        )


if __name__ == "__main__":
    main()
