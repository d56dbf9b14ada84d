"""What the fitting benchmark runs, each in a fresh process on one processor.

Records travel in one file, see `prepare`. Only the standard library is imported here.
"""

import importlib
import importlib.metadata
import importlib.util
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fitting_data import (
    PARTS,
    READERS,
    SETS,
    Clock,
    Record,
    errors,
    load,
    one_processor,
)

PACKAGES = ("fastcan", "jax-sysid")
DEGREE, TERMS = 2, 10
"""Of the polynomial; see the notes kept with the figures."""

SMOKE = {"horizons": (10,), "window_steps": 2, "max_steps": 2}
OPTIMUM = {"horizons": (), "max_steps": 200, "patience": 200, "ridge": 0.0} | {
    "tolerance": 1e-6
}
"""Whole records alone, to the end: the problem that fastcan solves."""

ADAM, LBFGS, WEIGHT = 1000, 1000, 1e-4
"""jax-sysid's documented training of a nonlinear model: steps of Adam, evaluations of
L-BFGS, weight of both squared penalties."""


def installed() -> dict[str, str]:
    """Versions of the peers this interpreter has."""
    found = {}
    for package in PACKAGES:
        if importlib.util.find_spec(package.replace("-", "_")) is not None:
            found[package] = importlib.metadata.version(package)
    return found


# The package -------------------------------------------------------------------------


def prepare(name: str, folder: str, path: str) -> dict[str, Any]:
    """Write the records of a data set to `path`; return the chosen terms as factors
    (signal, lag), the input being signal 0 and the output 1."""
    import numpy as np

    chosen = SETS[name]
    parts = READERS[name](Path(folder) / chosen["file"], chosen["train"])
    arrays = {
        f"{letter}_{part}_{n}": signal
        for part, records in parts.items()
        for n, record in enumerate(records)
        for letter, signal in zip("uy", record, strict=True)
    }
    np.savez(path, **arrays)
    data = _datasets(name, parts)["train"]
    pool = _pool(name, data.channels)
    selection = _select(pool, data)
    names = pool.variable_names
    rows = [[names[i - 1] for i in pool.factor[t] if i] for t in selection.terms(0)]
    return {
        "samples": {k: [len(u) for u, _ in v] for k, v in parts.items()},
        "terms": selection.names,
        "factors": [[_factor(text) for text in row] for row in rows],
    }


def _factor(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"([uy])\[t(?:-(\d+))?\]", text)
    assert found is not None, text
    return "uy".index(found[1]), int(found[2] or 0)


def _datasets(name: str, parts: dict[str, list[Record]]) -> dict[str, Any]:
    from jaxnarx import Dataset

    return {
        part: Dataset.from_arrays(
            [u for u, _ in records],
            [y for _, y in records],
            inputs=("u",),
            outputs=("y",),
            sample_time=SETS[name]["sample_time"],
        )
        for part, records in parts.items()
    }


def _pool(name: str, channels: Any) -> Any:
    from jaxnarx import polynomial_pool

    lags = tuple(range(SETS[name]["start"] + 1))
    return polynomial_pool(
        channels, input_lags=lags, output_lags=lags[1:], degree=DEGREE
    )


def _select(pool: Any, data: Any) -> Any:
    import jax

    from jaxnarx import ForwardOLS, select

    jax.config.update("jax_enable_x64", True)
    return select(pool, data, ForwardOLS(max_terms=TERMS)).value


def run_own(name: str, path: str, smoke: bool) -> dict[str, Any]:
    """Terms, coefficients, refinement: a first time, and once more in the process."""
    one_processor()
    parts = load(path)
    settings = SMOKE if smoke else {}
    found = {key: _fit(name, parts, settings) for key in ("first", "again")}
    for _ in range(1 if smoke else 2):
        # The second counts: it does not compile.
        found["optimum"] = _fit(name, parts, OPTIMUM | settings, "train")
    return found


