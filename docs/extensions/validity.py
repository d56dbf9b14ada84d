"""A validity function: bells with long tails, 1/(1 + distance^4), normalised."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxnarx.models import VALIDITIES, AbstractValidity


class Bells(AbstractValidity):
    trained = ("centre", "log_width")
    centre: Float[Array, "models dims"]
    log_width: Float[Array, "models dims"]

    def __call__(self, z, active):
        rows = (None,) * (z.ndim - 1)
        centre, width = self.centre[(..., *rows)], jnp.exp(self.log_width)[(..., *rows)]
        # Far away all bells vanish together: their ratios come from logarithms.
        square = jnp.sum(((z[None] - centre) / width) ** 2, axis=1)
        logit = -jnp.logaddexp(0.0, 2 * jnp.log(square + 1e-30))
        logit = jnp.where(active[(..., *rows)], logit, -jnp.inf)
        weight = jnp.exp(logit - logit.max(axis=0, keepdims=True))
        return weight / weight.sum(axis=0, keepdims=True)

    def limits(self, width_band):
        narrow, wide = jnp.log(jnp.asarray(width_band))
        low = Bells(jnp.minimum(self.centre, 0.0), self.log_width + narrow)
        return low, Bells(jnp.maximum(self.centre, 1.0), self.log_width + wide)

    def check(self, models, dims):
        if not self.centre.shape == self.log_width.shape == (models, dims):
            raise ValueError(f"centre is {self.centre.shape}, not {(models, dims)}")

    def regions(self, names, offset, span):
        centre, width = offset + span * self.centre, span * jnp.exp(self.log_width)
        return [
            {
                name: {"centre": float(c[d]), "width": float(w[d])}
                for d, name in enumerate(names)
            }
            for c, w in zip(centre, width, strict=True)
        ]


def example():
    centre = jnp.array([[0.2, 0.3], [0.5, 0.8], [0.9, 0.4]])
    return Bells(centre, jnp.full((3, 2), jnp.log(0.3))), 2


VALIDITIES.register("Bells", Bells, example=example)
