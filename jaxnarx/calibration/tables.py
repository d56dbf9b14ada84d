"""Scalars, curves and maps as control units compute them: arrays."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class LookupTable(eqx.Module):
    """Values over points of no, one or two signals, in physical units."""

    value: Float[Array, "*shape"]
    axes: tuple[Float[Array, " _"], ...] = ()

    def __call__(self, *signals: Float[Array, "*samples"]) -> Float[Array, "*samples"]:
        """The value at samples of the signals, linear between points, held beyond."""
        if not self.axes:
            return self.value
        places = [place(a, x) for a, x in zip(self.axes, signals, strict=True)]
        if len(self.axes) == 1:
            ((n, part),) = places
            return (1 - part) * self.value[n] + part * self.value[n + 1]
        (i, x), (j, y) = places
        v = self.value
        near = (1 - y) * v[i, j] + y * v[i, j + 1]
        return (1 - x) * near + x * ((1 - y) * v[i + 1, j] + y * v[i + 1, j + 1])

    def visits(self, *signals: Float[Array, "*samples"]) -> Float[Array, "*shape"]:
        """How many samples every point serves: sums of its weights."""
        count = jnp.zeros_like(self.value)
        if not self.axes:
            return count + 1.0
        places = [place(a, x) for a, x in zip(self.axes, signals, strict=True)]
        if len(self.axes) == 1:
            ((n, part),) = places
            return count.at[n].add(1 - part).at[n + 1].add(part)
        (i, x), (j, y) = places
        count = count.at[i, j].add((1 - x) * (1 - y)).at[i, j + 1].add((1 - x) * y)
        return count.at[i + 1, j].add(x * (1 - y)).at[i + 1, j + 1].add(x * y)

    def steps(self) -> tuple[Float[Array, "*_"], ...]:
        """Changes from one point to the next, along every axis."""
        return tuple(jnp.diff(self.value, axis=n) for n in range(len(self.axes)))

    def roughness(self, width: Float[Array, ""]) -> Float[Array, ""]:
        """Mean squared change of the slope from point to point, over a width; by the
        number of points, as if they were at equal distances."""
        found = jnp.zeros((), self.value.dtype)
        for n, axis in enumerate(self.axes):
            if axis.shape[0] > 2:
                bent = jnp.diff(self.value, n=2, axis=n) / width
                found = found + jnp.mean(bent**2)
        return found


def place(axis: Float[Array, " points"], x: Float[Array, "*samples"]):
    """The point before every sample, and the share of the way to the next."""
    held = jnp.clip(x, axis[0], axis[-1])
    n = jnp.clip(jnp.searchsorted(axis, held, side="right") - 1, 0, axis.shape[0] - 2)
    return n, (held - axis[n]) / (axis[n + 1] - axis[n])
