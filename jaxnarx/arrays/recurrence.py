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

import functools
import operator
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

WRITTEN_OUT = 64
"""Products per step up to which `polynomial_step` names each of them."""
WRITTEN_OUT_SUM = 16
"""Past states up to which `linear_recurrence` names each of them: with five, 1,024
samples of 170 columns took 4 ms in place of 12 (jax 0.10)."""

Step = Callable[[Any, Any, Float[Array, "outputs depth"]], Float[Array, " outputs"]]


def polynomial_step(
    table: Int[np.ndarray, "monomials degree"],
    source: Int[np.ndarray, "states fed_back"],
    lag: Int[np.ndarray, " fed_back"],
) -> Step:
    """Step y_s = sum_a G_t[s, a] prod_f x_s[table[a, f]] with drive G_t.

    x_s = [1, x_1 ... x_E] and x_e is state `source[s, e - 1]`, `lag[e - 1]` + 1 samples
    ago. Short sums are written out term by term, those of the newest outputs last: a
    loop then waits only for these. On CPU that halves a run of ten monomials, and its
    derivative by the history, over all samples at once, costs a tenth.
    """
    if len(source) * len(table) > WRITTEN_OUT:
        return _gathering_step(table, source, lag)
    since = np.concatenate([[np.iinfo(np.int64).max], lag])
    order = np.argsort(-since[table].min(axis=1), kind="stable").tolist()
    rows = [[int(f) - 1 for f in row if f] for row in table]

    def step(params, g, history):
        del params

        def one(s):
            past = [history[i, d] for i, d in zip(source[s], lag, strict=True)]
            products = [(a, [past[e] for e in rows[a]]) for a in order]
            return _weighted_sum(g[s], products)

        return jnp.stack([one(s) for s in range(len(source))])

    return step


def _weighted_sum(weight, products):
    total = jnp.zeros((), weight.dtype)
    for a, factors in products:
        total = total + functools.reduce(operator.mul, factors, weight[a])
    return total


def _gathering_step(table, source, lag) -> Step:
    rows, which = np.unique(source, axis=0, return_inverse=True)

    def step(params, g, history):
        del params
        past = jnp.pad(history[rows, lag], ((0, 0), (1, 0)), constant_values=1.0)
        products = jnp.prod(past[:, table], axis=2)
        if len(rows) == 1:
            return g @ products[0]
        return jnp.sum(g * products[which], axis=1)

    return step


def past_outputs(
    y: Float[Array, "time outputs"], depth: int
) -> Float[Array, "time outputs depth"]:
    """Past outputs of every sample; `[t, :, d]` is `y[t - 1 - d]`.

    Before the start the first sample is repeated; such entries must not be used.
    """
    padded = _prepend_copies(y, depth)
    return jnp.stack(
        [padded[depth - 1 - d : len(padded) - 1 - d] for d in range(depth)], axis=2
    )


def _prepend_copies(
    y: Float[Array, "time outputs"], depth: int
) -> Float[Array, "longer outputs"]:
    """`y` behind `depth` copies of its first sample."""
    first = jnp.broadcast_to(y[:1], (depth, y.shape[1]))
    return jnp.concatenate([first, y])


def own_history(anchor: Bool[Array, " time"], depth: int) -> Bool[Array, "time depth"]:
    """True where lag d of sample t lies at or after the last anchor: simulated.

    That is where none of the samples t - d ... t is an anchor.
    """
    clean = [~anchor]
    for d in range(1, depth):
        earlier = jnp.pad(~anchor, (d, 0), constant_values=True)[: len(anchor)]
        clean.append(clean[-1] & earlier)
    return jnp.stack(clean, axis=1)


def run_history(
    y: Float[Array, "time outputs"],
    measured: Float[Array, "time outputs depth"],
    anchor: Bool[Array, " time"],
) -> Float[Array, "time outputs depth"]:
    """The history each step of a finished run has seen: simulated, else measured."""
    depth = measured.shape[2]
    own = own_history(anchor, depth)[:, None, :]
    return jnp.where(own, past_outputs(y, depth), measured)


