"""Normal equations by group: ridge, forward selection and cross-validation as solves.

Sums of squares and products add over samples. With one sum a group, leaving a group out
is a subtraction, and a model without it one small solve: no pass over the data. Samples
between two groups are parts of their own, which no model is judged on.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
import scipy.linalg
from jaxtyping import Bool, Float, Int

LEAST_POWER_SHARE = 1e-7
"""Share of a column's power below which what others leave of it is rounding."""


@dataclasses.dataclass(frozen=True, eq=False)
class NormalEquations:
    """C'C, C'e, e'e and the number of samples, part by part: groups, then gaps."""

    gram: Float[np.ndarray, "parts columns columns"]
    right: Float[np.ndarray, "parts columns"]
    square: Float[np.ndarray, " parts"]
    samples: Float[np.ndarray, " parts"]
    apart: Bool[np.ndarray, "groups parts"]
    """Parts that are held out with a group: the group itself, and the gaps beside
    it."""

    def __len__(self) -> int:
        return len(self.square)

    @property
    def judged(self) -> Float[np.ndarray, " groups"]:
        """Samples that judge, group by group."""
        return self.samples[: len(self.apart)]

    @property
    def columns(self) -> int:
        """Number of columns."""
        return self.right.shape[1]

    def select(self, at: Int[np.ndarray, " chosen"]) -> "NormalEquations":
        """The equations of these columns."""
        gram = self.gram[:, at[:, None], at[None]]
        return dataclasses.replace(self, gram=gram, right=self.right[:, at])

    def exclude_group(self, group: int | None) -> "System":
        """The sums without what is left out with a group, columns scaled to unit mean
        square."""
        keep = np.full(len(self), True) if group is None else ~self.apart[group]
        count = max(self.samples[keep].sum(), 1.0)
        gram, right = self.gram[keep].sum(axis=0), self.right[keep].sum(axis=0)
        power = np.diagonal(gram) / count
        size = np.sqrt(np.where(power > 0, power, 1.0))
        scaled = gram / count / np.outer(size, size)
        return System(scaled, right / count / size, size)

    def loss(self, part: int, theta: Float[np.ndarray, " columns"]) -> float:
        """Sum of squared errors of a part."""
        error = self.square[part] - 2 * self.right[part] @ theta
        return max(float(error + theta @ self.gram[part] @ theta), 0.0)


@dataclasses.dataclass(frozen=True, eq=False)
class System:
    """Mean products of columns of unit mean square; `size` scales them back."""

    gram: Float[np.ndarray, "columns columns"]
    right: Float[np.ndarray, " columns"]
    size: Float[np.ndarray, " columns"]

    def solve(self, ridge: float) -> Float[np.ndarray, " columns"]:
        """Ridge regression; coefficients of the columns as they were."""
        system = self.gram + ridge * np.eye(len(self.right))
        factor = scipy.linalg.cho_factor(system, overwrite_a=True, check_finite=False)
        return (
            scipy.linalg.cho_solve(factor, self.right, check_finite=False) / self.size
        )

    def select_forward(
        self, ridge: float, most: int, first: Sequence[int]
    ) -> "ForwardPath":
        """Columns by error reduction, those of `first` before all others.

        Forward orthogonal least squares on normal equations (Chen, Billings and Luo
        1989) with the ridge inside, as a Cholesky factorisation with pivots: a step
        costs columns times steps so far. Columns without power are passed over.
        """
        columns = len(self.right)
        power = np.diagonal(self.gram) + ridge
        free = np.diagonal(self.gram) > 0.5
        most = min(most, int(free.sum()))
        rows, gain_of = np.zeros((most, columns)), self.right.copy()
        order: list[int] = []
        for step in range(most):
            usable = free & (power > LEAST_POWER_SHARE)
            if not usable.any():
                break
            gain = np.where(usable, gain_of**2 / np.where(usable, power, 1.0), -1.0)
            j = first[step] if step < len(first) else int(gain.argmax())
            if not usable[j]:
                j = int(gain.argmax())
            row = self.gram[j] - rows[:step, j] @ rows[:step]
            row[j] += ridge
            row = row / np.sqrt(power[j])
            part = gain_of[j] / np.sqrt(power[j])
            rows[step], free[j] = row, False
            gain_of, power = gain_of - part * row, power - row**2
            order.append(j)
        return ForwardPath(np.array(order, int), rows[: len(order)], self)


@dataclasses.dataclass(frozen=True, eq=False)
class ForwardPath:
    """Columns in the order in which they entered, with their Cholesky rows."""

    order: Int[np.ndarray, " steps"]
    rows: Float[np.ndarray, "steps columns"]
    system: System

    def truncate(
        self, size: int
    ) -> tuple[Int[np.ndarray, " chosen"], Float[np.ndarray, " chosen"]]:
        """The first columns and their coefficients."""
        at = self.order[:size]
        upper = np.triu(self.rows[: len(at), at])
        part = scipy.linalg.solve_triangular(
            upper, self.system.right[at], trans=1, check_finite=False
        )
        theta = scipy.linalg.solve_triangular(upper, part, check_finite=False)
        return at, theta / self.system.size[at]
