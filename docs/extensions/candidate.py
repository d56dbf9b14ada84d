"""A candidate of `identify`: Hammerstein models, powers of one input and no products.

A `Pool` is a table of integers: a row for every term, indices into [1, x_1 ... x_V].
"""

import numpy as np

from jaxnarx.identification import CANDIDATES
from jaxnarx.regressors import Pool, polynomial_pool
from jaxnarx.settings import ForwardOLS, Identification, SimulationError


def powers(data, output, lags, degree):
    """Lagged inputs to the powers 1 to `degree`, lagged outputs linear, a constant."""
    span = range(1, lags + 1)
    lagged = {"input_lags": span, "output_lags": span, "degree": degree}
    pool = polynomial_pool(data.channels, outputs=[output], **lagged)
    inputs = len(data.channels.inputs)
    fed_back = np.array([False, *(signal >= inputs for signal, _ in pool.variables)])
    alone = [len(set(row) - {0}) < 2 for row in pool.factor.tolist()]
    bent = fed_back[pool.factor].any(axis=1) & ((pool.factor > 0).sum(axis=1) > 1)
    kept = pool.factor[np.array(alone) & ~bent]
    return Pool(pool.variables, kept, pool.channels, pool.outputs)


def hammerstein(data, output):
    for lags, degree in ((2, 2), (2, 3), (4, 3)):
        pool = powers(data, output, lags, degree)
        terms = ForwardOLS(max_terms=min(12, len(pool)))
        refine = SimulationError(horizons=(10,), window_steps=4, max_steps=10)
        method = Identification(pool=pool, select=terms, refine=refine)
        yield f"powers up to {degree}, lags up to {lags}", method


CANDIDATES.register("Hammerstein", hammerstein)
