"""Terms and scheduling variables to grow a network from."""

import numpy as np

from jaxnarx.regressors import Pool, Variables, parse_variable
from jaxnarx.selection import Selection


def terms_to_use(source: Selection | Pool) -> tuple[Pool, list[np.ndarray]]:
    """The pool and, per modelled output, the index rows of the terms to use."""
    if isinstance(source, Pool):
        return source, [source.factor] * len(source.outputs)
    pool = source.pool
    return pool, [pool.factor[source.terms(o)] for o in range(len(pool.outputs))]


def scheduling_table(pool: Pool, names: tuple[str, ...]) -> Variables:
    """Read scheduling variables from their texts."""
    table = Variables.of([parse_variable(pool.channels, n) for n in names])
    modelled = [len(pool.channels.inputs) + o for o in pool.outputs]
    table.require_measured(modelled, pool.channels.names)
    return table
