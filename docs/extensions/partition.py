"""A partition: Gaussians about centres as far from one another as samples allow."""

import dataclasses

import jax.numpy as jnp
import numpy as np

from jaxnarx.models import Gaussians
from jaxnarx.settings import PARTITIONS


@dataclasses.dataclass(frozen=True)
class Farthest:
    """Begins at the sample nearest to the mean; each next is farthest from all."""

    models: int = 3

    def __call__(self, scheduling, columns, output, weight):
        z = scheduling[:, weight > 0]
        middle = z.mean(axis=1, keepdims=True)
        chosen = [int(np.argmin(((z - middle) ** 2).sum(axis=0)))]
        while len(chosen) < self.models:
            apart = (z[:, :, None] - z[:, None, chosen]) ** 2
            chosen.append(int(np.argmax(apart.sum(axis=0).min(axis=1))))
        centre = jnp.asarray(z[:, chosen].T)
        width = 0.5 / self.models ** (1 / len(z))
        return Gaussians(centre, jnp.full_like(centre, np.log(width)))


PARTITIONS.register("farthest", Farthest(), example=lambda: ["u[t-1]", "v[t-1]"])
