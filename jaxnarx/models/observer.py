"""Hidden channels start from the values that fit the measured outputs best.

Nobody measures them, so a run that is to begin at sample t takes the values s before t
with which its outputs y come nearest to the measured ones over a window of w samples,

    min_s  sum_(i < w) sum_o ((y_o(t+i; s) - measured) / sigma_o)^2
           + PRIOR sum_k ((s_k - middle_k) / sigma_k)^2 ,

by Levenberg-Marquardt with exact sensitivities of the run by s, from the best of some
points spread over the trained range: the sum has several minima (moving-horizon
estimation, Rao, Rawlings and Lee 2001, of full information over the window, without
noise on the state). sigma is a quarter of a channel's trained range; the prior matters
where the window tells nothing of a state. The free run that begins there is judged
behind its window. For k steps ahead every sample has a window of its own behind it.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.models.feedback import depth
from jaxnarx.models.network import Network
from jaxnarx.models.record_run import run_record

PRIOR_WEIGHT = 1e-3
"""Weight of a hidden value's squared distance from the middle of its range."""
MOST_STEPS = 15
"""Steps of Levenberg-Marquardt, rejected ones with them."""
FIRST_DAMPING = 1e-3
FIRST_POINTS = 16
"""Points in the trained range that are looked at first."""


def hidden_start(
    network: Network,
    v: Float[Array, "vars time"],
    x: tuple[Float[Array, "_ time"], ...],
    measured: Float[Array, "time outputs"],
    known: Bool[Array, "time outputs"],
    start: Int[Array, ""],
    *,
    exact: bool = True,
) -> tuple[Float[Array, "depth hidden"], Float[Array, " hidden"]]:
    """Hidden values before sample `start`, and those at the end of the window.

    Where nobody asks for derivatives, without `exact`, there are none.
    """
    lags = depth(network)
    size = window_size(network, measured.shape[0])
    row = jnp.clip(start - lags, 0, measured.shape[0] - size)

    def cut(a, axis):
        return jax.lax.dynamic_slice_in_dim(a, row, size, axis)

    v, x = cut(v, 1), tuple(cut(x_o, 1) for x_o in x)
    return start_of_window(network, v, x, cut(measured, 0), cut(known, 0), exact=exact)


def window_size(network: Network, samples: int) -> int:
    """Samples of a window and of the history before it, in a record of so many."""
    return min(depth(network) + network.window, samples)


def start_of_window(
    network: Network,
    v: Float[Array, "vars window"],
    x: tuple[Float[Array, "_ window"], ...],
    measured: Float[Array, "window outputs"],
    known: Bool[Array, "window outputs"],
    *,
    exact: bool = True,
) -> tuple[Float[Array, "depth hidden"], Float[Array, " hidden"]]:
    """`hidden_start` of a window that has been cut out, with the history before it."""
    lags, count, size = depth(network), len(network.modelled), measured.shape[0]
    known = known[:, :count]
    middle, sigma = scales(network)
    weight = jnp.where(known & (jnp.arange(size) >= lags)[:, None], 1.0, 0.0)
    weight = weight / sigma[None, :count]
    anchor = jnp.arange(size) == lags

    def outputs(s):
        begin = middle[None, count:] + s.reshape(lags, -1) * sigma[None, count:]
        filled = measured.at[:lags, count:].set(begin)
        return begin, run_record(network, v, x, filled, anchor)

    def residual(s):
        e = (outputs(s)[1][:, :count] - measured[:, :count]) * weight
        return jnp.concatenate([e.ravel(), jnp.sqrt(PRIOR_WEIGHT) * s])

    starts = spread_out(lags * network.hidden).astype(measured.dtype)
    losses = jax.lax.map(lambda s: jnp.sum(residual(s) ** 2), jnp.asarray(starts))
    least = _least if exact else _minimise
    s = least(residual, jnp.asarray(starts)[jnp.argmin(losses)])
    begin, y = outputs(s)
    return begin, y[-1, count:]


