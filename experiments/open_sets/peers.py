"""Trees and SysIdentPy on one output of an open set, each in a process of its own.

They run in the peers' interpreter (`pip install sysidentpy scikit-learn`) and read what
`packed.pack` has written. Nothing of the test is looked at before the one scoring.

Trees: histogram gradient boosting of scikit-learn on lagged inputs alone, so that a run
is free by construction. Lags are spaced logarithmically up to a memory, with the mean
of the inputs between neighbouring ones; before a record its first input is held. Memory
and number of trees have the smallest error on the last quarter of every training
record; then all training samples are used.

SysIdentPy: FROLS as it comes (degree 2, lags 1 and 2, AIC, recursive least squares),
and with BIC and least squares, where the longest lag of 2 to 5 has the smallest error
of the free run on the last quarter of every training record. Signals are divided by
their largest magnitude in the training, as in its documentation; records are laid end
to end, for it knows but one. Its run begins with the measurements before the first
scored sample.
"""

import importlib
import importlib.metadata
import importlib.util
import os
import time
import warnings
from typing import Any

from packed import Runs, Task, unpack
from score import digits, errors, far

PACKAGES = {"scikit-learn": "sklearn", "sysidentpy": "sysidentpy"}
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

MEMORIES = (16, 64, 256)
"""Longest lags of the trees, the longer only up to a quarter of a training record."""

TREES, RATE, ROWS = 400, 0.05, 50_000
"""Most trees, learning rate, and most rows that trees are grown on: of more, every
so many-th."""

DEGREE, LAGS, TERMS = 2, (2, 3, 4, 5), 30
"""Of FROLS with BIC: degree, longest lags tried, most terms."""

SAMPLES = 10_000
"""Most samples that FROLS is given, the first of every record. Rows of the table that
say 20,000 were made before this was halved, for the time of the virtual engines."""

BACK = 0.25
"""Share of the end of every training record that judges."""


def installed() -> dict[str, str]:
    """Versions of the peers this interpreter has."""
    return {
        package: importlib.metadata.version(package)
        for package, module in PACKAGES.items()
        if importlib.util.find_spec(module) is not None
    }


def gently() -> None:
    """One core, behind everything else that runs; before numpy is imported."""
    os.nice(10)
    os.environ.update(dict.fromkeys(THREADS, "1"))
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def judged(task: Task, run_of: Any) -> dict[str, Any]:
    """Errors by part of the runs that `run_of` makes of the parts."""
    import numpy as np

    found = {}
    for name, part in task.parts.items():
        runs = run_of(part)
        counted = [np.arange(len(y)) >= part.first for y in part.truth]
        diverged = sum(far(run, task.train.y, part.first) for run in runs)
        row = errors(part.truth, runs, counted, task.scale)
        found[name] = row | {"diverged": diverged}
    return found


def borders_of(train: Runs) -> list[int]:
    """Where the end of every training record begins, which judges."""
    return [int((1 - BACK) * len(y)) for y in train.y]


def divided(train: Runs) -> tuple[Runs, Runs]:
    """The beginning of every training record, and its end."""
    triples = list(zip(train.u, train.y, borders_of(train), strict=True))
    head = [y[:b] for _, y, b in triples]
    tail = [y[b:] for _, y, b in triples]
    return (
        Runs([u[:b] for u, _, b in triples], head, head),
        Runs([u[b:] for u, _, b in triples], tail, tail),
    )


# Trees -------------------------------------------------------------------------------


