"""A search in centred coordinates, and the way back to the pool's own terms."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.regressors import Centring, Pool
from jaxnarx.selection.basis import Basis
from jaxnarx.selection.path import Path
from jaxnarx.selection.program import (
    Method,
    adds_constant,
    allowed_terms,
    constant_term,
)


def centred_search(pool: Pool, v, centre: Centring, method: Method, usable):
    """Variables and table of a search in centred coordinates, and every term's parts.

    Where the pool lacks parts of its terms, its terms themselves are the variables.
    """
    allowed = allowed_terms(pool, method, usable)
    constant = constant_term(pool) if adds_constant(method) else None
    parents, complete = centre.parents(pool.factor, allowed, constant)
    if complete:
        return centre.centre(v), pool.factor, parents
    there = allowed.copy()
    there[[] if constant is None else [constant]] = True
    own = np.flatnonzero(there)
    r, _ = centre.columns(pool.factor[own], v)
    every = jnp.zeros((len(pool) + 1, v.shape[1]), v.dtype).at[0].set(1.0)
    every = every.at[own + 1].set(r)
    return every, np.arange(1, len(pool) + 1, dtype=np.int32)[:, None], parents


def target_offset(
    pool: Pool, centre: Centring, there: Bool[np.ndarray, " terms"]
) -> Float[Array, "lanes 1"]:
    """The offset that is taken off every lane; nothing without a constant to give it
    back."""
    constant = constant_term(pool)
    given = constant is not None and bool(there[constant])
    return jnp.asarray(centre.target * given)[:, None]


def backs(pool: Pool, centre: Centring, basis: Basis):
    """The maps from the columns of every lane's search to its terms."""
    index, count = np.asarray(basis.index), np.asarray(basis.count)
    out = np.tile(np.eye(index.shape[1]), (len(index), 1, 1))
    for back, terms, n in zip(out, index, count.tolist(), strict=True):
        back[:n, :n] = centre.reduce(pool.factor[terms[:n]])[0]
    return jnp.asarray(out, basis.gain.dtype)


def give_back_offsets(pool: Pool, path: Path, target: Float[Array, "lanes 1"]) -> Path:
    """The outputs' offsets added to the coefficients of the constant."""
    at = path.index == (-1 if (c := constant_term(pool)) is None else c)
    slot = jnp.arange(at.shape[1])
    there = at & (slot[None] < path.count[:, None])
    sizes = slot[None, :, None] >= slot[None, None]
    more = jnp.where(there[:, None] & sizes, target[..., None], 0.0)
    return dataclasses.replace(path, nested=path.nested + more)
