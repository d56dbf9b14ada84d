"""Variable projection: the partition moves, the coefficients follow.

One-step predictions are linear in the coefficients theta. With the normal equations of
all parameters, split into theta and the partition p, at the least-squares theta,

    J'J = [ A  B ; B' C ],   J'r = [ 0 ; g ],

those of p with theta solved for are C - B' A^-1 B and g: Kaufman's form of the
variable projection of Golub and Pereyra (SIAM J. Numer. Anal. 10, 1973).
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays import AbstractProblem, Linear, program, ridge_solve, twin
from jaxnarx.refinement.problem import Problem

Arrays = Array | np.ndarray


def solve_coefficients(
    linear: Linear, inner: Int[Arrays, " inner"]
) -> Float[Array, " params"]:
    """The point with the entries `inner` at their least-squares values.

    Exact where the residuals are linear in them. Entries without any effect stay.
    """
    gram = linear.gram[inner[:, None], inner[None]]
    move = ridge_solve(gram, linear.gradient[inner])
    return jnp.asarray(linear.u).at[inner].add(-move)


class Separable(AbstractProblem):
    """A problem in which the partition alone is stepped in.

    `inner` are the positions of the coefficients, `outer` all others. Distances from
    `origin`, squared, weigh `inner_pull` in the least squares of the coefficients, and
    `outer_pull` in the search.
    """

    problem: Problem
    inner: Int[Arrays, " inner"]
    outer: Int[Arrays, " outer"]
    origin: Float[Arrays, " params"]
    inner_pull: Float[Arrays, " params"]
    outer_pull: Float[Arrays, " params"]

    @property
    def nameless(self) -> "Separable":
        """Copy with a network without names, so that names are no part of a program."""
        return twin(self, problem=self.problem.nameless)

    @property
    def wall(self) -> Float[Array, " params"]:
        """Bounds of the whole problem."""
        return self.problem.wall

    def solve(self, u: Float[Array, " params"]) -> Float[Array, " params"]:
        """The parameters with the best coefficients for the partition, as linearised at
        `u`."""
        return solve_coefficients(self._penalise(u), self.inner)

    def _penalty(self, u: Float[Array, " params"]) -> Float[Array, ""]:
        return jnp.dot(self.inner_pull, (u - self.origin) ** 2)

    def _penalise(self, u: Float[Array, " params"]) -> Linear:
        """The whole problem's equations with the penalty of the coefficients."""
        whole = self.problem.linear(u)
        return Linear(
            u,
            whole.loss + self._penalty(u),
            whole.gradient + self.inner_pull * (u - self.origin),
            whole.gram + jnp.diag(self.inner_pull),
        )

    def loss(self, u: Float[Array, " params"]) -> Float[Array, ""]:
        """The loss at the partition of `u`, coefficients solved for."""
        u = self.solve(u)
        return self.problem.loss(u) + self._penalty(u)

    def linear(self, u: Float[Array, " params"]) -> Linear:
        """Normal equations at the partition of `u`, coefficients solved for."""
        whole = self._penalise(self.solve(u))
        inner, outer = self.inner, self.outer
        a = whole.gram[inner[:, None], inner[None]]
        b = whole.gram[inner[:, None], outer[None]]
        c = whole.gram[outer[:, None], outer[None]]
        both = jnp.concatenate([b, whole.gradient[inner][:, None]], axis=1)
        inverse = ridge_solve(a, both)
        gram = c - b.T @ inverse[:, :-1]
        gradient = whole.gradient[outer] - b.T @ inverse[:, -1]
        gram = (gram + gram.T) / 2.0
        at = jnp.arange(len(outer))
        gram = gram.at[at, at].set(jnp.maximum(jnp.diagonal(gram), 0.0))
        zero = jnp.zeros_like(whole.gram)
        return Linear(
            whole.u,
            whole.loss,
            zero[0].at[outer].set(gradient),
            zero.at[outer[:, None], outer[None]].set(gram),
        )

    def pull(self, start: Linear) -> Float[Array, " params"]:
        """Regularisation of the parameters of the partition."""
        del start
        return jnp.asarray(self.outer_pull)


def separable(
    problem: Problem, inner: Int[np.ndarray, " inner"], u: Float[np.ndarray, " params"]
) -> tuple[Separable, bool]:
    """The problem from `u` on, and whether any parameter has an effect there."""
    outer = np.setdiff1d(np.arange(u.size), inner)
    pull, informed = _pull(problem, inner, outer, u)
    pull, own = np.asarray(pull), np.isin(np.arange(u.size), inner)
    pulls = np.where(own, pull, 0.0), np.where(own, 0.0, pull)
    return Separable(problem, inner, outer, u, *pulls), bool(informed)


@program
def _pull(
    problem: Problem, inner, outer, u
) -> tuple[Float[Array, " params"], Bool[Array, ""]]:
    """Pull of all parameters; against a prior is weighed the noise that least squares
    of the coefficients leaves."""
    whole, zero = problem.linear(u), jnp.zeros_like(u)
    informed = jnp.any(jnp.diagonal(whole.gram) > 0)
    if problem.prior is not None:
        free = Separable(problem, inner, outer, u, zero, zero)
        whole = eqx.tree_at(lambda w: w.loss, whole, free.loss(u))
    return problem.pull(whole), informed
