"""Problems for the analysis of variance: inputs at lag 0, so that lagged variables are
what is written down, and most with the same number of samples.
"""

import itertools

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxnarx.data import Dataset
from jaxnarx.regressors import Pool, polynomial_pool
from jaxnarx.regressors.rows import Rows, regression_rows
from jaxnarx.selection.anova.table import AnovaTable, anova
from jaxnarx.settings.anova import Anova

ROWS = 1200


def problem(x: np.ndarray, y: np.ndarray, degree: int = 2) -> tuple[Pool, Rows]:
    data = Dataset.from_arrays(
        x,
        y[:, None],
        inputs=[f"x{i + 1}" for i in range(x.shape[1])],
        outputs=["y"],
        sample_time=1.0,
    )
    pool = polynomial_pool(
        data.channels, input_lags=(0,), output_lags=(), degree=degree
    )
    outputs = pool.variables, pool.outputs
    return pool, regression_rows(data, *outputs, history=0, exact=True)


def table(x: np.ndarray, y: np.ndarray, method: Anova | None = None) -> AnovaTable:
    return anova(*problem(x, y), 0, method or Anova())


def with_output(rows: Rows, y: np.ndarray) -> Rows:
    return eqx.tree_at(lambda r: r.y, rows, jnp.asarray(y)[None])


def uniform(variables: int, rows: int = ROWS, seed: int = 0) -> np.ndarray:
    return np.random.default_rng([seed, variables]).uniform(-1, 1, (rows, variables))


def noise(rows: int = ROWS, seed: int = 0) -> np.ndarray:
    return np.random.default_rng([seed, 5]).normal(size=rows)


def layout(shape: tuple[int, ...], replicates: int, seed: int = 0):
    """Codes (rows, vars) of a full factorial and a response with every effect."""
    cells = np.array(list(itertools.product(*map(range, shape))))
    codes = np.repeat(cells, replicates, axis=0)
    rng = np.random.default_rng(seed)
    mean = rng.normal(size=len(cells))
    y = np.repeat(mean, replicates) + rng.normal(size=len(codes))
    return codes, y - y.mean()