def _fit(
    name: str,
    parts: dict[str, list[Record]],
    settings: dict[str, Any],
    judge: str = "validation",
) -> dict[str, Any]:
    from jaxnarx import Global, SimulationError, grow, refine, simulate

    data, start = _datasets(name, parts), SETS[name]["start"]
    pool = _pool(name, data["train"].channels)
    # The score that refinement reports is a mean square over that of the same records.
    spread = _spread(data[judge], start)
    history = []
    clock = Clock()

    def note(row: dict[str, Any]) -> None:
        rmse = float(row["validation"]) ** 0.5 * spread
        if not row["diverged"]:
            history.append(clock.read() | {"validation": rmse})

    selection = _select(pool, data["train"])
    selected = clock.read()
    network = grow(selection, data["train"], Global()).value
    assert network.history == start, "runs of all methods must begin alike"
    method = SimulationError(**settings)
    solution = refine(
        network, data["train"], method, validation=data[judge], progress=note
    )
    total = clock.read()
    runs = {part: simulate(solution.value, data[part]).value for part in PARTS}
    return {
        "parameters": solution.stats["parameters"],
        "status": solution.status_name,
        "steps": solution.stats["steps"],
        "selection": selected,
        "total": total,
        "history": _falling(history),
        "rmse": {
            part: errors(start, parts[part], [run[n][:, 0] for n in range(len(run))])
            for part, run in runs.items()
        },
        "limited": {
            part: int(sum(held.sum() for held in run.limited))
            for part, run in runs.items()
        },
    }


def _spread(data: Any, start: int) -> float:
    import numpy as np

    return float(np.concatenate([record.y[start:, 0] for record in data]).std())


def _falling(history: list[dict[str, float]]) -> list[dict[str, float]]:
    """The steps that improved on all before."""
    kept: list[dict[str, float]] = []
    for row in history:
        if not kept or row["validation"] < kept[-1]["validation"]:
            kept.append(row | {"validation": float(f"{row['validation']:.5g}")})
    return kept


# The peers ---------------------------------------------------------------------------


def run_fastcan(
    name: str, path: str, factors: list[list[tuple[int, int]]]
) -> dict[str, Any]:
    """The same terms by its multi-step fit, from one-step least squares."""
    one_processor()
    import numpy as np

    narx = importlib.import_module("fastcan.narx")
    parts, start = load(path), SETS[name]["start"]
    # The constant is its intercept.
    rows = [[*row, *((-1, -1),) * (DEGREE - len(row))] for row in factors if row]
    u, y = (np.concatenate(signal) for signal in zip(*parts["train"], strict=True))
    times = {}
    for key in ("first", "again"):
        clock = Clock()
        model = narx.NARX(
            feat_ids=[[signal for signal, _ in row] for row in rows],
            delay_ids=[[lag for _, lag in row] for row in rows],
            fit_intercept=[] in factors,
        ).fit(
            u[:, None],
            y,
            coef_init="one_step_ahead",
            session_sizes=[len(u) for u, _ in parts["train"]],
        )
        times[key] = clock.read()
    rmse = {
        part: errors(start, records, [_fastcan_run(model, start, *r) for r in records])
        for part, records in parts.items()
    }
    return times | {"parameters": len(factors), "rmse": rmse}


def _fastcan_run(model: Any, start: int, u: Any, y: Any) -> Any:
    """The free run whose first sample is `start`, measured ones before."""
    import numpy as np

    first = start - model.max_delay_
    run = model.predict(u[first:, None], y_init=y[first:start])
    return np.concatenate([y[:first], run])


def run_jax_sysid(name: str, path: str, neurons: int, seed: int) -> dict[str, Any]:
    """The documented residual network with two states, by Adam and then L-BFGS.

    Every fit of it compiles. A fit of two steps and two evaluations is that and
    nothing else: with `cold` and `short` such fits before and after, `first` is
    `full + cold - short` and `again`, what is left without compilation, `full - short`.
    """
    one_processor()
    parts = load(path)
    cold = _sysid(parts, neurons, seed, 2, 2)[1]
    model, full, scale = _sysid(parts, neurons, seed, ADAM, LBFGS)
    short = _sysid(parts, neurons, seed, 2, 2)[1]
    times = {"first": {}, "again": {}}
    for kind in full:
        times["again"][kind] = round(full[kind] - short[kind], 4)
        times["first"][kind] = round(full[kind] + cold[kind] - short[kind], 4)
    start = SETS[name]["start"]
    states, ends = _training_states(model, parts["train"], scale)
    learned = {
        part: [_learned(model, u, y, start, scale) for u, y in parts[part]]
        for part in ("validation", "test")
    }
    runs = {
        "train": states,
        "validation": ends,
        "validation, state by filter": learned["validation"],
        "test": learned["test"],
    }
    rmse = {}
    for key, begin in runs.items():
        records = parts[key.partition(",")[0]]
        outputs = [
            _sysid_run(model, x, u, scale)
            for x, (u, _) in zip(begin, records, strict=True)
        ]
        rmse[key] = errors(start, records, outputs)
    count = sum(value.size for value in model.params)
    return times | {"parameters": int(count), "rmse": rmse}