def linear_recurrence(
    a: Float[Array, "time outputs outputs depth"],
    d: Float[Array, "time outputs *params"],
    start: Float[Array, "depth outputs *params"],
) -> tuple[Float[Array, "depth outputs *params"], Float[Array, "time outputs *params"]]:
    """S_t[o] = D_t[o] + sum_(i,k) A_t[o, i, k] S_(t-1-k)[i]; returns the end and all S.

    The carry is one array of the last `depth` states, newest first.
    """
    behind = tuple(range(1, d.ndim - 1))

    def step(past, inputs):
        a_t, d_t = inputs
        # A zero weight cuts the past off (an anchor, a limit) even where it overflowed.
        # A dot in the loop body costs more than these fused products.
        if a_t[0].size <= WRITTEN_OUT_SUM:
            now = d_t
            for i, k in np.ndindex(a_t.shape[1:]):
                weight = jnp.expand_dims(a_t[:, i, k], behind)
                now = now + weight * jnp.where(weight != 0, past[k, i][None], 0.0)
        else:
            weight = jnp.expand_dims(
                jnp.swapaxes(a_t, 1, 2), tuple(range(3, past.ndim + 1))
            )
            reached = jnp.where(weight != 0, past[None], 0.0)
            now = d_t + jnp.sum(weight * reached, axis=(1, 2))
        return jnp.concatenate([now[None], past[:-1]]), now

    return jax.lax.scan(step, start, (a, d))


def _loop(step: Step, depth, unroll, params, drive, measured, anchor, lower, upper):
    time = measured.shape[0]
    # Newest first: the history of a sample is then one slice, and no table of
    # histories has to be made and read.
    backwards = _prepend_copies(measured, depth)[::-1]

    def body(past, inputs):
        t, drive_t, anchor_t = inputs
        fresh = jax.lax.dynamic_slice_in_dim(backwards, time - t, depth).T
        past = jnp.where(anchor_t, fresh, past)
        now = jnp.clip(step(params, drive_t, past), lower, upper)
        return jnp.concatenate([now[:, None], past[:, :-1]], axis=1), now

    inputs = jnp.arange(time), drive, anchor
    return jax.lax.scan(body, backwards[time:].T, inputs, unroll=unroll)[1]


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


def _drop_zero_tangents(primal, tangent):
    """`primal` where it has a tangent, else None: a symbolic zero costs nothing."""
    return jax.tree.map(
        lambda t, p: None if t is None else p,
        tangent,
        primal,
        is_leaf=lambda t: t is None,
    )


@eqx.filter_custom_jvp
def _run(args, *, step, depth, unroll):
    return _loop(step, depth, unroll, *args)


@_run.def_jvp
def _run_jvp(primals, tangents, *, step, depth, unroll):
    (args,) = primals
    params, drive, measured, anchor, lower, upper = args
    y = _loop(step, depth, unroll, *args)
    own = own_history(anchor, depth)
    history = run_history(y, past_outputs(measured, depth), anchor)
    a, limited = sensitivities(step, params, drive, history, lower, upper)

    def rows(inputs, measured):
        # Histories taken from the measurement pass their own tangent on directly.
        seen = history
        if measured is not None:
            seen = jnp.where(own[:, None], history, past_outputs(measured, depth))
        both = eqx.combine(inputs, (params, drive))
        return jax.vmap(step, in_axes=(None, 0, 0))(*both, seen)

    moved = tangents[0][:2], tangents[0][2]
    moving = _drop_zero_tangents(((params, drive), measured), moved)
    _, direct = jax.jvp(rows, moving, moved)
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
    unroll: int = 1,
) -> Float[Array, "time outputs"]:
    """Run `step(params, drive_t, history_t)` on its own outputs, one record.

    `step` must close over nothing traced; leaves of `drive` have a leading time axis;
    the history is the last `depth` outputs, newest first, at anchors the `measured`
    ones. Before the first anchor the values are meaningless. Results outside
    [lower, upper] are set to the border, with zero derivative. Differentiable in both
    modes in `params`, `drive` and `measured`.

    `unroll` steps are written out per turn of the loop. It changes no result. On CPU 1
    is the fastest: with ten monomials and 100,000 samples 2, 4 and 8 took 3, 10 and 6
    times as long (jax 0.10), since the compiler makes one function of a small loop
    only. Other hardware may differ.
    """
    args = (params, drive, measured, anchor, lower, upper)
    return _run(args, step=step, depth=depth, unroll=unroll)
