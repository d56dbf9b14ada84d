"""Inner products of every polynomial term with a vector, the pool never formed.

With `v = [1, x_1 ... x_V]` a term of degree 3 is a row (i, j, k), i <= j <= k, that
means `v_i v_j v_k`. For a vector q the products `c_(ijk) = sum_n v_i v_j v_k q_n` of
all terms are entries of one matrix product per block of samples,

    T[(i,j), k] = sum_n (v_i v_j)_n (v_k q)_n ,

read back through the index table. Degree 1 and 2 use single variables on the left,
degree 4 pairs on both sides.

Sorted rows need only `k >= j`. With the left rows sorted by j, the right variables are
cut into tiles, and a tile meets only the left rows that can precede it; this saves
about 60 % of the plain product's work at degree 3.
"""

import dataclasses
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

BLOCK = 512
"""Samples per block: the left products of 41 variables then stay near the cache."""

TILE = 14
"""Right-hand variables per tile: narrower saves work but starves the matrix product."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """Index tables of the contraction for `variables` (the one included) and `degree`.

    `left` and `right` hold variable indices, (rows, factors); `tiles` is a tuple of
    (left rows, right start, right stop). Computed once on the host; static.
    """

    left: np.ndarray
    right: np.ndarray
    tiles: tuple[tuple[int, int, int], ...]

    @property
    def offsets(self) -> np.ndarray:
        """Start of each tile in the flattened result; the last entry is its length."""
        sizes = [rows * (stop - start) for rows, start, stop in self.tiles]
        return np.cumsum([0, *sizes])


def _monomials(variables: int, factors: int) -> np.ndarray:
    """Sorted index rows of one or two factors, ordered by last index, then first."""
    if factors == 1:
        return np.arange(variables)[:, None]
    return np.array([(i, j) for j in range(variables) for i in range(j + 1)])


@lru_cache(maxsize=32)
def plan(variables: int, degree: int) -> Plan:
    """Tables for terms of up to `degree` (1 to 4) in `variables` variables.

    `variables` counts the leading one of `v`.
    """
    if not 1 <= degree <= 4:
        raise ValueError(f"degree must be 1 to 4, got {degree}")
    left = _monomials(variables, 1 if degree <= 2 else 2)
    right = _monomials(variables, 1 if degree <= 3 else 2)
    right = right[np.lexsort(right.T[::-1])]
    tiles = []
    width = TILE if degree <= 3 else 32
    for start in range(0, len(right), width):
        stop = min(start + width, len(right))
        rows = int(np.sum(left[:, -1] <= right[stop - 1, 0]))
        tiles.append((rows, start, stop))
    return Plan(left, right, tuple(tiles))


def positions(
    factor: Int[np.ndarray, "terms degree"], variables: int
) -> Int[np.ndarray, " terms"]:
    """Where each term stands in the flattened result of `contract`.

    Rows need not be sorted; index 0 means "times one".
    """
    degree = factor.shape[1]
    tables = plan(variables, degree)
    rows = np.sort(factor, axis=1)
    if degree == 1:
        rows = np.concatenate([np.zeros_like(rows), rows], axis=1)
    half = tables.left.shape[1]
    left, right = rows[:, :half], rows[:, half:]
    left_at = (
        left[:, -1] * (left[:, -1] + 1) // 2 + left[:, 0] if half == 2 else left[:, 0]
    )
    if right.shape[1] == 2:
        order = {tuple(r): n for n, r in enumerate(tables.right.tolist())}
        right_at = np.array([order[tuple(r)] for r in right.tolist()], dtype=int)
    else:
        right_at = right[:, 0]
    starts = np.array([start for _, start, _ in tables.tiles])
    widths = np.array([stop - start for _, start, stop in tables.tiles])
    tile = np.searchsorted(starts, right_at, side="right") - 1
    return tables.offsets[tile] + left_at * widths[tile] + right_at - starts[tile]


def _product(v: Float[Array, "vars block"], table: np.ndarray):
    columns = [v[table[:, k]] for k in range(table.shape[1])]
    return columns[0] if len(columns) == 1 else columns[0] * columns[1]


def contract(
    v: Float[Array, "vars time"], q: Float[Array, "vectors time"], degree: int
) -> Float[Array, "vectors products"]:
    """All products of up to `degree` variables, summed against each vector of `q`.

    `v` carries the leading row of ones. The result is flat; `positions` says where a
    term stands in it. `2 L R N` floating-point operations per vector with L left rows
    and R right variables, less what the tiles save; memory of one block beside the
    result.
    """
    tables = plan(v.shape[0], degree)
    length = v.shape[1]
    blocks, rest = divmod(length, BLOCK)

    def block(v, q):
        left = _product(v, tables.left)
        right = _product(v, tables.right)
        weighted = right[None] * q[:, None]
        return [
            jnp.einsum("lt,qrt->qlr", left[:rows], weighted[:, start:stop])
            for rows, start, stop in tables.tiles
        ]

    def body(carry, start):
        vb = jax.lax.dynamic_slice_in_dim(v, start, BLOCK, axis=1)
        qb = jax.lax.dynamic_slice_in_dim(q, start, BLOCK, axis=1)
        return [c + t for c, t in zip(carry, block(vb, qb), strict=True)], None

    # The remainder goes first: it gives the carry its shapes.
    total = block(v[:, length - rest :], q[:, length - rest :])
    if blocks:
        total, _ = jax.lax.scan(body, total, jnp.arange(blocks) * BLOCK)
    return jnp.concatenate([t.reshape(q.shape[0], -1) for t in total], axis=1)
