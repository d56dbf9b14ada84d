"""Sensitivities of a finished run, streamed over time.

With A_t the derivative of a sample by the run's own past and D_t that by anything else,
sensitivities obey the forward filter S_t = A_t S_past + D_t of `arrays.recurrence`.
They are made block by block and handed on at once, so that memory holds one block of
them, never all.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxnarx.arrays import (
    linear_recurrence,
    own_history,
    past_outputs,
    run_history,
    sensitivities,
)
from jaxnarx.models import (
    Network,
    depth,
    places,
    recursion,
    scheduling_values,
    term_values,
    widen,
    with_history,
    with_own,
)
from jaxnarx.refinement.layout import Layout
from jaxnarx.simulation import RunInputs

BLOCK_SAMPLES = 4096
"""Samples per block over all records: the block's Jacobian then stays near the
cache.
"""


Consumer = Callable[[Any, Float[Array, "records rows outputs columns"], Any], Any]
Direct = Callable[[Any, Any, Any, Any], Float[Array, "rows states columns"]]


def output_gradient(
    network: Network,
    output: int,
    v: Float[Array, "vars rows"] | Float[Array, "models vars rows"],
    x: Float[Array, "dims rows"],
) -> tuple[list[Float[Array, "*shape rows"]], list[Float[Array, "groups *shape rows"]]]:
    """Derivative of an output by coefficients and by every trained field of validity.

    At fixed lagged variables, all local models' or each one's own; samples are the
    trailing axis. The second result holds those of the outputs of groups with feedback
    of their own.
    """
    model = network.models[output]
    z, values = scheduling_values(model, x), partial(term_values, network, model)
    if v.ndim == 2:
        terms = values(v)
        local = jnp.tensordot(model.local.dense(), terms, axes=1)
        mine = terms[model.local.index]
    else:
        terms = jax.vmap(values)(v)
        local = jnp.einsum("mk,mkr->mr", model.local.dense(), terms)
        mine = jnp.take_along_axis(terms, model.local.index[..., None], axis=1)
    phi = model.validity(z, model.active)
    alone = jnp.where(model.local.used[..., None], mine, 0.0)
    weight = jnp.zeros((0, *phi.shape), phi.dtype)
    by_local = phi
    if model.own is not None:
        weight = model.shares(phi)
        if model.root is not None:
            slope = model.root.slope(jnp.sum(weight * local[None], axis=1))
            weight = weight * slope[:, None]
            by_local = model.rest(phi) + jnp.sum(
                model.group_weights(phi)[:, None] * weight, axis=0
            )
    coefficient = by_local[:, None] * alone

    def blend(parameters, z, local):
        phi = model.validity.replace_parameters(parameters)(z, model.active)
        return model.add_up(phi, local)[0]

    by_validity = jax.vmap(jax.grad(blend), in_axes=(None, 1, 1), out_axes=-1)
    by_fields = by_validity(model.validity.parameters, z, local)
    by_output = [coefficient, *by_fields]
    if model.own is None:
        return by_output, []

    def group(parameters, z, local):
        phi = model.validity.replace_parameters(parameters)(z, model.active)
        return model.add_up(phi, local)[1]

    groups, models = model.own.shape
    if groups == models:  # each one local model, whose weight is one
        by_fields = [jnp.zeros((groups, *leaf.shape), leaf.dtype) for leaf in by_fields]
    else:
        by_group = jax.vmap(jax.jacrev(group), in_axes=(None, 1, 1), out_axes=-1)
        by_fields = by_group(model.validity.parameters, z, local)
    return by_output, [weight[:, :, None] * alone[None], *by_fields]


def direct_tangents(
    network: Network, layout: Layout, v, x, limited, history
) -> Float[Array, "rows states params"]:
    """Direct tangents D_t of all outputs by all parameters, zero where limited.

    Behind the outputs those of groups that have feedback of their own; `history`
    (rows, states, depth) is what they have seen.
    """
    rows = v.shape[1]
    total = layout.low.shape[0]
    out, alone = [], []
    parts = zip(network.models, places(network), strict=True)
    for o, (model, at) in enumerate(parts):
        start, stop = layout.spans()[o]
        seen = v
        if model.own is not None:
            seen = with_own(network, o, v, jnp.moveaxis(history[:, at], 0, -1))
        leaves, by_group = output_gradient(network, o, seen, x[o])

        shared = layout.shared(o)

        def flat(leaves, o=o, start=start, stop=stop, shared=shared):
            leaves = [layout.by_vector(o, leaves[0]), *leaves[1:]]
            pieces = layout.rows_of(o, leaves)
            own = jnp.concatenate([jnp.zeros((0, rows), v.dtype), *pieces]).T
            whole = jnp.pad(own, ((0, 0), (start, total - stop)))
            if shared is None:
                return whole
            first, kept = shared
            pairs = zip(leaves[1:], kept, strict=True)
            pieces = [leaf.reshape(-1, rows) for leaf, is_kept in pairs if is_kept]
            gates = jnp.concatenate([jnp.zeros((0, rows), v.dtype), *pieces]).T
            last = first + gates.shape[1]
            return whole + jnp.pad(gates, ((0, 0), (first, total - last)))

        out.append(flat(leaves)[:, None])
        if by_group:
            alone.append(jax.vmap(flat, out_axes=1)(by_group))
    every = jnp.concatenate([*out, *alone], axis=1)
    return jnp.where(limited[..., None], 0.0, every)


def slopes(
    network: Network,
    v: Float[Array, "vars time"],
    x: tuple[Float[Array, "_ time"], ...],
    history: Float[Array, "time states depth"],
) -> tuple[Float[Array, "time states states depth"], Bool[Array, "time states"]]:
    """Derivative of every sample by its whole history, and where it is limited."""
    bounds = widen(network, network.lower), widen(network, network.upper)
    return sensitivities(*recursion(network, v, x), history, *bounds)


def linearise_run(
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


def seen_history(
    network: Network,
    y: Float[Array, "records time states"],
    measured: Float[Array, "records time outputs"],
    anchor: Bool[Array, "records time"],
) -> tuple[
    Float[Array, "records time states depth"], Bool[Array, "records time depth"]
]:
    """The past outputs every step of a finished run has seen, and which are its own.

    `y` is all that its loop carried, see `jaxnarx.models.run_states`.
    """
    lags, measured = depth(network), widen(network, measured)

    def one(y, measured, anchor):
        past = run_history(y, past_outputs(measured, lags), anchor)
        return past, own_history(anchor, lags)

    return jax.vmap(one)(y, measured, anchor)


def stream(
    network: Network,
    layout: Layout,
    y: Float[Array, "records time states"],
    drive: RunInputs,
    anchor: Bool[Array, "records time"],
    direct: Direct,
    columns: int,
    consume: Consumer,
    carry: Any,
    extra: Any,
) -> tuple[Any, Any]:
    """Hand sensitivities of a finished run to `consume(carry, block, extra)`.

    `y` is all that the run's loop has carried (`jaxnarx.simulation.states`). There are
    `columns` of them, and `direct(tangents, (a, own), time, record)` gives D_t from the
    direct tangents by the parameters and the derivative by the whole history, of one
    record. Blocks follow one another in time. `extra` is a tree of arrays (records,
    time, ...) that are cut alike; padding of the last block is zero there. Results of
    `consume` other than the carry are stacked along a leading axis of blocks.
    """
    records, _, states = y.shape
    outputs, lags = len(network.models), depth(network)

    def one(block, at, record, past):
        v, x, history, own = block
        a, limited = slopes(network, v, x, history)
        v, x = with_history(network, v, x, jnp.moveaxis(history, 0, -1))
        tangents = direct_tangents(network, layout, v, x, limited, history)
        tangents = direct(tangents, (a, own), at, record)
        return linear_recurrence(jnp.where(own[:, None, None], a, 0.0), tangents, past)

    def consume_outputs(carry, s, extra):
        return consume(carry, s[:, :, :outputs], extra)

    past = jnp.zeros((records, lags, states, columns), y.dtype)
    run = network, y, drive, anchor
    return walk_blocks(*run, one, past, consume_outputs, carry, extra)


Rows = Callable[[Any, Any, Any, Any], tuple[Any, Float[Array, "rows states columns"]]]


def walk_blocks(
    network: Network,
    y: Float[Array, "records time states"],
    drive: RunInputs,
    anchor: Bool[Array, "records time"],
    rows: Rows,
    past: Float[Array, "records ..."],
    consume: Consumer,
    carry: Any,
    extra: Any,
) -> tuple[Any, Any]:
    """Blocks of a finished run one after the other; see `stream`.

    `rows(block, time, record, past)` makes the sensitivities of one record over one
    block, its variables, scheduling variables, history and which of that is its own; it
    returns the end and all.
    """
    records, time, _ = y.shape
    blocks = -(-time // max(16, BLOCK_SAMPLES // records))
    size = -(-time // blocks)
    seen, own = seen_history(network, y, drive.measured, anchor)

    def pad(a, axis):
        room = [(0, 0)] * a.ndim
        room[axis] = (0, blocks * size - time)
        return jnp.pad(a, room)

    # Once and outside the loop.
    whole = (
        pad(drive.v, 2),
        tuple(pad(x, 2) for x in drive.x),
        pad(seen, 1),
        pad(own, 1),
    )
    extra = jax.tree.map(lambda a: pad(a, 1), extra)

    def body(state, start):
        past, carry = state

        def cut(a, axis=1):
            return jax.lax.dynamic_slice_in_dim(a, start, size, axis)

        v, x, history, own = whole
        block = (cut(v, 2), tuple(cut(x_o, 2) for x_o in x), cut(history), cut(own))
        each = jax.vmap(rows, in_axes=(0, None, 0, 0))
        past, s = each(block, start + jnp.arange(size), jnp.arange(records), past)
        carry, out = consume(carry, s, jax.tree.map(cut, extra))
        return (past, carry), out

    (_, carry), out = jax.lax.scan(body, (past, carry), jnp.arange(blocks) * size)
    return carry, out


def join_blocks(
    out: Float[Array, "blocks records rows outputs"], time: int
) -> Float[Array, "records time outputs"]:
    """Blocks of `stream` behind one another, the padding cut off."""
    rows = jnp.moveaxis(out, 0, 1)
    return rows.reshape(rows.shape[0], -1, rows.shape[3])[:, :time]
