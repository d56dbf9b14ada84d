"""Loss of a run and its normal equations, accumulated in one pass over time.

Residuals are r = sqrt(weight) (run - measured), scaled signals. Sensitivities of the
run by all parameters follow the forward filter of `arrays.recurrence`; they are made
block by block and summed into J'J and J'r at once, so that memory holds one block of
the Jacobian, never the whole.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxnarx.arrays.programs import program
from jaxnarx.arrays.recurrence import (
    history_of,
    linear_recurrence,
    own_history,
    run_history,
    sensitivities,
)
from jaxnarx.models import (
    Network,
    OutputModel,
    depth,
    folded,
    places,
    scheduling_values,
    widened,
    with_history,
    with_own,
)
from jaxnarx.refinement.criterion import Criterion, squares
from jaxnarx.refinement.layout import Layout
from jaxnarx.regressors import evaluate
from jaxnarx.simulation import Drive, recursion, run, states

SAMPLES = 4096
"""Samples per block over all records: the block's Jacobian then stays near the
cache.
"""


@program
def loss(
    layout: Layout,
    u: Float[Array, " params"],
    drive: Drive,
    anchor: Bool[Array, "records time"],
    weight: Float[Array, "records time outputs"],
    criterion: Criterion | None = None,
) -> Float[Array, ""]:
    """Weighted errors of the run restarted at anchors; by default their squares."""
    started = _started(layout, u, drive)
    y = run(layout.place(u), started, anchor)
    rule = _rule(criterion, y)
    return rule(y, drive.measured, weight) + _initial_loss(layout, u)


def _rule(criterion: Criterion | None, y) -> Criterion:
    return squares(y.shape[-1], y.dtype) if criterion is None else criterion


def _started(layout: Layout, u, drive: Drive) -> Drive:
    measured = layout.begin(u, drive.measured)
    return eqx.tree_at(lambda d: d.measured, drive, measured)


def _initial_loss(layout: Layout, u) -> Float[Array, ""]:
    """What the offsets of the initial conditions cost."""
    if layout.initial is None:
        return jnp.zeros((), u.dtype)
    offset = u[layout.parameters :]
    return jnp.sum(layout.initial.weight.reshape(-1) * offset**2)


def output_gradient(
    model: OutputModel,
    v: Float[Array, "vars rows"] | Float[Array, "models vars rows"],
    x: Float[Array, "dims rows"],
) -> tuple[list[Float[Array, "*shape rows"]], Float[Array, "models slots rows"]]:
    """Derivative of the output by coefficients and by every trained field of validity.

    At fixed lagged variables, all local models' or each one's own; samples are the
    trailing axis. Beside it that of every local model's output by its coefficients.
    """
    z = scheduling_values(model, x)
    every = jax.vmap(partial(evaluate, model.local.factor))
    if v.ndim == 2:
        terms = evaluate(model.local.factor, v)
        local = jnp.tensordot(model.local.dense(), terms, axes=1)
        mine = terms[model.local.index]
    else:
        terms = every(v)
        local = jnp.einsum("mk,mkr->mr", model.local.dense(), terms)
        mine = jnp.take_along_axis(terms, model.local.index[..., None], axis=1)
    phi = model.validity(z, model.active)
    alone = jnp.where(model.local.used[..., None], mine, 0.0)
    coefficient = phi[:, None] * alone

    def blend(parameters, z, local):
        phi = model.validity.replaced(parameters)(z, model.active)
        return jnp.sum(phi * local)

    by_validity = jax.vmap(jax.grad(blend), in_axes=(None, 1, 1), out_axes=-1)
    by_fields = by_validity(model.validity.parameters, z, local)
    return [coefficient, *by_fields], alone


def direct_tangents(
    network: Network, layout: Layout, v, x, limited, history
) -> Float[Array, "rows states params"]:
    """Direct tangents D_t of all outputs by all parameters, zero where limited.

    Behind the outputs those of local models that have feedback of their own; `history`
    (rows, states, depth) is what they have seen.
    """
    rows = v.shape[1]
    total = layout.low.shape[0]
    out, alone = [], []
    parts = zip(network.models, layout.chosen, places(network), strict=True)
    for o, (model, keep, at) in enumerate(parts):
        start, stop = layout.spans()[o]
        seen = v
        if model.own is not None:
            seen = with_own(network, o, v, jnp.moveaxis(history[:, at], 0, -1))
        leaves, by_coefficient = output_gradient(model, seen, x[o])
        leaves[0] = layout.by_vector(o, leaves[0])
        pieces = [
            leaf.reshape(-1, rows) for leaf, k in zip(leaves, keep, strict=True) if k
        ]
        own = jnp.concatenate([jnp.zeros((0, rows), v.dtype), *pieces]).T
        out.append(jnp.pad(own, ((0, 0), (start, total - stop)))[:, None])
        if model.own is not None:
            local = _block_diagonal(layout.by_vector(o, by_coefficient), keep[0])
            room = total - start - local.shape[2]
            alone.append(jnp.pad(local, ((0, 0), (0, 0), (start, room))))
    every = jnp.concatenate([*out, *alone], axis=1)
    return jnp.where(limited[..., None], 0.0, every)


def _block_diagonal(
    leaf: Float[Array, "models slots rows"], kept: bool
) -> Float[Array, "rows models params"]:
    """Every local model's output by the coefficients of all, or by nothing."""
    models, slots, rows = leaf.shape
    if not kept:
        return jnp.zeros((rows, models, 0), leaf.dtype)
    one = jnp.eye(models, dtype=leaf.dtype)
    both = jnp.einsum("msr,mn->rmns", leaf, one)
    return both.reshape(rows, models, models * slots)


