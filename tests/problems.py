"""A problem that tests of partitions share, and what is grown from it, once a process.

`tiny`: one record of a bent surface with noise, y over two inputs of the same sample.

Tests that need nothing else take it, so that their programs have the same shapes. Those
of runs and refinements have networks of one or several local models, by inputs and by
their own outputs, in `common.named`, on `common.dataset`.
"""

from functools import cache
from typing import Any

import numpy as np

from jaxnarx.data import Dataset
from jaxnarx.partition import grow
from jaxnarx.regressors import Pool, polynomial_pool
from jaxnarx.settings import Global, Grid, Lolimot, SigmoidTree
from jaxnarx.solution import Solution

ROWS = 240
SCHEDULE = {"tiny": ("u1[t]", "u2[t]")}
NAMES: dict[str, dict[str, Any]] = {
    "tiny": {"inputs": ["u1", "u2"], "outputs": ["y"], "sample_time": 1.0}
}
LAGS: dict[str, dict[str, Any]] = {"tiny": {"input_lags": (0,), "output_lags": ()}}


def records(name: str, us: Any, ys: Any, **more: Any) -> Dataset:
    """Other samples of the channels of a problem."""
    return Dataset.from_arrays(us, ys, **NAMES[name] | more)


@cache
def data(name: str = "tiny", seed: int = 0, outputs: int = 1) -> Dataset:
    """The records of a problem; `outputs=2`: of `tiny`, w = y^2 as well."""
    rng = np.random.default_rng(seed)
    u = np.column_stack([rng.uniform(10, 30, ROWS), rng.uniform(-1, 1, ROWS)])
    u[:2] = [[10.0, -1.0], [30.0, 1.0]]
    y = np.exp((u[:, 0] - 20) / 6) + 2 * u[:, 1] ** 2
    y = y + 0.05 * rng.normal(size=ROWS)
    both = np.column_stack([y, y**2])[:, :outputs]
    return records(name, u, both, outputs=["y", "w"][:outputs])


@cache
def pool(name: str = "tiny", degree: int = 1, outputs: int = 1) -> Pool:
    """Candidates of a problem."""
    channels = data(name, outputs=outputs).channels
    return polynomial_pool(channels, degree=degree, **LAGS[name])


def growth(name: str, **more: Any) -> dict[str, Any]:
    """How networks are grown from a problem: five local models at most."""
    settings = {"max_models": 5, "criterion": "none"} | more
    where = SCHEDULE[name]
    return {
        "global": Global(),
        "grid": Grid(where, models=(3,) + (2,) * (len(where) - 1)),
        "gaussians": Lolimot(where, **settings),
        "compact": Lolimot(where, validity="compact", **settings),
        "boxes": Lolimot(where, validity="boxes", **settings),
        "tree": SigmoidTree(where, steps=4, **settings),
        "straight": SigmoidTree(where, oblique=False, steps=4, **settings),
    }


@cache
def fitted(name: str, how: str, outputs: int = 1) -> Solution:
    """What `grow` returns for a problem."""
    numbers = data(name, outputs=outputs)
    return grow(pool(name, outputs=outputs), numbers, growth(name)[how])
