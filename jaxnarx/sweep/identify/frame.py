"""What all members and cases of a sweep share: the pool's tables and the settings."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from jaxnarx.arrays.contraction import positions
from jaxnarx.data import Channels
from jaxnarx.errors import SpecError
from jaxnarx.methods import Identification
from jaxnarx.partition import scheduling_table
from jaxnarx.regressors import Pool, polynomial_pool


class Frame(eqx.Module):
    """The candidates as tables, and the settings that fix the program.

    `position` says where a term stands in a contraction, `constant` is the place of the
    constant term, None in a pool without it.
    """

    factor: Int[Array, "terms degree"]
    position: Int[Array, " terms"]
    constant: int | None = eqx.field(static=True)
    method: Identification = eqx.field(static=True)

    @property
    def slots(self) -> int:
        """Capacity for chosen terms."""
        return min(self.method.max_terms, self.factor.shape[0])


def make_pool(method: Identification, channels: Channels) -> Pool:
    """The polynomial pool that the settings describe, of one output."""
    return polynomial_pool(
        channels,
        outputs=[method.output] if method.output else None,
        degree=method.degree,
        **method.lags,
    )


def make_frame(method: Identification, pool: Pool) -> Frame:
    """Tables of a pool; `SpecError` unless it models one output and has the scheduling
    variables."""
    if len(pool.outputs) != 1:
        raise SpecError(
            "a sweep identifies one output; name it, with output='...', or give a pool "
            "of one, with outputs=['...']",
            field="output",
        )
    scheduling_table(pool, tuple(method.scheduling))
    place = positions(pool.factor, len(pool.variables) + 1)
    constant = np.flatnonzero(~pool.factor.any(axis=1))
    return Frame(
        jnp.asarray(pool.factor),
        jnp.asarray(place),
        int(constant[0]) if constant.size else None,
        method,
    )
