"""Stochastic refinement: Adam on random windows of the records, by optax.

For data too long to be run whole at every step. A window of H samples starts from the
measured history; a batch of them gives an unbiased estimate of the loss of all windows
of that length. Parameters are scaled by their effect at the start of the stage, as
every other solver here does.
"""

import dataclasses
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Int

from jaxnarx.arrays.levenberg import Linear
from jaxnarx.arrays.programs import program
from jaxnarx.models import depth
from jaxnarx.refinement.problem import Problem
from jaxnarx.refinement.quasi_newton import Scaled, scaled
from jaxnarx.simulation import Drive, run
from jaxnarx.solution import RESULTS

UPDATES = 25
"""Updates in one step of the stage, between two looks at the whole loss."""
CLIP = 1.0
"""Largest norm of a gradient, in scaled parameters."""


def _cut(drive: Drive, weight, record, start, size: int):
    """One window of the drive and of the weights."""

    def slice_of(a, axis):
        return jax.lax.dynamic_slice_in_dim(a[record], start, size, axis)

    x = tuple(slice_of(x_o, 1) for x_o in drive.x)
    return slice_of(drive.v, 1), x, slice_of(drive.measured, 0), slice_of(weight, 0)


def batch_loss(
    w: Float[Array, " params"],
    s: Scaled,
    at: Int[Array, "windows 2"],
    share: Float[Array, ""],
    length: int,
) -> Float[Array, ""]:
    """Loss of the windows that begin at the (record, sample) pairs, times `share`."""
    u = s.place(w)
    layout, drive, _, weight, criterion = s.data
    network = layout.place(u)
    before = depth(network)
    size = before + length
    cut = partial(_cut, drive, weight, size=size)
    v, x, measured, weight = jax.vmap(cut)(at[:, 0], at[:, 1] - before)
    window = Drive(v, x, measured)
    anchor = jnp.broadcast_to(jnp.arange(size) == before, (at.shape[0], size))
    y = run(network, window, anchor)
    weight = jnp.where(jnp.arange(size)[None, :, None] < before, 0.0, weight)
    value = share * criterion(y, window.measured, weight)
    return (value + s.penalties(u)) / s.height


@program
def updates(w, moments, s: Scaled, windows, share, key, rate, *, length, batch):
    """Several updates by Adam on fresh batches."""
    adam = optax.chain(optax.clip_by_global_norm(CLIP), optax.scale_by_adam())

    def one(carry, key):
        w, moments = carry
        at = jax.random.choice(key, windows, (batch,), axis=0)
        gradient = jax.grad(batch_loss)(w, s, at, share, length)
        with jax.numpy_dtype_promotion("standard"):
            step, moments = adam.update(gradient, moments)
        return (w - rate * step, moments), None

    (w, moments), _ = jax.lax.scan(one, (w, moments), jax.random.split(key, UPDATES))
    return w, moments, s.place(w)


@dataclasses.dataclass(frozen=True)
class State:
    """Where the search stands; `loss` is that of all windows, without the ridge,
    `minimised` with it."""

    u: np.ndarray
    loss: float
    minimised: float
    damping: float
    gain: float
    w: Array
    moments: Any
    key: Array


class RandomWindows:
    """Steps of one stage of `length` samples a window."""

    def __init__(self, problem: Problem, length: int, *, batch, learning_rate, seed):
        self.problem, self.length, self.batch = problem, length, batch
        self.rate, self.seed = learning_rate, seed

    def init(self, u: np.ndarray, linear: Linear, pull: np.ndarray) -> State:
        """Set up at `u`."""
        self.scaled = scaled(self.problem, u, linear, pull)
        _, drive, anchor, weight, _ = self.problem.data
        before = depth(self.problem.data[0].base)
        record, start = np.nonzero(np.asarray(anchor))
        # Windows must lie inside the padded records and hold something that counts.
        inside = (start >= before) & (start + self.length <= anchor.shape[1])
        counted = np.any(np.asarray(weight) > 0, axis=2)[record, start]
        at = np.stack([record, start], axis=1)[inside & counted]
        self.windows = jnp.asarray(at)
        self.share = jnp.asarray(len(at) / self.batch, weight.dtype)
        w = jnp.zeros_like(self.scaled.origin)
        adam = optax.chain(optax.clip_by_global_norm(CLIP), optax.scale_by_adam())
        key = jax.random.key(self.seed)
        return State(u, linear.loss, linear.loss, 0.0, np.inf, w, adam.init(w), key)

    def step(self, s: State) -> tuple[State, RESULTS]:
        """Some updates; the loss of all windows may rise."""
        if not len(self.windows):
            return s, RESULTS.unidentifiable
        key, now = jax.random.split(s.key)
        rate = jnp.asarray(self.rate, s.w.dtype)
        w, moments, u = updates(
            s.w,
            s.moments,
            self.scaled,
            self.windows,
            self.share,
            now,
            rate,
            length=self.length,
            batch=self.batch,
        )
        u = np.asarray(u)
        value = self.problem.loss(u)
        if not np.isfinite(value):
            return s, RESULTS.diverged
        total = value + float(self.scaled.ridge(jnp.asarray(u)))
        gain = 1.0 - total / s.minimised if s.minimised > 0 else 0.0
        return State(u, value, total, 0.0, gain, w, moments, key), RESULTS.ok

    def arrived(self, s: State) -> bool:
        """Never: the noise of the batches has no end."""
        del s
        return False
