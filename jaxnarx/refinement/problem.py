"""One stage of a refinement as its solvers see it: a loss and its linearisation."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.arrays import AbstractProblem, Linear, twin
from jaxnarx.models import scales
from jaxnarx.refinement._stability import (
    Metric,
    Points,
    find_metric,
    penalty,
    penalty_points,
    penalty_residuals,
)
from jaxnarx.refinement.criterion import Criterion
from jaxnarx.refinement.gain_penalty import SignPenalty
from jaxnarx.refinement.gauss_newton import loss, normal_equations, roots
from jaxnarx.refinement.layout import Layout
from jaxnarx.refinement.training_data import TrainingData
from jaxnarx.simulation import RunInputs

Arrays = Array | np.ndarray


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

    def linear(self, layout: Layout, u: Float[Array, " params"]) -> Linear:
        """The penalty with its normal equations."""
        found = penalty(layout, u, self.points, self.metric, self.target)
        share = self.weight / (self.points.v.shape[1] * len(self.metric.groups))
        return Linear(u, *(share * part for part in found))


def restraint(
    layout: Layout,
    u: np.ndarray,
    task: TrainingData,
    weight: float | int,
    target: float | int,
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


class Problem(AbstractProblem):
    """The loss of one horizon as a function of the parameters' vector.

    Runs restart at `anchor`; entries that are not `moving` stay. `ridge` is the share
    of their information that pulls the parameters to the start; `prior` adds that of a
    prior: one over its standard deviation and over the root of the number of samples,
    `shrink` what a squared distance from the start costs as it is.
    """

    layout: Layout
    drive: RunInputs
    anchor: Bool[Array, "records time"]
    weight: Float[Array, "records time outputs"]
    criterion: Criterion
    moving: Bool[Arrays, " params"]
    ridge: Float[Arrays, ""]
    prior: Float[Arrays, " params"] | None = None
    restraints: tuple[Restraint | SignPenalty, ...] = ()
    shrink: Float[Arrays, " params"] | None = None

    @property
    def nameless(self) -> "Problem":
        """Copy with a network without names, so that names are no part of a program."""
        return twin(self, layout=self.layout.nameless)

    @property
    def wall(self) -> Float[Array, " params"]:
        """Bounded parameters keep from the flat ends of their map."""
        return self.layout.wall()

    def loss(self, u: Float[Array, " params"]) -> Float[Array, ""]:
        """Errors of the run, and the penalties."""
        at = self.drive, self.anchor, self.weight, self.criterion
        return loss(self.layout, u, *at) + self.penalty(u)

    def penalty(self, u: Float[Array, " params"]) -> Float[Array, ""]:
        """The penalties alone."""
        zero = jnp.zeros((), jnp.asarray(self.weight).dtype)
        return sum((one(self.layout, u) for one in self.restraints), zero)

    def roots(self, u: Float[Array, " params"]) -> Array:
        """The roots whose sum of squares is the errors' loss, one for every sample; and
        the root of every penalty behind them."""
        at = self.drive, self.anchor, self.weight, self.criterion
        found = roots(self.layout, u, *at)
        for one in self.restraints:
            penalty = one(self.layout, u)
            root = jnp.sqrt(jnp.where(penalty > 0, penalty, 1e-300))
            found = jnp.append(found, root)
        return found

    def linear(self, u: Float[Array, " params"]) -> Linear:
        """Normal equations of all; zero where parameters rest."""
        at = self.drive, self.anchor, self.weight, self.criterion
        found = Linear(u, *normal_equations(self.layout, u, *at))
        for one in self.restraints:
            more = one.linear(self.layout, u)
            sums = zip(*map(_parts, (found, more)), strict=True)
            found = Linear(u, *(a + b for a, b in sums))
        moving = jnp.asarray(self.moving)
        both = moving[:, None] & moving[None]
        gradient = jnp.where(moving, found.gradient, 0.0)
        return Linear(u, found.loss, gradient, jnp.where(both, found.gram, 0.0))

    def pull(self, start: Linear) -> Float[Array, " params"]:
        """Ridge and prior of a stage that begins there.

        The noise's variance, in units of the loss, is what is left at the start.
        """
        pull = self.ridge * jnp.diagonal(start.gram)
        if self.shrink is not None:
            pull = pull + self.shrink
        if self.prior is None:
            return pull
        slope = self.layout.slope(start.u)
        return pull + start.loss * (slope * self.prior) ** 2


def _parts(linear: Linear):
    return linear.loss, linear.gradient, linear.gram


def make_problem(
    layout: Layout,
    task: TrainingData,
    horizon: int | None,
    *,
    ridge: float | int = 0.0,
    prior: Float[np.ndarray, " params"] | None = None,
    still: np.ndarray | None = None,
    restraints: Sequence[Restraint | SignPenalty | None] = (),
    shrink: float | int = 0.0,
) -> Problem:
    """The loss of a task's runs that restart every `horizon` samples.

    `still` are positions of parameters that do not move, `prior` is one over the
    standard deviation of every one.
    """
    dtype = layout.low.dtype
    moving = np.ones(layout.low.shape, bool)
    if still is not None:
        moving[still] = False
    if prior is not None:
        samples = max(np.count_nonzero(np.asarray(task.weight)), 1)
        prior = (prior / np.sqrt(samples)).astype(dtype)
    return Problem(
        layout,
        task.drive,
        task.anchors(horizon),
        task.weight,
        task.criterion,
        moving,
        np.asarray(ridge, dtype),
        prior,
        tuple(one for one in restraints if one is not None),
        _shrink(layout, float(shrink)) if shrink else None,
    )


def _shrink(layout: Layout, weight: float) -> Float[np.ndarray, " params"]:
    """The penalty of coefficients, in units of what they compute; zero for all
    others."""
    pull, inner = np.zeros(layout.low.shape), layout.coefficients()
    size = scales(layout.base, np)[1]
    for (start, stop), own in zip(layout.spans(), size, strict=True):
        pull[inner[(inner >= start) & (inner < stop)]] = weight / own**2
    return pull.astype(layout.low.dtype)
