"""Matrix times vector to about twice the working precision, from plain products.

Both factors are cut into slices of so few bits that the products of the leading slices
are sums of exact numbers: neither the order of the summation nor a fused multiply-add
can round them. K. Ozaki, T. Ogita, S. Oishi, S. Rump, Numerical Algorithms 59 (2012).
"""

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxnarx.arrays.column_scaling import power_of_two

Slices = tuple[Float[Array, "rows inner"], ...]


def slices(a: Float[Array, "rows inner"]) -> Slices:
    """`a` as a sum of three: two of few bits below each row's largest, and the rest."""
    inner = a.shape[1]
    digits = jnp.finfo(a.dtype).nmant + 1
    # One fewer than would do: the power of two nearest to a number may lie below it.
    bits = (digits - math.ceil(math.log2(max(inner, 2)))) // 2 - 1
    largest = jnp.max(jnp.abs(a), axis=1, keepdims=True)
    largest = power_of_two(jnp.where(largest > 0, largest, 1.0))
    parts = []
    for n in (1, 2):
        unit = largest * 2.0 ** (-n * bits)
        parts.append(jnp.round(a / unit) * unit)
        a = a - parts[-1]
    return (*parts, a)


def accurate_product(
    a: Slices, x: Float[Array, " inner"], start: Float[Array, " rows"] | None = None
) -> Float[Array, " rows"]:
    """`start + a @ x` for a matrix given by its `slices`, rounded nearly once.

    Beside the rounding of the result the error is about eps^1.5 times the number of
    products and the largest entries of row and vector.
    """
    parts = [part[0] for part in slices(x[None])]
    total = a[1] @ parts[1] + a[0] @ parts[2] + a[2] @ (parts[0] + parts[1])
    total = total + a[1] @ parts[2]
    middle, high = a[0] @ parts[1] + a[1] @ parts[0], a[0] @ parts[0]
    if start is not None:
        high = start + high
    return (total + middle) + high
