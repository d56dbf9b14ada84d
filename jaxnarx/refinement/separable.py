"""Variable projection: the partition moves, the coefficients follow.

One-step predictions are linear in the coefficients theta. With the normal equations of
all parameters, split into theta and the partition p, at the least-squares theta,

    J'J = [ A  B ; B' C ],   J'r = [ 0 ; g ],

those of p with theta solved for are C - B' A^-1 B and g: Kaufman's form of the
variable projection of Golub and Pereyra (SIAM J. Numer. Anal. 10, 1973).
"""

import numpy as np
import scipy.linalg

from jaxnarx.arrays.levenberg import AbstractProblem, Linear
from jaxnarx.refinement.problem import Problem

TINY = 1e-13
"""Share of their diagonal added to the normal equations of the coefficients: enough
for Cholesky where regressors are collinear, invisible elsewhere."""


def solve_coefficients(linear: Linear, u: np.ndarray, inner: np.ndarray) -> np.ndarray:
    """`u` with the entries `inner` at their least-squares values.

    Exact where the residuals are linear in them. Entries without any effect stay.
    """
    gram = linear.gram[np.ix_(inner, inner)]
    return _with(u, inner, u[inner] - _solve(gram, linear.gradient[inner]))


def _solve(gram: np.ndarray, right: np.ndarray) -> np.ndarray:
    """gram^-1 right, scaled; zero where the diagonal is."""
    diagonal = np.diagonal(gram)
    alive = diagonal > 0
    scale = np.sqrt(np.where(alive, diagonal, 1.0))
    unit = gram / np.outer(scale, scale) + np.diag(np.where(alive, TINY, 1.0))
    tail = (slice(None),) + (None,) * (right.ndim - 1)
    value = scipy.linalg.solve(unit, right / scale[tail], assume_a="sym")
    return np.where(alive[tail], value / scale[tail], 0.0)


def _with(u: np.ndarray, at: np.ndarray, value: np.ndarray) -> np.ndarray:
    new = u.copy()
    new[at] = value
    return new


class Separable(AbstractProblem):
    """The problem of the partition alone; the coefficients are kept beside it.

    `inner` are the positions of the coefficients, `outer` all others, `u` the last
    point that was evaluated, whole. `pull` is the penalty of the coefficients' distance
    from the first `u`, squared.
    """

    def __init__(
        self,
        problem: Problem,
        inner: np.ndarray,
        outer: np.ndarray,
        u: np.ndarray,
    ):
        self.problem, self.inner, self.outer = problem, inner, outer
        self.u = self.origin = u
        self.pull = np.zeros(len(inner))
        self.wall = problem.wall[outer]

    @property
    def samples(self) -> int:
        """Number of residuals that count."""
        return int(np.count_nonzero(np.asarray(self.problem.data[3])))

    def solved(self, p: np.ndarray) -> np.ndarray:
        """The whole vector with the best coefficients for the partition `p`."""
        u = _with(self.u, self.outer, p)
        return solve_coefficients(self._penalised(u), u, self.inner)

    def _penalised(self, u: np.ndarray) -> Linear:
        """The whole problem's equations with the penalty of the coefficients."""
        whole, inner = self.problem.linear(u), self.inner
        off = u[inner] - self.origin[inner]
        gradient, gram = whole.gradient.copy(), whole.gram.copy()
        gradient[inner] += self.pull * off
        gram[inner, inner] += self.pull
        return Linear(whole.loss + float(self.pull @ off**2), gradient, gram)

    def loss(self, u: np.ndarray) -> float:
        """The loss at the partition `u`, coefficients solved for."""
        solved = self.solved(u)
        off = solved[self.inner] - self.origin[self.inner]
        return self.problem.loss(solved) + float(self.pull @ off**2)

    def linear(self, u: np.ndarray) -> Linear:
        """Normal equations at the partition `u`, coefficients solved for."""
        self.u = self.solved(u)
        whole = self._penalised(self.u)
        a = whole.gram[np.ix_(self.inner, self.inner)]
        b = whole.gram[np.ix_(self.inner, self.outer)]
        c = whole.gram[np.ix_(self.outer, self.outer)]
        inverse = _solve(a, np.c_[b, whole.gradient[self.inner]])
        gram = c - b.T @ inverse[:, :-1]
        gradient = whole.gradient[self.outer] - b.T @ inverse[:, -1]
        diagonal = np.maximum(np.diagonal(gram), 0.0)
        gram = (gram + gram.T) / 2.0
        np.fill_diagonal(gram, diagonal)
        return Linear(whole.loss, gradient, gram)