def with_hidden_start(
    network: Network,
    v: Float[Array, "vars time"],
    x: tuple[Float[Array, "_ time"], ...],
    measured: Float[Array, "time outputs"],
    known: Bool[Array, "time outputs"],
    start: Int[Array, ""],
    *,
    exact: bool = True,
) -> Float[Array, "time outputs"]:
    """The scaled outputs of a record with the hidden channels' values before sample
    `start`; zeros where there is no such sample (`start` is the record's length)."""
    lags, count = depth(network), len(network.modelled)
    found, _ = hidden_start(network, v, x, measured, known, start, exact=exact)
    row = jnp.clip(start - lags, 0, measured.shape[0] - lags)
    block = jax.lax.dynamic_slice_in_dim(measured, row, lags)
    there = start < measured.shape[0]
    block = block.at[:, count:].set(jnp.where(there, found, 0.0))
    return jax.lax.dynamic_update_slice_in_dim(measured, block, row, 0)


def scales(
    network: Network, xp: Any = jnp
) -> tuple[Float[Any, " outputs"], Float[Any, " outputs"]]:
    """Middle and a quarter of the trained range of all that is computed, scaled; `xp`
    is numpy on the host."""
    own = np.array(network.signals)
    ranges = network.gain, network.low, network.high
    gain, low, high = (xp.asarray(a)[own] for a in ranges)
    low, high = low / gain, high / gain
    sigma = xp.where(high > low, (high - low) / 4.0, 1.0)
    return (low + high) / 2.0, sigma


def spread_out(n: int) -> Float[np.ndarray, "points n"]:
    """Points of the box from -2 to 2, the middle first: an additive recurrence with
    the powers of the root of x^(n+1) = x + 1 (M. Roberts 2018)."""
    root = 1.5
    for _ in range(50):
        root = (1.0 + root) ** (1.0 / (n + 1))
    step = root ** -np.arange(1.0, n + 1)
    return 4.0 * ((0.5 + np.arange(FIRST_POINTS)[:, None] * step[None]) % 1.0) - 2.0


def _least(residual, s: Float[Array, " n"]) -> Float[Array, " n"]:
    """Levenberg-Marquardt with a fixed number of steps, for batches of small problems.

    Its derivative is that of the minimum, by the implicit function theorem: that of the
    steps would cost many times as much, and is rougher where one is rejected.
    """

    def slope(s):
        return jax.grad(lambda s: 0.5 * jnp.sum(residual(s) ** 2))(s)

    def solve(curvature, right):
        return jnp.linalg.solve(jax.jacfwd(curvature)(right), right)

    def minimise(_, s):
        return _minimise(residual, s)

    return jax.lax.custom_root(slope, s, minimise, solve)


def _minimise(residual, s: Float[Array, " n"]) -> Float[Array, " n"]:
    """The steps. Value and derivatives of a point come from one run, that of the start
    from a first step of length zero: compiling runs is what this costs."""

    def step(_, state):
        s, square, gram, gradient, damping = state
        damped = gram + damping * jnp.diag(jnp.diagonal(gram))
        new = s - jnp.linalg.solve(damped, gradient)
        r, forward = jax.linearize(residual, new)
        jacobian = jax.vmap(forward, out_axes=1)(jnp.eye(len(s), dtype=s.dtype))
        found = jnp.sum(r**2), jacobian.T @ jacobian, jacobian.T @ r
        lower = found[0] < square
        damping = jnp.where(lower, damping / 5.0, damping * 5.0)
        kept = [
            jnp.where(lower, a, b)
            for a, b in zip((new, *found), (s, square, gram, gradient), strict=True)
        ]
        return *kept, damping

    first = (
        s,
        jnp.asarray(jnp.inf, s.dtype),
        jnp.eye(len(s), dtype=s.dtype),
        jnp.zeros_like(s),
        jnp.asarray(5.0 * FIRST_DAMPING, s.dtype),
    )
    return jax.lax.fori_loop(0, 1 + MOST_STEPS, step, first)[0]
