"""Loss of a run and its normal equations, accumulated in one pass over time.

Residuals are r = sqrt(weight) (run - measured), scaled signals. Sensitivities of the
run by all parameters follow the forward filter of `arrays.recurrence`; they are made
block by block and summed into J'J and J'r at once, so that memory holds one block of
the Jacobian, never the whole.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

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
    scheduling_values,
    with_history,
)
from jaxnarx.refinement.criterion import Criterion, squares
from jaxnarx.refinement.layout import Layout
from jaxnarx.regressors import evaluate
from jaxnarx.simulation import Drive, recursion, run

SAMPLES = 4096
"""Samples per block over all records: the block's Jacobian then stays near the
cache.
"""


@eqx.filter_jit
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
    model: OutputModel, v: Float[Array, "vars rows"], x: Float[Array, "dims rows"]
) -> list[Float[Array, "*shape rows"]]:
    """Derivative of the output by coefficients and by every trained field of validity.

    At fixed lagged variables; samples are the trailing axis.
    """
    z = scheduling_values(model, x)
    terms = evaluate(model.local.factor, v)
    local = jnp.tensordot(model.local.dense(), terms, axes=1)
    phi = model.validity(z, model.active)
    coefficient = jnp.where(
        model.local.used[..., None], phi[:, None] * terms[model.local.index], 0.0
    )

    def blend(parameters, z, local):
        phi = model.validity.replaced(parameters)(z, model.active)
        return jnp.sum(phi * local)

    by_validity = jax.vmap(jax.grad(blend), in_axes=(None, 1, 1), out_axes=-1)
    return [coefficient, *by_validity(model.validity.parameters, z, local)]


def direct_tangents(
    network: Network, layout: Layout, v, x, limited
) -> Float[Array, "rows outputs params"]:
    """Direct tangents D_t of all outputs by all parameters, zero where limited."""
    rows = v.shape[1]
    total = layout.low.shape[0]
    out = []
    for o, (model, keep) in enumerate(zip(network.models, layout.chosen, strict=True)):
        start, stop = layout.spans()[o]
        pieces = [
            leaf.reshape(-1, rows)
            for leaf, k in zip(output_gradient(model, v, x[o]), keep, strict=True)
            if k
        ]
        own = jnp.concatenate([jnp.zeros((0, rows), v.dtype), *pieces]).T
        own = jnp.where(limited[:, o, None], 0.0, own)
        out.append(jnp.pad(own, ((0, 0), (start, total - stop))))
    return jnp.stack(out, axis=1)


def slopes(
    network: Network,
    v: Float[Array, "vars time"],
    x: tuple[Float[Array, "_ time"], ...],
    history: Float[Array, "time outputs depth"],
) -> tuple[Float[Array, "time outputs outputs depth"], Bool[Array, "time outputs"]]:
    """Derivative of every sample by its whole history, and where it is limited."""
    bounds = network.lower, network.upper
    return sensitivities(*recursion(network, v, x), history, *bounds)


def linearised(
    network: Network,
    v: Float[Array, "vars time"],
    x: tuple[Float[Array, "_ time"], ...],
    history: Float[Array, "time outputs depth"],
    own: Bool[Array, "time depth"],
):
    """A_t of a finished run, where it is limited, and the variables as it saw them.

    A_t is the derivative of y_t by the run's own past, (time, outputs, outputs, depth):
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
    direct = direct_tangents(network, layout, v, x, limited)
    if layout.initial is not None:
        by_start = layout.initial.direct(a, own, time, record)
        direct = direct.at[..., layout.parameters :].add(by_start)
    a = jnp.where(own[:, None, None], a, 0.0)
    return linear_recurrence(a, direct, past)


def seen_history(
    network: Network,
    y: Float[Array, "records time outputs"],
    measured: Float[Array, "records time outputs"],
    anchor: Bool[Array, "records time"],
) -> tuple[
    Float[Array, "records time outputs depth"], Bool[Array, "records time depth"]
]:
    """The past outputs every step of a finished run has seen, and which are its own."""
    lags = depth(network)

    def one(y, measured, anchor):
        past = run_history(y, history_of(measured, lags), anchor)
        return past, own_history(anchor, lags)

    return jax.vmap(one)(y, measured, anchor)


@eqx.filter_jit
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
    y = run(network, drive_of, anchor)
    rule = _rule(criterion, y)
    error, bend = rule.errors(y, drive.measured)
    share = weight * rule.share(error)
    records, time, outputs = y.shape
    lags, params = depth(network), u.shape[0]
    blocks = -(-time // max(16, SAMPLES // records))
    size = -(-time // blocks)

    past, own = seen_history(network, y, drive_of.measured, anchor)
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
        here = cut(root, 1)
        # Unscored stretches may be unstable: what overflows there must not count.
        factor = (here * cut(bend, 1))[..., None]
        jacobian = jnp.where(here[..., None] > 0, s * factor, 0.0)
        jacobian = jacobian.reshape(-1, params) * slope[None]
        r = jnp.where(here > 0, cut(scored, 1) * here, 0.0).reshape(-1)
        return (state, gradient + r @ jacobian, gram + jacobian.T @ jacobian), None

    zero = jnp.zeros((records, lags, outputs, params), y.dtype)
    start = (zero, jnp.zeros(params, y.dtype), jnp.zeros((params, params), y.dtype))
    (_, gradient, gram), _ = jax.lax.scan(body, start, jnp.arange(blocks) * size)
    if layout.initial is not None:
        extra = layout.initial.weight.reshape(-1)
        at = layout.parameters + jnp.arange(extra.shape[0])
        gradient = gradient.at[at].add(extra * u[layout.parameters :])
        gram = gram.at[at, at].add(extra)
    value = rule(y, drive.measured, weight) + _initial_loss(layout, u)
    return value, gradient, gram
