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
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays import UNIDENTIFIABLE, AbstractMethod, LevenbergState, twin
from jaxnarx.models import depth
from jaxnarx.refinement.any_solver import (
    ScaledLoss,
    SolverState,
    begin_solver,
    end_of_step,
    scale_coordinates,
)
from jaxnarx.refinement.problem import Problem
from jaxnarx.simulation import RunInputs, run

UPDATES_PER_STEP = 25
"""Updates in one step of the stage, between two looks at the whole loss."""
LARGEST_GRADIENT = 1.0
"""Largest norm of a gradient, in scaled parameters."""


def _cut(drive: RunInputs, weight, record, start, size: int):
    """One window of the drive and of the weights."""

    def take_slice(a, axis):
        return jax.lax.dynamic_slice_in_dim(a[record], start, size, axis)

    x = tuple(take_slice(x_o, 1) for x_o in drive.x)
    return (
        take_slice(drive.v, 1),
        x,
        take_slice(drive.measured, 0),
        take_slice(weight, 0),
    )


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
    return (value + problem.penalty(u)) / s.height


def clip_gradients(
    optimiser: optax.GradientTransformation,
) -> optax.GradientTransformation:
    """Bound the size of gradients. Make it where it is used: two are never equal."""
    return optax.chain(optax.clip_by_global_norm(LARGEST_GRADIENT), optimiser)


class Moments(eqx.Module):
    """The optimiser's own state, and the key of the next batches."""

    optimiser: Any
    key: Any


class RandomWindows(AbstractMethod):
    """Several updates of an optimiser on batches of the `windows`, (record, sample)
    pairs at which so many samples (`length`) begin, times `share`."""

    optimiser: optax.GradientTransformation
    scaled: ScaledLoss
    windows: Int[Array, "windows 2"]
    share: Float[Array, ""]
    length: int = eqx.field(static=True)
    batch: int = eqx.field(static=True)

    @property
    def nameless(self) -> "RandomWindows":
        """The same method without names of channels, for programs."""
        return twin(self, scaled=self.scaled.nameless)

    def step(self, s: SolverState) -> SolverState:
        """Some updates; the loss of all windows may rise."""
        if not len(self.windows):
            status = jnp.full_like(s.status, UNIDENTIFIABLE)
            return dataclasses.replace(s, status=status)
        key, now = jax.random.split(s.inner.key)

        def update(carry, key):
            w, moments = carry
            at = jax.random.choice(key, self.windows, (self.batch,), axis=0)
            gradient = jax.grad(batch_loss)(w, self.scaled, at, self.share, self.length)
            with jax.numpy_dtype_promotion("standard"):
                step, moments = clip_gradients(self.optimiser).update(
                    gradient, moments, w
                )
            return (w + step, moments), None

        start, keys = (s.w, s.inner.optimiser), jax.random.split(now, UPDATES_PER_STEP)
        (w, moments), _ = jax.lax.scan(update, start, keys)
        return end_of_step(self.scaled, s, w, Moments(moments, key), s.done)

    def has_arrived(self, s: SolverState) -> Bool[Array, ""]:
        """Never: the noise of the batches has no end."""
        return jnp.zeros_like(s.done)


def random_windows(
    problem: Problem,
    s: LevenbergState,
    length: int,
    optimiser: optax.GradientTransformation,
    *,
    batch: int,
    seed: int,
) -> tuple[RandomWindows, SolverState]:
    """The method on windows of `length` samples, and its state at the point that `s`
    has evaluated."""
    before, anchor = depth(problem.layout.base), np.asarray(problem.anchor)
    record, start = np.nonzero(anchor)
    # Windows must lie inside the padded records and hold something that counts.
    inside = (start >= before) & (start + length <= anchor.shape[1])
    counted = np.any(np.asarray(problem.weight) > 0, axis=2)[record, start]
    at = np.stack([record, start], axis=1)[inside & counted]
    share = jnp.asarray(len(at) / batch, problem.weight.dtype)
    own = scale_coordinates(problem, s)
    method = RandomWindows(optimiser, own, jnp.asarray(at), share, length, batch)
    w = jnp.zeros_like(own.origin)
    return method, begin_solver(
        s, w, Moments(clip_gradients(optimiser).init(w), jax.random.key(seed))
    )
