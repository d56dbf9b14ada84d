"""Inner products of every polynomial term with a vector, the pool never formed.

With `v = [1, x_1 ... x_V]` a term of degree 3 is a row (i, j, k), i <= j <= k, that
means `v_i v_j v_k`. For a vector q the products `c_(ijk) = sum_n v_i v_j v_k q_n` of
all terms are entries of matrix products over blocks of samples,

    T[(j,i), k] = sum_n (v_j v_i)_n (v_k q)_n ,

read back through the index table. Degree 1 and 2 use single variables on the left,
degree 4 pairs on both sides.

The plain product computes almost every product three times. Sorted rows save that: the
middle index j is cut into groups s <= j < e, and in one group i < e and k >= s. The
shorter of these two ranges is multiplied by the middle one and stands on the left, the
longer stands on the right, so few products are formed and none of the matrix products
is narrow. At 42 variables and degree 3, 552 left rows are formed instead of 903, and
53 % of the plain operations remain, the rounded widths included.
"""

import dataclasses
from collections.abc import Callable
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

BLOCK_SAMPLES = 512
"""Samples per block, at most: a block's left products stay near the cache."""

WIDTH_MULTIPLE = 16
"""Right-hand widths are multiples of this: the matrix product has no faster tail."""

FORMING_COST, PACKING_COST, PRODUCT_COST = 16, 24, 100
"""Cost per sample of forming a left row, of packing a right row for one matrix product,
and of a matrix product, counted in multiplications inside one. Found by measurement."""

Range = tuple[int, int]


@dataclasses.dataclass(frozen=True)
class Group:
    """One matrix product: ranges (start, stop) of its factors.

    `left` holds one range of variables, or the middle and the outer one, whose products
    are formed; `right` is a range of right rows. `upper` says that the outer factor is
    the last of the term, not the first.
    """

    left: tuple[Range, ...]
    right: Range
    upper: bool = False

    @property
    def rows(self) -> int:
        """Number of left rows."""
        return int(np.prod([stop - start for start, stop in self.left]))

    @property
    def width(self) -> int:
        """Number of right rows, the padding included."""
        return self.right[1] - self.right[0]


@dataclasses.dataclass(frozen=True)
class ContractionPlan:
    """The matrix products for `variables` (the one included) and `degree`.

    Right rows are variables, at degree 4 pairs k <= l in lexical order; zeros fill them
    up to `right`. The tables are computed once on the host and are static.
    """

    variables: int
    degree: int
    groups: tuple[Group, ...]

    @property
    def offsets(self) -> Int[np.ndarray, " borders"]:
        """Start of each group in the flattened result; the last entry is its length."""
        return np.cumsum([0, *(group.rows * group.width for group in self.groups)])

    @property
    def right(self) -> int:
        """Number of right rows, the padding included."""
        return max(group.right[1] for group in self.groups)


def _pairs_before(k, variables: int):
    """Number of pairs (k', l), k' <= l, whose first index is less than `k`."""
    return k * variables - k * (k - 1) // 2


def _group(variables: int, degree: int, start: int, stop: int) -> Group:
    """The product of all terms whose left (degree 2) or middle index is in a range."""
    middle, low, high = (start, stop), (0, stop), (start, variables)
    if degree == 2:
        return Group((middle,), _widen_rows(high, variables))
    if degree == 4:
        pairs = _pairs_before(variables, variables)
        right = _pairs_before(start, variables), pairs
        return Group((middle, low), _widen_rows(right, pairs))
    if stop <= variables - start:
        return Group((middle, low), _widen_rows(high, variables))
    return Group((middle, high), _widen_rows(low, variables), upper=True)


def _cost(group: Group) -> int:
    products = group.rows * (group.width + FORMING_COST)
    return products + PACKING_COST * group.width + PRODUCT_COST


