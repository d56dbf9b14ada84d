"""Stochastic refinement: a transformation of optax on random windows of the records.

For data too long to be run whole at every step. A window of H samples starts from the
measured history; a batch of them gives an unbiased estimate of the loss of all windows
of that length. Parameters are scaled by their effect at the start of the stage, as
every other solver here does.
"""

import dataclasses
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Int

from jaxnarx.arrays import Levenberg, Standing
from jaxnarx.models import depth
from jaxnarx.refinement.any_solver import ScaledLoss, reached, scaled
from jaxnarx.simulation import RunInputs, run

UPDATES = 25
"""Updates in one step of the stage, between two looks at the whole loss."""
CLIP = 1.0
"""Largest norm of a gradient, in scaled parameters."""


def _cut(drive: RunInputs, weight, record, start, size: int):
    """One window of the drive and of the weights."""

    def slice_of(a, axis):
        return jax.lax.dynamic_slice_in_dim(a[record], start, size, axis)

    x = tuple(slice_of(x_o, 1) for x_o in drive.x)
    return slice_of(drive.v, 1), x, slice_of(drive.measured, 0), slice_of(weight, 0)


def batch_loss(
    w: Float[Array, " params"],
    s: ScaledLoss,
    at: Int[Array, "windows 2"],
    share: Float[Array, ""],
    length: int,
) -> Float[Array, ""]:
    """Loss of the windows that begin at the (record, sample) pairs, times `share`."""
    u, problem = s.place(w), s.problem
    network = problem.layout.place(u)
    before = depth(network)
    size = before + length
    cut = partial(_cut, problem.drive, problem.weight, size=size)
    v, x, measured, weight = jax.vmap(cut)(at[:, 0], at[:, 1] - before)
    known = jnp.ones(measured.shape, bool)
    window = RunInputs(v, x, measured, known)
    anchor = jnp.broadcast_to(jnp.arange(size) == before, (at.shape[0], size))
    y = run(network, window, anchor)
    weight = jnp.where(jnp.arange(size)[None, :, None] < before, 0.0, weight)
    value = share * problem.criterion(y, window.measured, weight) + s.ridge(u)
    if problem.restraint is not None:
        value = value + problem.restraint(problem.layout, u)
    return value / s.height


@eqx.filter_jit
def updates(
    optimiser, w, moments, s: ScaledLoss, windows, share, key, *, length, batch
):
    """Several updates on fresh batches."""

    def one(carry, key):
        w, moments = carry
        at = jax.random.choice(key, windows, (batch,), axis=0)
        gradient = jax.grad(batch_loss)(w, s, at, share, length)
        with jax.numpy_dtype_promotion("standard"):
            step, moments = optimiser.update(gradient, moments, w)
        return (w + step, moments), None

    (w, moments), _ = jax.lax.scan(one, (w, moments), jax.random.split(key, UPDATES))
    return w, moments, s.place(w)


class RandomWindows:
    """Steps of one stage of `length` samples a window, from where Levenberg-Marquardt
    has taken stock."""

    def __init__(
        self,
        stage: Levenberg,
        s: Standing,
        length: int,
        optimiser: optax.GradientTransformation,
        *,
        batch: int,
        seed: int,
    ):
        self.judge, self.length, self.batch = stage.judge, length, batch
        self.scaled = scaled(stage.problem, s.state)
        problem: Any = stage.problem
        before, anchor = depth(problem.layout.base), np.asarray(problem.anchor)
        record, start = np.nonzero(anchor)
        # Windows must lie inside the padded records and hold something that counts.
        inside = (start >= before) & (start + length <= anchor.shape[1])
        counted = np.any(np.asarray(problem.weight) > 0, axis=2)[record, start]
        at = np.stack([record, start], axis=1)[inside & counted]
        self.windows = jnp.asarray(at)
        dtype = problem.weight.dtype
        self.share = jnp.asarray(len(at) / batch, dtype)
        w = jnp.zeros_like(self.scaled.origin)
        clip = optax.clip_by_global_norm(CLIP)
        self.optimiser = optax.chain(clip, optimiser)
        state = w, self.optimiser.init(w), jax.random.key(seed)
        self.start = dataclasses.replace(s, state=state, damping=0.0)

    def step(self, s: Standing) -> Standing:
        """Some updates; the loss of all windows may rise."""
        if not len(self.windows):
            return dataclasses.replace(s, status="unidentifiable")
        w, moments, key = s.state
        key, now = jax.random.split(key)
        w, moments, u = updates(
            self.optimiser,
            w,
            moments,
            self.scaled,
            self.windows,
            self.share,
            now,
            length=self.length,
            batch=self.batch,
        )
        return reached(self.scaled, self.judge, u, s, (w, moments, key))

    def has_arrived(self, s: Standing) -> bool:
        """Never: the noise of the batches has no end."""
        del s
        return False
