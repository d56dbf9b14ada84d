"""Tracking error and effort of a cascade as a least-squares problem.

Residuals of a record are r_o(t) = sqrt(w) (y_o - reference_o) / s_o at scored samples,
and e_c(t) = sqrt(w) (u_c(t) - u_c(t-1)) / w_c. Their derivative by the inverse's
parameters is that of the recursion (`jaxnarx.arrays.recurrence`): a linear filter
driven by the derivative of each sample at a fixed past. The Jacobian is formed one
record at a time and summed into J'J and J'r.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.arrays import AbstractProblem, Linear, gram, twin
from jaxnarx.inverse.loop import Loop, run_record
from jaxnarx.inverse.task import CascadeTask, TaskSignals
from jaxnarx.refinement import Layout


class Weighed(eqx.Module):
    """Records of a problem: where runs start and what every residual weighs.

    `scored` and `moved` are square roots of weights, divided by the scale of the
    residual: of tracking errors and of changes of commands.
    """

    batch: TaskSignals
    anchor: Bool[Array, "records time"]
    scored: Float[Array, "records time targets"]
    moved: Float[Array, "records time commands"]


def _residuals(
    loop: Loop, layout: Layout, u: Float[Array, " params"], record: Weighed
) -> tuple[Float[Array, " errors"], Float[Array, " changes"]]:
    """Tracking and effort of one record."""
    loop = eqx.tree_at(lambda one: one.inverse, loop, layout.place(u))
    signals = record.batch.signals
    z = run_record(loop, signals, record.batch.valid, record.anchor)
    count, targets = loop.low.shape[0], np.array(loop.wiring.targets)
    gain = loop.output_gain[targets]
    wanted = signals[:, np.array(loop.forward.signals)[targets]]
    error = (z[:, count + targets] * gain[None] - wanted) * record.scored
    commands = z[:, :count] * loop.command_gain[None]
    change = jnp.diff(commands, axis=0, prepend=commands[:1]) * record.moved
    # Samples without weight hold whatever the recursion left there.
    error = jnp.where(record.scored > 0, error, 0.0)
    change = jnp.where(record.moved > 0, change, 0.0)
    return error.reshape(-1), change.reshape(-1)


def _losses(
    loop: Loop, layout: Layout, u: Float[Array, " params"], data: Weighed
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Tracking and effort over all records."""

    def one(record):
        error, change = _residuals(loop, layout, u, record)
        return jnp.sum(error**2), jnp.sum(change**2)

    error, change = jax.vmap(one)(data)
    return jnp.sum(error), jnp.sum(change)


def _normal_equations(
    loop: Loop, layout: Layout, u: Float[Array, " params"], data: Weighed
):
    """J'r and J'J."""

    def add(carry, record):
        def residuals(u):
            r = jnp.concatenate(_residuals(loop, layout, u, record))
            return r, r

        jacobian, r = jax.jacfwd(residuals, has_aux=True)(u)
        gradient, products = carry
        return (gradient + r @ jacobian, products + gram(jacobian)), None

    params = u.shape[0]
    start = jnp.zeros(params, u.dtype), jnp.zeros((params, params), u.dtype)
    return jax.lax.scan(add, start, data)[0]


class TrackingProblem(AbstractProblem):
    """The loss of `TrackingError` as a function of the inverse's parameters."""

    loop: Loop
    layout: Layout
    data: Weighed
    ridge: Float[np.ndarray | Array, ""]

    @property
    def nameless(self) -> "TrackingProblem":
        """Copy with networks without names, so that names are no part of a program."""
        return twin(self, loop=self.loop.nameless, layout=self.layout.nameless)

    @property
    def wall(self) -> Float[Array, " params"]:
        """Bounded parameters keep from the flat ends of their map."""
        return self.layout.wall()

    def loss(self, u: Float[Array, " params"]) -> Float[Array, ""]:
        """Tracking error and the price of the effort."""
        error, change = _losses(self.loop, self.layout, u, self.data)
        return error + change

    def tracking_error(self, u: Float[Array, " params"]) -> Float[Array, ""]:
        """The tracking error alone."""
        return _losses(self.loop, self.layout, u, self.data)[0]

    def linear(self, u: Float[Array, " params"]) -> Linear:
        """Their normal equations."""
        found = _normal_equations(self.loop, self.layout, u, self.data)
        return Linear(u, self.loss(u), *found)

    def pull(self, start: Linear) -> Float[Array, " params"]:
        """The ridge."""
        return self.ridge * jnp.diagonal(start.gram)


def tracking_problem(
    loop: Loop,
    layout: Layout,
    task: CascadeTask,
    spread: Float[np.ndarray, " targets"],
    effort: float | int,
    horizon: int | None = None,
    ridge: float | int = 0.0,
) -> TrackingProblem:
    """Runs from the starts of records (or anew every `horizon` samples), weighed.

    Every target counts alike, by its mean over scored samples, and so does every
    command. The change into a start is none of the inverse's doing.
    """
    anchor, dtype = task.anchor(horizon), spread.dtype
    count = np.maximum(task.scored.sum(axis=(0, 1)), 1)
    scored = task.scored / (np.sqrt(count) * spread)[None, None]
    at = np.arange(anchor.shape[1])[None]
    running = (at >= task.start[:, None]) & (at < task.end[:, None]) & ~anchor
    signals = np.array(loop.inverse.signals)
    wide = (np.asarray(loop.inverse.high) - np.asarray(loop.inverse.low))[signals]
    wide = np.where(wide > 0, wide, 1.0)
    price = np.sqrt(effort / max(int(running.sum()), 1)) / wide
    moved = running[:, :, None] * price[None, None]
    own = (anchor, scored.astype(dtype), moved.astype(dtype))
    data = Weighed(task.batch, *map(jax.device_put, own))
    return TrackingProblem(loop, layout, data, np.asarray(ridge, dtype))
