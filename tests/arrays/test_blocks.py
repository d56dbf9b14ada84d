"""Functions of samples, piece by piece and in one piece."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnarx.arrays.blocks import map_blocks


def features(columns):
    """Two rows of each sample from a tree of columns; time first."""
    a, (b,) = columns
    return jnp.stack([jnp.sum(jnp.sin(a), axis=0), b[0] * a[1]], axis=1)


@pytest.mark.parametrize("size", [8, 9, 13, 40])
def test_blocks_are_the_whole(size):
    rng = np.random.default_rng(0)
    columns = (
        jnp.asarray(rng.normal(size=(3, 40))),
        (jnp.asarray(rng.normal(size=(1, 40))),),
    )
    cotangent = jnp.asarray(rng.normal(size=(40, 2)))

    def pulled(f):
        y, back = jax.vjp(f, columns)
        return y, back(cotangent)

    whole = jax.jit(lambda: pulled(features))()
    blocks = jax.jit(lambda: pulled(lambda c: map_blocks(features, c, size)))()
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(blocks), strict=True):
        # The same operations on every sample.
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-15)
