"""Long records piece by piece, so that intermediate results stay near the cache."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, PyTree, Shaped


def map_blocks(
    f: Callable[[Any], PyTree[Shaped[Array, "rows ..."]]], columns: Any, size: int
) -> PyTree[Shaped[Array, "time ..."]]:
    """`f(columns)` for an `f` that treats every sample alone, `size` samples at a time.

    `columns` is a tree of (channels, time) arrays, results have time first. The
    derivative computes a block again rather than keep what it needs of all of them: on
    CPU memory traffic, not arithmetic, is what long records cost. Records of fewer than
    four blocks are done in one piece.
    """
    time = jax.tree.leaves(columns)[0].shape[1]
    blocks = -(-time // size)
    if blocks < 4:
        return f(columns)

    def cut(a):
        padded = jnp.pad(a, ((0, 0), (0, blocks * size - time)), mode="edge")
        return jnp.moveaxis(padded.reshape(a.shape[0], blocks, size), 1, 0)

    pieces = jax.lax.map(
        jax.checkpoint(f, prevent_cse=False), jax.tree.map(cut, columns)
    )
    return jax.tree.map(lambda a: a.reshape(blocks * size, *a.shape[2:])[:time], pieces)
