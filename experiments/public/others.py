"""jax-sysid and fastcan on one output of a set, each in a process of its own.

They run in the peers' interpreter (`pip install jax-sysid fastcan`) and read what
`packed.pack` has written; the first `SAMPLES` samples train. What is chosen has the
smallest error of the free run on the last quarter of every training record.

jax-sysid: the structure that was chosen for ours, a state-space model with polynomials
of states and inputs; a linear model of its own first, then everything by Adam and
L-BFGS, from three seeds, with the weight of the squared parameters chosen. A run begins
with the state that its own `learn_x0` finds on the official window.

fastcan: polynomial NARX, terms by its greedy selection, coefficients by its training
many steps ahead; longest lag and number of terms are chosen.
"""

import importlib
import importlib.metadata
import importlib.util
import itertools
import math
import time
from collections.abc import Callable
from typing import Any

from packed import Runs, unpack  # pyright: ignore
from peers import digits_or_none, divided, gently, judged  # pyright: ignore
from score import digits, errors  # pyright: ignore

PACKAGES = ("jax-sysid", "fastcan")
MODULES = {"jax-sysid": "jax_sysid", "fastcan": "fastcan"}
SAMPLES = 10_000
"""Most samples that train, the first of every record."""

SEEDS = (0, 1, 2)
WEIGHTS = (1e-2, 1e-4)
"""Of the squared parameters; the first is its default."""
EPOCHS = 500, 1000
"""Of Adam and of L-BFGS."""
LONGEST, TERMS, DEGREE = (3, 6), (8, 16), 2
"""Of fastcan: longest lags and numbers of terms tried."""


def installed() -> dict[str, str]:
    """Versions of the peers this interpreter has."""
    return {
        package: importlib.metadata.version(package)
        for package, module in MODULES.items()
        if importlib.util.find_spec(module) is not None
    }


def first_samples(train: Runs) -> Runs:
    """The first `SAMPLES` samples of the records together."""
    share = min(1.0, SAMPLES / sum(map(len, train.y)))
    u, y = ([a[: int(share * len(a))] for a in x] for x in (train.u, train.y))
    return Runs(u, y, y)


def held_back(run: Callable[[Any, Any, int], Any], tail: Runs, first: int) -> Any:
    """NRMSE of the runs of the ends of the records, behind `first` samples."""
    import numpy as np

    runs = [run(u, y, first) for u, y in zip(tail.u, tail.y, strict=True)]
    counted = [np.arange(len(y)) >= first for y in tail.y]
    return errors(tail.y, runs, counted)["nrmse"]


def scored(task: Any, run: Callable[[Any, Any, int, int], Any]) -> dict[str, Any]:
    """Errors of the parts, from runs of (inputs, output, window, first sample)."""
    return judged(
        task,
        lambda part: [
            run(u, y, part.window, part.first)
            for u, y in zip(part.u, part.y, strict=True)
        ],
    )


# jax-sysid ---------------------------------------------------------------------------


class StateSpace:
    """A polynomial state-space model of jax-sysid, with the scaling of its signals."""

    def __init__(self, train: Runs, states: int, degree: int):
        import numpy as np

        self.train, self.states = train, states
        u, y = np.concatenate(train.u), np.concatenate(train.y)
        self.u = u.mean(axis=0), np.maximum(u.std(axis=0), 1e-12)
        self.y = float(y.mean()), float(y.std())
        count = states + u.shape[1]
        rows = itertools.combinations_with_replacement(range(count + 1), degree)
        self.table = np.array(list(rows))

    def scaled(self, u: Any, y: Any) -> tuple[Any, Any]:
        """Inputs and outputs (time, channels)."""
        return (u - self.u[0]) / self.u[1], ((y - self.y[0]) / self.y[1])[:, None]

    def fit(self, seed: int, weight: float, epochs: tuple[int, int]) -> Any:
        """A linear model, then the same with products."""
        import numpy as np

        models = importlib.import_module("jax_sysid.models")
        jnp = importlib.import_module("jax.numpy")
        pairs = zip(self.train.u, self.train.y, strict=True)
        us, ys = zip(*(self.scaled(u, y) for u, y in pairs), strict=True)
        n, inputs, adam, lbfgs = self.states, us[0].shape[1], *epochs
        linear = models.LinearModel(n, 1, inputs, feedthrough=True)
        linear.loss(rho_x0=1e-3, rho_th=1e-4)
        linear.optimization(adam_epochs=adam, lbfgs_epochs=lbfgs, iprint=-1)
        linear.init(sigma=0.9, seed=seed)
        linear.fit(list(ys), list(us))
        alone = np.count_nonzero(self.table, axis=1) == 1
        place = self.table[alone].max(axis=1) - 1
        forward = np.zeros((n, len(self.table)))
        out = np.zeros((1, len(self.table)))
        a, b, c, d = (np.asarray(p) for p in linear.params)
        forward[:, alone] = np.hstack([a, b])[:, place]
        out[:, alone] = np.hstack([c, d])[:, place]
        table = jnp.asarray(self.table)

        def terms(x: Any, u: Any) -> Any:
            v = jnp.concatenate([jnp.ones(1), x, jnp.atleast_1d(u)])
            return jnp.prod(v[table], axis=1)

        model = models.Model(
            *(n, 1, inputs),
            state_fcn=lambda x, u, params: params[0] @ terms(x, u),
            output_fcn=lambda x, u, params: params[1] @ terms(x, u),
        )
        model.loss(rho_x0=1e-3, rho_th=weight, xsat=100.0)
        model.optimization(
            adam_eta=1e-3, adam_epochs=adam, lbfgs_epochs=lbfgs, iprint=-1
        )
        x0 = linear.x0
        model.init([forward, out], x0=x0 if isinstance(x0, list) else [x0] * len(us))
        model.fit(list(ys), list(us))
        return model

    def run(self, model: Any, u: Any, y: Any, window: int, first: int) -> Any:
        """Free run that begins with the window before sample `first`."""
        import numpy as np

        begin = first - window
        own, measured = self.scaled(u[begin:], y[begin:])
        x0 = model.learn_x0(
            own[:window], measured[:window], LBFGS_refinement=True, verbosity=False
        )
        found = np.asarray(model.predict(np.asarray(x0), own)[0])[:, 0]
        return np.concatenate([y[:begin], self.y[0] + self.y[1] * found])