def lags_to(memory: int) -> list[int]:
    """0, 1, 2, 3, 4, 6, 8, 12, 16, ... up to `memory`."""
    found, step = [0, 1, 2, 3], 4
    while step <= memory:
        found += [step, step + step // 2]
        step *= 2
    return [lag for lag in found if lag <= memory]


def history(u: Any, memory: int) -> Any:
    """Lagged inputs, and means between lags that are not neighbours, (time, columns).

    Before the record its first input is held.
    """
    import numpy as np

    lags = lags_to(memory)
    long = np.concatenate([np.repeat(u[:1], memory, axis=0), u])
    sums = np.concatenate([np.zeros_like(long[:1]), np.cumsum(long, axis=0)])
    at = np.arange(len(u)) + memory
    found = [long[at - lag] for lag in lags]
    for near, distant in zip(lags, lags[1:], strict=False):
        if distant - near > 1:
            total = sums[at - near + 1] - sums[at - distant]
            found.append(total / (distant - near + 1))
    return np.concatenate(found, axis=1)


def rows_of(runs: Runs, memory: int, most: int) -> tuple[Any, Any]:
    """Histories and outputs of all records, thinned to at most about `most` rows."""
    import numpy as np

    every = max(1, -(-sum(map(len, runs.y)) // most))
    x = np.concatenate([history(u, memory)[::every] for u in runs.u])
    return x, np.concatenate([y[::every] for y in runs.y])


def boosted(trees: int) -> Any:
    """The regressor, by one core, without a choice of its own."""
    ensemble = importlib.import_module("sklearn.ensemble")
    return ensemble.HistGradientBoostingRegressor(
        max_iter=trees, learning_rate=RATE, early_stopping=False, random_state=0
    )


def trees(path: str, output: str, small: bool) -> dict[str, Any]:
    """Choose memory and number of trees, grow, score."""
    gently()
    begin, task = time.perf_counter(), unpack(path, output)
    most, shortest = 10 if small else TREES, min(map(len, task.train.y))
    score, memory, count = min(
        _memory(task.train, memory, most)
        for memory in MEMORIES[: 1 if small else None]
        if memory == MEMORIES[0] or 4 * memory <= shortest
    )
    x, y = rows_of(task.train, memory, ROWS)
    model = boosted(count).fit(x, y)
    found = judged(
        task, lambda part: [model.predict(history(u, memory)) for u in part.u]
    )
    return {
        "test": found,
        "held_back_nrmse": digits(score),
        "memory": memory,
        "trees": count,
        "columns": x.shape[1],
        "rows": len(y),
        "of": sum(map(len, task.train.y)),
        "seconds": round(time.perf_counter() - begin, 1),
    }


def _memory(train: Runs, memory: int, most: int) -> tuple[float, int, int]:
    """Smallest error on what is held back, with the memory and the number of trees."""
    import numpy as np

    # Histories of whole records, so that those of the end look back beyond the border.
    histories = [history(u, memory) for u in train.u]
    borders = borders_of(train)
    every = max(1, -(-sum(borders) // ROWS))
    parts = list(zip(histories, train.y, borders, strict=True))
    x = np.concatenate([h[:b:every] for h, _, b in parts])
    y = np.concatenate([t[:b:every] for _, t, b in parts])
    model = boosted(most).fit(x, y)
    behind = np.concatenate([h[b::every] for h, _, b in parts])
    target = np.concatenate([t[b::every] for _, t, b in parts])
    squares = [np.mean((run - target) ** 2) for run in model.staged_predict(behind)]
    best = int(np.argmin(squares))
    return float(np.sqrt(squares[best]) / target.std()), memory, best + 1


# SysIdentPy --------------------------------------------------------------------------


class Frols:
    """A choice by FROLS of SysIdentPy, with the gains of the signals."""

    def __init__(self, model: Any, gain_u: Any, gain_y: float):
        self.model, self.gain_u, self.gain_y = model, gain_u, gain_y

    def run(self, u: Any, y: Any, first: int) -> Any:
        """Free run of a record from sample `first` on; NaN behind a failure."""
        import numpy as np

        start = first - self.model.max_lag
        measured = y[start:first, None] / self.gain_y
        run = np.full(len(y), np.nan)
        run[:first] = y[:first]
        # It refuses to go on where a value overflows.
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                found = self.model.predict(X=u[start:] / self.gain_u, y=measured)
            except (ValueError, OverflowError, FloatingPointError):
                return run
        run[first:] = self.gain_y * found[self.model.max_lag :, 0]
        return run

    @property
    def size(self) -> int:
        """Number of terms."""
        return len(self.model.final_model)


def frols(train: Runs, lag: int, **options: Any) -> Frols:
    """Choose terms on all records laid end to end."""
    import numpy as np

    structure = importlib.import_module("sysidentpy.model_structure_selection")
    u, y = np.concatenate(train.u), np.concatenate(train.y)
    gain_u = np.maximum(np.abs(u).max(axis=0), 1e-300)
    gain_y = max(float(np.abs(y).max()), 1e-300)
    lags = list(range(1, lag + 1))
    several = [lags] * u.shape[1] if u.shape[1] > 1 else lag
    model = structure.FROLS(xlag=several, ylag=lag, **options)
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model.fit(X=u / gain_u, y=(y / gain_y)[:, None])
    return Frols(model, gain_u, gain_y)


def shortened(train: Runs) -> Runs:
    """The first `SAMPLES` samples of the records together."""
    share = min(1.0, SAMPLES / sum(map(len, train.y)))
    u, y = ([a[: int(share * len(a))] for a in x] for x in (train.u, train.y))
    return Runs(u, y, y)


def told(task: Task, train: Runs, found: Frols, begin: float) -> dict[str, Any]:
    """Errors on the test, size, samples and seconds."""
    return {
        "test": judged(
            task,
            lambda part: [
                found.run(u, y, part.first) for u, y in zip(part.u, part.y, strict=True)
            ],
        ),
        "terms": found.size,
        "lag": int(found.model.max_lag),
        "rows": sum(map(len, train.y)),
        "of": sum(map(len, task.train.y)),
        "seconds": round(time.perf_counter() - begin, 1),
    }


def defaults(path: str, output: str, small: bool) -> dict[str, Any]:
    """FROLS as it comes."""
    gently()
    begin, task = time.perf_counter(), unpack(path, output)
    train = shortened(task.train)
    return told(task, train, frols(train, 2), begin)


def bic(path: str, output: str, small: bool) -> dict[str, Any]:
    """FROLS with BIC and least squares; the longest lag by a free run held back."""
    gently()
    begin, task = time.perf_counter(), unpack(path, output)
    train = shortened(task.train)
    head, tail = divided(train)
    lags = LAGS[:1] if small else LAGS
    tried = {lag: digits_or_none(_held_back(head, tail, lag)) for lag in lags}
    best = min(lags, key=lambda lag: (tried[lag] is None, tried[lag]))
    found = told(task, train, _by_bic(train, best), begin)
    return found | {"held_back_nrmse": {str(k): v for k, v in tried.items()}}


def digits_or_none(value: float | None) -> float | None:
    """Rounded for the table."""
    return None if value is None else digits(value)


def _by_bic(train: Runs, lag: int) -> Frols:
    basis = importlib.import_module("sysidentpy.basis_function")
    estimation = importlib.import_module("sysidentpy.parameter_estimation")
    return frols(
        train,
        lag,
        info_criteria="bic",
        n_info_values=TERMS,
        basis_function=basis.Polynomial(degree=DEGREE),
        estimator=estimation.LeastSquares(),
    )


def _held_back(head: Runs, tail: Runs, lag: int) -> float | None:
    """NRMSE of the free run behind the border."""
    import numpy as np

    found, first = _by_bic(head, lag), max(LAGS)
    runs = [found.run(u, y, first) for u, y in zip(tail.u, tail.y, strict=True)]
    counted = [np.arange(len(y)) >= first for y in tail.y]
    return errors(tail.y, runs, counted)["nrmse"]


PEERS = {
    "trees": (trees, "scikit-learn"),
    "SysIdentPy": (defaults, "sysidentpy"),
    "SysIdentPy BIC": (bic, "sysidentpy"),
}
"""Workers by the name of their column, and the package they need."""
