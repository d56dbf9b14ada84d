"""The pool's tables and the settings, which all members and cases of a sweep share."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from jaxnarx.arrays import positions
from jaxnarx.regressors import Pool
from jaxnarx.sweep.identify.settings import Shape


class Frame(eqx.Module):
    """The candidates as tables, and the settings that fix the program.

    `position` says where a term stands in a contraction, `constant` is the place of the
    constant term, None in a pool without it.
    """

    factor: Int[Array, "terms degree"]
    position: Int[Array, " terms"]
    constant: int | None = eqx.field(static=True)
    shape: Shape = eqx.field(static=True)

    @property
    def slots(self) -> int:
        """Capacity for chosen terms."""
        return min(self.shape.terms, self.factor.shape[0])


def make_frame(shape: Shape, pool: Pool) -> Frame:
    """Tables of a pool for one program."""
    place = positions(pool.factor, len(pool.variables) + 1)
    constant = np.flatnonzero(~pool.factor.any(axis=1))
    return Frame(
        jnp.asarray(pool.factor),
        jnp.asarray(place),
        int(constant[0]) if constant.size else None,
        shape,
    )