def jax_sysid(
    path: str, output: str, small: bool, states: int, degree: int
) -> dict[str, Any]:
    """Choose the weight, train with every seed, score."""
    import numpy as np

    gently()
    begin, task = time.perf_counter(), unpack(path, output)
    train = first_samples(task.train)
    head, tail = divided(train)
    epochs, window = (20, 20) if small else EPOCHS, task.parts[next(iter(task.parts))]
    half = StateSpace(head, states, degree)
    tried = {}
    for weight in WEIGHTS[: 1 if small else None]:
        model = half.fit(SEEDS[0], weight, epochs)
        size = window.window
        tried[weight] = held_back(
            lambda u, y, first, m=model, w=size: half.run(m, u, y, w, first), tail, size
        )
    best = min(tried, key=lambda weight: (tried[weight] is None, tried[weight] or 0))
    whole, tests = StateSpace(train, states, degree), []
    for seed in SEEDS[: 1 if small else None]:
        model = whole.fit(seed, best, epochs)
        tests.append(scored(task, lambda *runs, m=model: whole.run(m, *runs)))
    test = {}
    for part in task.parts:
        own = [one[part] for one in tests]
        test[part] = own[0] | {"seeds": [one["rmse"] for one in own]}
        for key in ("rmse", "nrmse"):
            every = [one[key] for one in own]
            lost = any(value is None for value in every)
            test[part][key] = None if lost else digits(float(np.mean(every)))
    return {
        "test": test,
        "states": states,
        "degree": degree,
        "weight": best,
        "held_back_nrmse": {str(k): digits_or_none(v) for k, v in tried.items()},
        "parameters": whole.table.shape[0] * (states + 1),
        "operations": int((states + 1) * np.count_nonzero(whole.table)),
        "rows": sum(map(len, train.y)),
        "of": sum(map(len, task.train.y)),
        "fit_seconds": round(time.perf_counter() - begin, 1),
    }


# fastcan -----------------------------------------------------------------------------


def narx(train: Runs, lag: int, terms: int) -> Callable[[Any, Any, int], Any]:
    """A polynomial NARX model of fastcan; the function that runs it freely."""
    import numpy as np

    module = importlib.import_module("fastcan.narx")
    u, y = np.concatenate(train.u), np.concatenate(train.y)
    gain_u, gain_y = np.abs(u).max(axis=0), float(np.abs(y).max())
    sizes = [len(one) for one in train.y]
    inputs = u.shape[1]
    most = math.comb(lag * (inputs + 1) + inputs + DEGREE, DEGREE) - 1
    model = module.make_narx(
        *(u / gain_u, y / gain_y),
        n_terms_to_select=min(terms, most),
        max_delay=lag,
        poly_degree=DEGREE,
        session_sizes=sizes,
        include_zero_delay=[True] * inputs,
        refine_verbose=0,
        verbose=0,
    )
    model.fit(u / gain_u, y / gain_y, coef_init="one_step_ahead", session_sizes=sizes)

    def run(u: Any, y: Any, first: int) -> Any:
        start = first - model.max_delay_
        with np.errstate(all="ignore"):
            found = model.predict(u[start:] / gain_u, y_init=y[start:first] / gain_y)
        return np.concatenate([y[:start], gain_y * np.ravel(found)])

    return run


def fastcan(
    path: str, output: str, small: bool, states: int, degree: int
) -> dict[str, Any]:
    """Choose longest lag and number of terms, train, score."""
    gently()
    begin, task = time.perf_counter(), unpack(path, output)
    train = first_samples(task.train)
    head, tail = divided(train)
    tried = {}
    for lag, terms in itertools.product(LONGEST, TERMS):
        tried[lag, terms] = held_back(narx(head, lag, terms), tail, max(LONGEST))
        if small:
            break
    lag, terms = min(tried, key=lambda key: (tried[key] is None, tried[key] or 0))
    run = narx(train, lag, terms)
    return {
        "test": scored(task, lambda u, y, window, first: run(u, y, first)),
        "lag": lag,
        "parameters": terms + 1,
        "held_back_nrmse": {
            f"lag {lag}, {terms} terms": digits_or_none(v)
            for (lag, terms), v in tried.items()
        },
        "rows": sum(map(len, train.y)),
        "of": sum(map(len, task.train.y)),
        "fit_seconds": round(time.perf_counter() - begin, 1),
    }


PEERS = {"jax-sysid": jax_sysid, "fastcan": fastcan}
"""Workers by the name of their column, which is that of their package."""
