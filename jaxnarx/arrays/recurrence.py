"""Output-feedback recursion, and its derivative as a linear filter.

A free run computes `y_t = clip(step(params, drive_t, history_t))` where the history
holds the run's own last outputs. Its derivative needs no autodiff through the loop:
with A_t = d y_t / d history_t and the direct tangent D_t at *fixed* history, both of
them vectorised over time, tangents obey the linear recursion

    S_t = A_t S_history + D_t ,

and since that recursion is linear, reverse mode is its transpose. Where a sample is
limited by the clip, both A_t and D_t are zero.

*Anchors* are the samples at which the history is taken from the measurement: one per
record for a free run, one every H samples for windows of horizon H. As they are data,
one compiled program serves every horizon.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

Step = Callable[[Any, Any, Float[Array, "outputs depth"]], Float[Array, " outputs"]]


def history_of(
    y: Float[Array, "time outputs"], depth: int
) -> Float[Array, "time outputs depth"]:
    """Past outputs of every sample; `[t, :, d]` is `y[t - 1 - d]`.

    Before the start the first sample is repeated; such entries must not be used.
    """
    at = jnp.arange(y.shape[0])[:, None] - 1 - jnp.arange(depth)[None]
    return jnp.swapaxes(y[jnp.maximum(at, 0)], 1, 2)


def age(anchor: Bool[Array, " time"]) -> Int[Array, " time"]:
    """Samples since the last anchor; large before the first one."""
    at = jnp.arange(anchor.shape[0])
    last = jax.lax.cummax(jnp.where(anchor, at, -anchor.shape[0]))
    return at - last


def own_history(anchor, depth):
    """True where lag d of sample t lies at or after the last anchor: simulated."""
    return age(anchor)[:, None] > jnp.arange(depth)[None]


def run_history(
    y: Float[Array, "time outputs"],
    measured: Float[Array, "time outputs depth"],
    anchor: Bool[Array, " time"],
) -> Float[Array, "time outputs depth"]:
    """The history each step of a finished run has seen: simulated, else measured."""
    depth = measured.shape[2]
    own = own_history(anchor, depth)[:, None, :]
    return jnp.where(own, history_of(y, depth), measured)


def linear_recurrence(
    a: Float[Array, "time outputs outputs depth"],
    d: Float[Array, "time outputs *params"],
    start: Float[Array, "depth outputs *params"],
) -> tuple[Float[Array, "depth outputs *params"], Float[Array, "time outputs *params"]]:
    """S_t[o] = D_t[o] + sum_(i,k) A_t[o, i, k] S_(t-1-k)[i]; returns the end and all S.

    The carry is one array of the last `depth` states, newest first.
    """

    def step(past, inputs):
        a_t, d_t = inputs
        # Written out: a dot in the loop body costs more than this fused product.
        weight = jnp.expand_dims(
            jnp.swapaxes(a_t, 1, 2), tuple(range(3, past.ndim + 1))
        )
        # A zero weight cuts the past off (an anchor, a limit) even where it overflowed.
        reached = jnp.where(weight != 0, past[None], 0.0)
        now = d_t + jnp.sum(weight * reached, axis=(1, 2))
        return jnp.concatenate([now[None], past[:-1]]), now

    return jax.lax.scan(step, start, (a, d))


def _loop(step: Step, depth, params, drive, measured, anchor, lower, upper):
    def body(past, inputs):
        drive_t, measured_t, anchor_t = inputs
        past = jnp.where(anchor_t, measured_t, past)
        now = jnp.clip(step(params, drive_t, past), lower, upper)
        return jnp.concatenate([now[:, None], past[:, :-1]], axis=1), now

    start = history_of(measured, depth)
    return jax.lax.scan(body, start[0], (drive, start, anchor))[1]


def sensitivities(step: Step, params, drive, history, lower, upper):
    """A_t of every sample, zero where the clip acts: (time, outputs, outputs, depth).

    `limited` is returned beside it. Forward mode: the history is short.
    """

    def one(drive_t, history_t):
        raw = step(params, drive_t, history_t)
        free = (raw >= lower) & (raw <= upper)
        jacobian = jax.jacfwd(lambda h: step(params, drive_t, h))(history_t)
        return jnp.where(free[:, None, None], jacobian, 0.0), ~free

    return jax.vmap(one)(drive, history)


def _filled(primal, tangent):
    """Tangents of the floating-point leaves of `primal`, symbolic zeros filled in."""

    def one(p, t):
        if p is None:
            return None
        return jnp.zeros_like(p) if t is None else t

    moving = eqx.filter(primal, eqx.is_inexact_array)
    return jax.tree.map(one, moving, tangent, is_leaf=lambda x: x is None)


@eqx.filter_custom_jvp
def _run(args, *, step, depth):
    return _loop(step, depth, *args)


@_run.def_jvp
def _run_jvp(primals, tangents, *, step, depth):
    (args,) = primals
    params, drive, measured, anchor, lower, upper = args
    t_inputs, t_measured = _filled(
        ((params, drive), measured), (tangents[0][:2], tangents[0][2])
    )
    y = _loop(step, depth, *args)
    history = run_history(y, history_of(measured, depth), anchor)
    a, limited = sensitivities(step, params, drive, history, lower, upper)
    own = own_history(anchor, depth)
    # Histories taken from the measurement pass their own tangent on directly.
    t_history = jnp.where(own[:, None], 0.0, history_of(t_measured, depth))
    moving, fixed = eqx.partition((params, drive), eqx.is_inexact_array)

    def rows(moving, history):
        params, drive = eqx.combine(moving, fixed)
        return jax.vmap(step, in_axes=(None, 0, 0))(params, drive, history)

    _, direct = jax.jvp(rows, (moving, history), (t_inputs, t_history))
    direct = jnp.where(limited, 0.0, direct)
    a = jnp.where(own[:, None, None], a, 0.0)
    start = jnp.zeros((depth, y.shape[1]), y.dtype)
    return y, linear_recurrence(a, direct, start)[1]


def free_run(
    step: Step,
    params: Any,
    drive: Any,
    measured: Float[Array, "time outputs"],
    anchor: Bool[Array, " time"],
    lower: Float[Array, " outputs"],
    upper: Float[Array, " outputs"],
    *,
    depth: int,
) -> Float[Array, "time outputs"]:
    """Run `step(params, drive_t, history_t)` on its own outputs, one record.

    `step` must close over nothing traced; leaves of `drive` have a leading time axis;
    the history is the last `depth` outputs, newest first, at anchors the `measured`
    ones. Before the first anchor the values are meaningless. Results outside
    [lower, upper] are set to the border, with zero derivative. Differentiable in both
    modes in `params`, `drive` and `measured`.
    """
    return _run((params, drive, measured, anchor, lower, upper), step=step, depth=depth)
