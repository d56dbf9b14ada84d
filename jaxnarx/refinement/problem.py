"""One stage of a refinement as its solvers see it: a loss and its linearisation."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.arrays.levenberg import AbstractProblem, Linear
from jaxnarx.arrays.programs import program
from jaxnarx.refinement.layout import Layout
from jaxnarx.refinement.normal import loss, normal_equations
from jaxnarx.refinement.stability import (
    Metric,
    Points,
    find_metric,
    penalty,
    penalty_points,
    penalty_residuals,
)
from jaxnarx.refinement.task import Task


class Restraint(eqx.Module):
    """Mean square of the excess over contraction at fixed points, times a weight."""

    points: Points
    metric: Metric
    target: Float[Array, ""]
    weight: Float[Array, ""]

    def __call__(self, layout: Layout, u: Float[Array, " params"]) -> Float[Array, ""]:
        """The penalty; its first derivative is exact."""
        excess = penalty_residuals(layout, u, self.points, self.metric, self.target)
        return self.weight * jnp.mean(excess**2)

    def linear(self, layout: Layout, u: Float[Array | np.ndarray, " params"]) -> Linear:
        """The penalty with its normal equations, on the host."""
        value, gradient, gram = penalty(
            layout, u, self.points, self.metric, self.target
        )
        share = float(self.weight) / (self.points.v.shape[1] * len(self.metric.groups))
        return Linear(
            share * float(value), share * np.asarray(gradient), share * np.asarray(gram)
        )


def restraint(
    layout: Layout, u: np.ndarray, task: Task, weight: float | int, target: float | int
) -> Restraint | None:
    """The penalty in the norm that suits the network at `u`; None without weight."""
    if not weight:
        return None
    network = layout.place(u)
    points = penalty_points(network, task.drive, task.masks)
    dtype = task.weight.dtype
    return Restraint(
        points,
        find_metric(network, points),
        *(jax.device_put(np.asarray(x, dtype)) for x in (target, weight)),
    )


@program
def _restrained(held: Restraint, layout: Layout, u: Float[Array, " params"]):
    return held(layout, u)


class Problem(AbstractProblem):
    """The loss of one horizon as a function of the parameters' vector.

    `data` are the arguments of `normal.loss` around that vector; `still` are positions
    of parameters that do not move.
    """

    def __init__(
        self,
        layout: Layout,
        task: Task,
        anchor: Bool[Array, "records time"],
        restraint: Restraint | None = None,
        still: np.ndarray | None = None,
    ):
        self.data: tuple[Any, ...] = (
            layout,
            task.drive,
            anchor,
            task.weight,
            task.criterion,
        )
        self.restraint = restraint
        self.still = still
        self.wall = np.asarray(layout.wall())

    def loss(self, u: np.ndarray) -> float:
        layout, *rest = self.data
        value = float(loss(layout, u, *rest))
        if self.restraint is None:
            return value
        return value + float(_restrained(self.restraint, layout, u))

    def linear(self, u: np.ndarray) -> Linear:
        layout, *rest = self.data
        value, gradient, gram = normal_equations(layout, u, *rest)
        value, gradient, gram = float(value), np.array(gradient), np.array(gram)
        if self.restraint is not None:
            more = self.restraint.linear(layout, u)
            value += more.loss
            gradient += more.gradient
            gram += more.gram
        if self.still is not None:
            gradient[self.still] = 0.0
            gram[self.still] = 0.0
            gram[:, self.still] = 0.0
        return Linear(value, gradient, gram)