def _sysid(
    parts: dict[str, list[Record]], neurons: int, seed: int, adam: int, lbfgs: int
) -> tuple[Any, dict[str, float], Any]:
    """A trained model, the times of its `fit`, and the scaling of the signals."""
    jax = importlib.import_module("jax")
    models = importlib.import_module("jax_sysid.models")
    utils = importlib.import_module("jax_sysid.utils")
    import numpy as np

    @jax.jit
    def state(x, u, params):
        a, b, _, w1, w2, w3, b1, b2, *_ = params
        return a @ x + b @ u + w3 @ jax.nn.sigmoid(w1 @ x + w2 @ u + b1) + b2

    @jax.jit
    def output(x, u, params):
        del u
        c, (w4, w5, b3, b4) = params[2], params[8:]
        return c @ x + w5 @ jax.nn.sigmoid(w4 @ x + b3) + b4

    n, rng = neurons, np.random.default_rng(seed)

    def normal(spread: float, *shape: int):
        return spread * rng.standard_normal(shape)

    start = [0.5 * np.eye(2), normal(0.1, 2, 1), normal(0.1, 1, 2)]
    start += [normal(0.1, n, 2), normal(0.5, n, 1), normal(0.5, 2, n)]
    start += [np.zeros(n), np.zeros(2)]
    start += [normal(0.5, n, 2), normal(0.5, 1, n), np.zeros(n), np.zeros(1)]
    signals = [np.concatenate(s)[:, None] for s in zip(*parts["train"], strict=True)]
    scale = [utils.standard_scale(signal)[1:] for signal in signals]
    us, ys = ([], [])
    for u, y in parts["train"]:
        us.append(_scaled(u, scale[0]))
        ys.append(_scaled(y, scale[1]))
    model = models.Model(2, 1, 1, state_fcn=state, output_fcn=output)
    clock = Clock()
    model.init(params=start, x0=[np.zeros(2)] * len(us))
    model.loss(rho_x0=WEIGHT, rho_th=WEIGHT)
    model.optimization(adam_epochs=adam, lbfgs_epochs=lbfgs, iprint=-1)
    model.fit(ys, us)
    return model, clock.read(), scale


def _scaled(signal: Any, scale: Any) -> Any:
    mean, gain = scale
    return (signal[:, None] - mean) * gain


def _sysid_run(model: Any, x: Any, u: Any, scale: Any) -> Any:
    import numpy as np

    mean, gain = scale[1]
    y, _ = model.predict(np.asarray(x), _scaled(u, scale[0]))
    return (np.asarray(y) / gain + mean)[:, 0]


def _learned(model: Any, u: Any, y: Any, start: int, scale: Any) -> Any:
    """Initial state from the first samples by the model's own filter and smoother."""
    first = _scaled(u, scale[0])[:start], _scaled(y, scale[1])[:start]
    return model.learn_x0(*first, verbosity=False)


def _training_states(model: Any, records: list[Record], scale: Any) -> Any:
    """States at the beginning of the training records, and just after their end."""
    import numpy as np

    begins = model.x0 if isinstance(model.x0, list) else [model.x0]
    ends = []
    for x, (u, _) in zip(begins, records, strict=True):
        inputs = _scaled(u, scale[0])
        _, states = model.predict(np.asarray(x), inputs)
        ends.append(model.state_fcn(states[-1], inputs[-1], model.params))
    return begins, ends


WORKERS: dict[str, Callable[..., dict[str, Any]]] = {
    "installed": installed,
    "prepare": prepare,
    "own": run_own,
    "fastcan": run_fastcan,
    "jax-sysid": run_jax_sysid,
}