def slopes(
    network: Network,
    v: Float[Array, "vars time"],
    x: tuple[Float[Array, "_ time"], ...],
    history: Float[Array, "time states depth"],
) -> tuple[Float[Array, "time states states depth"], Bool[Array, "time states"]]:
    """Derivative of every sample by its whole history, and where it is limited."""
    bounds = widened(network, network.lower), widened(network, network.upper)
    return sensitivities(*recursion(network, v, x), history, *bounds)


def linearised(
    network: Network,
    v: Float[Array, "vars time"],
    x: tuple[Float[Array, "_ time"], ...],
    history: Float[Array, "time states depth"],
    own: Bool[Array, "time depth"],
):
    """A_t of a finished run, where it is limited, and the variables as it saw them.

    A_t is the derivative of y_t by the run's own past, (time, states, states, depth):
    zero for measured history and where the feedback bound acts.
    """
    a, limited = slopes(network, v, x, history)
    a = jnp.where(own[:, None, None], a, 0.0)
    return a, limited, *with_history(network, v, x, jnp.moveaxis(history, 0, -1))


def _record_block(network: Network, layout: Layout, block, time, record, past):
    """Sensitivities of one record over one block of time; returns the end and all."""
    v, x, history, own = block
    a, limited = slopes(network, v, x, history)
    v, x = with_history(network, v, x, jnp.moveaxis(history, 0, -1))
    direct = direct_tangents(network, layout, v, x, limited, history)
    if layout.initial is not None:
        by_start = layout.initial.direct(folded(network, a), own, time, record)
        direct = direct.at[..., layout.parameters :].add(by_start)
    a = jnp.where(own[:, None, None], a, 0.0)
    return linear_recurrence(a, direct, past)


def seen_history(
    network: Network,
    y: Float[Array, "records time states"],
    measured: Float[Array, "records time outputs"],
    anchor: Bool[Array, "records time"],
) -> tuple[
    Float[Array, "records time states depth"], Bool[Array, "records time depth"]
]:
    """The past outputs every step of a finished run has seen, and which are its own.

    `y` is all that its loop carried, see `jaxnarx.simulation.run_states`.
    """
    lags, measured = depth(network), widened(network, measured)

    def one(y, measured, anchor):
        past = run_history(y, history_of(measured, lags), anchor)
        return past, own_history(anchor, lags)

    return jax.vmap(one)(y, measured, anchor)


@program
def normal_equations(
    layout: Layout,
    u: Float[Array, " params"],
    drive: Drive,
    anchor: Bool[Array, "records time"],
    weight: Float[Array, "records time outputs"],
    criterion: Criterion | None = None,
) -> tuple[Float[Array, ""], Float[Array, " params"], Float[Array, "params params"]]:
    """Loss, J'r and J'J of the run restarted at anchors, by the coordinates `u`.

    J'r is half the gradient of the loss. Under a robust loss J'J holds the weights of
    iteratively reweighted least squares.
    """
    network, drive_of = layout.place(u), _started(layout, u, drive)
    every = states(network, drive_of, anchor)
    y = every[..., : len(network.models)]
    rule = _rule(criterion, y)
    error, bend = rule.errors(y, drive.measured)
    share = weight * rule.share(error)
    records, time, outputs = y.shape
    lags, params = depth(network), u.shape[0]
    blocks = -(-time // max(16, SAMPLES // records))
    size = -(-time // blocks)

    past, own = seen_history(network, every, drive_of.measured, anchor)
    slope = layout.slope(u)

    def padded(a, axis):
        extra = [(0, 0)] * a.ndim
        extra[axis] = (0, blocks * size - time)
        return jnp.pad(a, extra)

    # Once and outside the loop; what is padded has no weight.
    whole = (
        padded(drive.v, 2),
        tuple(padded(x, 2) for x in drive.x),
        padded(past, 1),
        padded(own, 1),
    )
    root, scored = padded(jnp.sqrt(share), 1), padded(error, 1)
    bend = padded(bend, 1)

    def body(carry, start):
        state, gradient, gram = carry

        def cut(a, axis):
            return jax.lax.dynamic_slice_in_dim(a, start, size, axis)

        v, x, past, own = whole
        block = (cut(v, 2), tuple(cut(x_o, 2) for x_o in x), cut(past, 1), cut(own, 1))
        at = start + jnp.arange(size)
        one = lambda b, n, s: _record_block(network, layout, b, at, n, s)  # noqa: E731
        state, s = jax.vmap(one)(block, jnp.arange(records), state)
        s = s[:, :, :outputs]
        here = cut(root, 1)
        # Unscored stretches may be unstable: what overflows there must not count.
        factor = (here * cut(bend, 1))[..., None]
        jacobian = jnp.where(here[..., None] > 0, s * factor, 0.0)
        jacobian = jacobian.reshape(-1, params) * slope[None]
        r = jnp.where(here > 0, cut(scored, 1) * here, 0.0).reshape(-1)
        return (state, gradient + r @ jacobian, gram + jacobian.T @ jacobian), None

    zero = jnp.zeros((records, lags, every.shape[2], params), y.dtype)
    start = (zero, jnp.zeros(params, y.dtype), jnp.zeros((params, params), y.dtype))
    (_, gradient, gram), _ = jax.lax.scan(body, start, jnp.arange(blocks) * size)
    if layout.initial is not None:
        extra = layout.initial.weight.reshape(-1)
        at = layout.parameters + jnp.arange(extra.shape[0])
        gradient = gradient.at[at].add(extra * u[layout.parameters :])
        gram = gram.at[at, at].add(extra)
    value = rule(y, drive.measured, weight) + _initial_loss(layout, u)
    return value, gradient, gram