def _widen_rows(rows: Range, length: int) -> Range:
    """`rows` made a multiple of `WIDTH_MULTIPLE` wide, inside `length` where there
    is room."""
    start, stop = rows
    width = -(-(stop - start) // WIDTH_MULTIPLE) * WIDTH_MULTIPLE
    start = max(min(start, length - width), 0)
    return start, start + width


@lru_cache(maxsize=32)
def plan(variables: int, degree: int) -> ContractionPlan:
    """The cheapest groups for terms of up to `degree` (1 to 4) in `variables`.

    `variables` counts the leading one of `v`. Borders of the groups are found by
    dynamic programming.
    """
    if not 1 <= degree <= 4:
        raise ValueError(f"degree must be 1 to 4, got {degree}")
    if degree == 1:
        one = Group(((0, 1),), _widen_rows((0, variables), variables))
        return ContractionPlan(variables, degree, (one,))
    best: list[tuple[float, tuple[Group, ...]]] = [(0.0, ())]
    for stop in range(1, variables + 1):
        options = []
        for start in range(stop):
            group = _group(variables, degree, start, stop)
            options.append((best[start][0] + _cost(group), start, group))
        cost, start, group = min(options, key=lambda option: option[:2])
        best.append((cost, (*best[start][1], group)))
    return ContractionPlan(variables, degree, best[-1][1])


def positions(
    factor: Int[np.ndarray, "terms degree"], variables: int
) -> Int[np.ndarray, " terms"]:
    """The place of each term in the flattened result of `contract`.

    Rows need not be sorted; index 0 means "times one".
    """
    degree = factor.shape[1]
    tables = plan(variables, degree)
    rows = np.sort(factor, axis=1).astype(int)
    if degree == 1:
        return rows[:, 0]
    middle = rows[:, 0] if degree == 2 else rows[:, 1]
    last = rows[:, -1]
    if degree == 4:
        last = _pairs_before(rows[:, 2], variables) + rows[:, 3] - rows[:, 2]
    starts = np.array([group.left[0][0] for group in tables.groups])
    at = np.searchsorted(starts, middle, side="right") - 1

    def expand(value: Callable[[Group], int]):
        return np.array([value(group) for group in tables.groups])[at]

    row, right = middle - starts[at], last
    if degree > 2:
        upper = expand(lambda group: group.upper)
        outer, right = (
            np.where(upper, last, rows[:, 0]),
            np.where(upper, rows[:, 0], last),
        )
        first, stop = (expand(lambda group, n=n: group.left[1][n]) for n in (0, 1))
        row = row * (stop - first) + outer - first
    width = expand(lambda group: group.width)
    return (
        tables.offsets[at] + row * width + right - expand(lambda group: group.right[0])
    )


def _left_products(
    v: Float[Array, "vars block"], group: Group
) -> Float[Array, "rows block"]:
    """Left rows of a group, the outer factor running fastest."""
    first, *outer = (v[start:stop] for start, stop in group.left)
    for factor in outer:
        first = (first[:, None] * factor[None]).reshape(-1, v.shape[1])
    return first


def _right(
    v: Float[Array, "vars block"],
    q: Float[Array, "vectors block"],
    tables: ContractionPlan,
) -> Float[Array, "vectors right block"]:
    """Right rows times each vector, filled up with zeros."""
    right = v[None] * q[:, None]
    if tables.degree == 4:
        right = jnp.concatenate(
            [right[:, k, None] * v[None, k:] for k in range(len(v))], axis=1
        )
    padding = tables.right - right.shape[1]
    return jnp.pad(right, ((0, 0), (0, max(padding, 0)), (0, 0)))


def _products(
    v: Float[Array, "vars block"],
    q: Float[Array, "vectors block"],
    tables: ContractionPlan,
) -> list[Float[Array, "rows columns"]]:
    """The groups' matrix products in one block; columns are (vector, right row)."""
    right = _right(v, q, tables)

    def product(group: Group):
        columns = right[:, slice(*group.right)].reshape(-1, v.shape[1])
        return jnp.einsum("lt,rt->lr", _left_products(v, group), columns)

    return [product(group) for group in tables.groups]


def contract(
    v: Float[Array, "vars time"],
    q: Float[Array, "vectors time"],
    degree: int,
    *,
    squared: bool | Bool[Array, ""] = False,
) -> Float[Array, "vectors products"]:
    """All products of up to `degree` variables, summed against each vector of `q`.

    `v` carries the leading row of ones. The result is flat; `positions` says where a
    term stands in it, other entries mean nothing. Twice the length of the result
    floating-point operations per sample and vector; memory of one block beside the
    result. Several vectors in one call share the left products. `squared` takes the
    squares of `v`, as norms of terms need them, without a second `v` in memory; it may
    be traced, so that one program serves both.
    """
    tables = plan(v.shape[0], degree)
    vectors, length = q.shape
    blocks = max(-(-length // BLOCK_SAMPLES), 1)
    size = -(-length // (blocks * WIDTH_MULTIPLE)) * WIDTH_MULTIPLE
    rest = length - (blocks - 1) * size

    def pad(x):
        return jnp.pad(x, ((0, 0), (0, size - rest)))

    def powers(v):
        if isinstance(squared, bool):
            return v * v if squared else v
        return v * jnp.where(squared, v, 1.0)

    def body(carry, start):
        """Add the block that is carried, and fetch the next one.

        A block that is sliced where it is used is sliced anew inside every product, and
        forming the left rows then takes as long as multiplying them.
        """
        total, vb, qb = carry
        next_v = jax.lax.dynamic_slice_in_dim(v, start, size, axis=1)
        next_q = jax.lax.dynamic_slice_in_dim(q, start, size, axis=1)
        added = _products(vb, qb, tables)
        total = [a + b for a, b in zip(total, added, strict=True)]
        return (total, powers(next_v), next_q), None

    first = powers(pad(v[:, :rest])), pad(q[:, :rest])
    if blocks == 1:
        total = _products(*first, tables)
    else:
        zero = [
            jnp.zeros((group.rows, vectors * group.width), v.dtype)
            for group in tables.groups
        ]
        starts = rest + size * jnp.arange(blocks)
        (total, *_), _ = jax.lax.scan(body, (zero, *first), starts)
    by_vector = [t.reshape(len(t), vectors, -1).swapaxes(0, 1) for t in total]
    return jnp.concatenate([t.reshape(vectors, -1) for t in by_vector], axis=1)
