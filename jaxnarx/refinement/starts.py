"""Other points to start from: at random, and where the given one diverges."""

from collections.abc import Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxnarx.arrays import evaluate_at, program
from jaxnarx.models import Network, fed_back_variables
from jaxnarx.refinement.layout import Layout
from jaxnarx.refinement.problem import Problem, make_problem
from jaxnarx.refinement.search import Search
from jaxnarx.refinement.separable import solve_coefficients
from jaxnarx.refinement.training_data import TrainingData

PARTITION_DEVIATION = 0.7
"""Standard deviation of a random move of the partition, in solver coordinates."""
COEFFICIENT_DEVIATION = 0.3
"""... and of coefficients where there is no partition, as a share of their value."""
FEEDBACK_FACTORS = (0.98, 0.95, 0.9, 0.8, 0.6, 0.3, 0.0)
"""Factors on the fed-back terms that are tried one after another."""
EXTRA_STARTS = 3
"""Random starts in the last remedy."""


def one_step_least_squares(
    layout: Layout, task: TrainingData, u: np.ndarray
) -> np.ndarray:
    """`u` with all coefficients at their least-squares values one step ahead.

    Three times: samples at the feedback bound have no part in one solution, and may
    have in the next.
    """
    inner = layout.coefficients()
    if not inner.size:
        return u
    return np.asarray(_solve(make_problem(layout, task, 1), inner, u))


@program
def _solve(problem: Problem, inner: Int[np.ndarray | Array, " inner"], u):
    def solve(_, u):
        return solve_coefficients(problem.linear(u), inner)

    return jax.lax.fori_loop(0, 3, solve, u)


def random_start(
    layout: Layout, task: TrainingData, u: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """The partition moved at random, with the coefficients of least squares there.

    With hidden channels they stay. Without a trained partition the coefficients are
    moved instead.
    """
    bounded = np.isfinite(np.asarray(layout.low))
    wall = np.asarray(layout.wall())
    if bounded.any():
        moved = u + np.where(
            bounded, PARTITION_DEVIATION * rng.normal(size=u.size), 0.0
        )
        moved = np.clip(moved, -wall, wall).astype(u.dtype)
        if layout.base.hidden:
            # One step ahead begins at hidden values that nobody knows.
            return moved
        return one_step_least_squares(layout, task, moved)
    own = np.arange(u.size) < layout.parameters
    factor = 1.0 + COEFFICIENT_DEVIATION * rng.normal(size=u.size)
    return np.where(own, u * factor, u).astype(u.dtype)


def shrunk(
    layout: Layout,
    u: Float[Array, " params"],
    factor: float | Float[Array, ""],
) -> Float[Array, " params"]:
    """Coefficients of fed-back terms times `factor`, their others as they are."""
    new = layout.gather(shrink_feedback(layout.place(u), factor))
    return jnp.where(jnp.arange(u.size) < layout.parameters, new, u)


def shrink_feedback(network: Network, factor: float | Float[Array, ""]) -> Network:
    """Every term with a modelled output in it, at `factor` times its coefficient."""
    rows = [
        row + 1 for row, _, _ in fed_back_variables(network.variables, network.signals)
    ]

    def one(model):
        local = model.local
        own = jnp.isin(local.factor, jnp.asarray(rows, local.factor.dtype)).any(axis=1)
        value = jnp.where(own[local.index], factor, 1.0).astype(local.coefficient.dtype)
        return eqx.tree_at(
            lambda m: m.local.coefficient, model, local.coefficient * value
        )

    return eqx.tree_at(lambda n: n.models, network, tuple(map(one, network.models)))


def remedies(search: Search) -> Iterator[tuple[str, np.ndarray]]:
    """Starts in place of one that diverges, in order, each with its name."""
    layout, task = search.layout, search.task
    if not layout.base.hidden:
        yield (
            "one-step least squares",
            one_step_least_squares(layout, task, search.start),
        )
    for factor in FEEDBACK_FACTORS:
        u = np.asarray(shrunk(layout, jnp.asarray(search.start), factor))
        if not evaluate_at(search.validate, u).diverged:
            yield f"feedback shrunk to {factor:g}", u
            break
    rng = np.random.default_rng(search.method.seed)
    for n in range(0 if layout.base.hidden else EXTRA_STARTS):
        yield f"random start {n + 1}", random_start(layout, task, search.start, rng)
