"""A partition: regions halved where the residual varies most, like a k-d tree."""

import dataclasses

import jax.numpy as jnp
import numpy as np

from jaxnarx.partition import validity_of_boxes
from jaxnarx.settings import PARTITIONS


@dataclasses.dataclass(frozen=True)
class Halving:
    """Halves the region with the largest squared residual of its own least-squares fit,
    across the variable along which that residual is spread most, at its median."""

    models: int = 4

    def __call__(self, scheduling, columns, output, weight):
        good = weight > 0
        z, p, y = scheduling[:, good].T, columns[:, good].T, output[good]
        boxes = [np.stack([np.zeros(z.shape[1]), np.ones(z.shape[1])])]
        while len(boxes) < self.models:
            wrong = np.zeros((len(boxes), len(y)))
            for own, (low, high) in zip(wrong, boxes, strict=True):
                at = np.all((z >= low) & (z <= high), axis=1)
                own[at] = (y[at] - p[at] @ np.linalg.lstsq(p[at], y[at])[0]) ** 2
            worst = int(np.argmax(wrong.sum(axis=1)))
            share = wrong[worst] / max(wrong[worst].sum(), 1e-300)
            across = int(np.argmax(share @ (z - share @ z) ** 2))
            order = np.argsort(z[:, across])
            half = np.searchsorted(np.cumsum(share[order]), share.sum() / 2)
            lower, upper = boxes[worst].copy(), boxes.pop(worst)
            lower[1, across] = upper[0, across] = z[order[half], across]
            boxes += [lower, upper]
        low, high = jnp.asarray(np.stack(boxes, axis=1))
        return validity_of_boxes("gaussians", low, high, 0.4)


PARTITIONS.register("halving", Halving(), example=lambda: ["u[t-1]", "v[t-1]"])
