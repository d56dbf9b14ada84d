"""A selector: terms whose coefficient an absolute penalty leaves (lasso)."""

import dataclasses

import numpy as np

from jaxnarx.settings import SELECTORS


@dataclasses.dataclass(frozen=True)
class Lasso:
    """Coordinate descent on columns of unit norm, the largest coefficient first."""

    penalty: float = 0.1
    sweeps: int = 100

    def __call__(self, columns, output, weight):
        root = np.sqrt(weight)
        x, y = columns * root, output * root
        size = np.linalg.norm(x, axis=1, keepdims=True)
        x, y = x / np.where(size > 0, size, 1.0), y / np.linalg.norm(y)
        theta = np.zeros(len(x))
        for _ in range(self.sweeps):
            for j in range(len(x)):
                part = x[j] @ (y - theta @ x) + theta[j]
                theta[j] = np.sign(part) * max(abs(part) - self.penalty, 0.0)
        order = np.argsort(-np.abs(theta), kind="stable")
        return order[: np.count_nonzero(theta)]


SELECTORS.register("lasso", Lasso())
