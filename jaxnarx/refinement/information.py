"""Sensitivities of a free run by parameters and by its start, streamed over time.

With S_t the derivative of the outputs y_t by the network's own parameters and H_t that
by the measured samples the run started from, both obey the recursion of
`arrays.recurrence` and share one pass. Memory holds one block of them.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays.programs import program
from jaxnarx.arrays.recurrence import linear_recurrence
from jaxnarx.models import Network, depth, folded
from jaxnarx.refinement.layout import Layout
from jaxnarx.refinement.normal import SAMPLES, direct_tangents, linearised, seen_history
from jaxnarx.simulation import Drive, states

Consumer = Callable[[Any, Float[Array, "records rows outputs params"], Any], Any]


class Sums(NamedTuple):
    """What a dataset says about the parameters, summed over time and records.

    With J_t = S_t, masked and weighted: `bread` is sum w J'J over all outputs, `meat`
    for each output the sum of squares of w J behind the filter of the noise, `state`
    what that filter still holds at the end of each record. `by_start` is sum w J'H.
    """

    bread: Float[Array, "params params"]
    meat: Float[Array, "outputs params params"]
    state: Float[Array, "records outputs order params"]
    by_start: Float[Array, "records params starts"]


def _by_start(a, own, since) -> Float[Array, "rows outputs starts"]:
    """Direct derivative by the measured samples before the start, newest first.

    `since` counts samples from the start; there lag d is the measured sample d - since.
    """
    lags = jnp.arange(a.shape[3])
    sample = lags[None] - since[:, None]
    hit = sample[..., None] == lags[None, None]
    hit = hit & ~own[..., None] & (since >= 0)[:, None, None]
    found = jnp.einsum("toid,tdm->toim", a, hit.astype(a.dtype))
    return found.reshape(*found.shape[:2], -1)


def _block(network: Network, layout: Layout, block, since, past):
    """Sensitivities [S, H] of one record over one block; returns the end and all."""
    v, x, history, own = block
    whole = linearised(network, v, x, history, jnp.ones_like(own))
    a, limited, v, x = whole
    direct = direct_tangents(network, layout, v, x, limited, history)
    by_start = _by_start(folded(network, a), own, since)
    direct = jnp.concatenate([direct, by_start], axis=2)
    a = jnp.where(own[:, None, None], a, 0.0)
    return linear_recurrence(a, direct, past)


def stream(
    network: Network,
    layout: Layout,
    y: Float[Array, "records time states"],
    drive: Drive,
    anchor: Bool[Array, "records time"],
    start: Int[Array, " records"],
    consume: Consumer,
    carry: Any,
    extra: Any,
) -> tuple[Any, Any]:
    """Hand [S, H] of a finished run to `consume(carry, block, extra)`.

    `y` is all that the run's loop has carried (`jaxnarx.simulation.states`).
    Blocks follow one another in time. `extra` is a tree of arrays (records, time, ...)
    that are cut alike; padding of the last block is zero there. What `consume` returns
    beside the carry is stacked along a leading axis of blocks.
    """
    records, time, _ = y.shape
    outputs = len(network.models)
    lags, params = depth(network), layout.low.shape[0]
    blocks = -(-time // max(16, SAMPLES // records))
    size = -(-time // blocks)
    past, own = seen_history(network, y, drive.measured, anchor)

    def padded(a, axis):
        room = [(0, 0)] * a.ndim
        room[axis] = (0, blocks * size - time)
        return jnp.pad(a, room)

    whole = (
        padded(drive.v, 2),
        tuple(padded(x, 2) for x in drive.x),
        padded(past, 1),
        padded(own, 1),
    )
    extra = jax.tree.map(lambda a: padded(a, 1), extra)

    def body(state, at):
        past, carry = state

        def cut(a, axis=1):
            return jax.lax.dynamic_slice_in_dim(a, at, size, axis)

        v, x, history, own = whole
        block = (cut(v, 2), tuple(cut(x_o, 2) for x_o in x), cut(history), cut(own))
        since = at + jnp.arange(size)[None] - start[:, None]
        one = lambda b, n, s: _block(network, layout, b, n, s)  # noqa: E731
        past, s = jax.vmap(one)(block, since, past)
        carry, out = consume(carry, s[:, :, :outputs], jax.tree.map(cut, extra))
        return (past, carry), out

    zero = jnp.zeros((records, lags, y.shape[2], params + outputs * lags), y.dtype)
    (_, carry), out = jax.lax.scan(body, (zero, carry), jnp.arange(blocks) * size)
    return carry, out


def joined(
    out: Float[Array, "blocks records rows outputs"], time: int
) -> Float[Array, "records time outputs"]:
    """Blocks of `stream` behind one another, the padding cut off."""
    rows = jnp.moveaxis(out, 0, 1)
    return rows.reshape(rows.shape[0], -1, rows.shape[3])[:, :time]


def coloured(shape: Float[Array, " order"], j, past):
    """z_t = sum_k shape[k] z_(t-1-k) + j_t for one output of one record.

    For noise of innovation variance one, R the matrix of its covariances, the sum of
    z_t z_t' over all time until the filter is empty is J'RJ exactly: R is the product
    of the filter's transpose and the filter.
    """
    a = jnp.broadcast_to(shape, (j.shape[0], 1, 1, shape.shape[0]))
    end, z = linear_recurrence(a, j[:, None], past[:, None])
    return end[:, 0], z[:, 0]


@program
def sums(
    network: Network,
    layout: Layout,
    drive: Drive,
    anchor: Bool[Array, "records time"],
    start: Int[Array, " records"],
    weight: Float[Array, "records time outputs"],
    shape: Float[Array, "outputs order"],
) -> Sums:
    """Everything about the parameters that their covariance needs, in one pass.

    Of `layout` only the choice of parameters counts, not their limits: covariances of a
    parameter are those of its free neighbourhood.
    """
    y = states(network, drive, anchor)
    params, order = layout.low.shape[0], shape.shape[1]
    lags, records, outputs = depth(network), y.shape[0], len(network.models)

    def consume(carry, s, weight):
        # Unscored stretches may be unstable: what overflows there must not count.
        w = weight[..., None]
        s = jnp.where(w > 0, s, 0.0)
        j, h = s[..., :params], s[..., params:]
        pulled = w * j
        bread = carry.bread + jnp.einsum("rtop,rtoq->pq", pulled, j)
        by_start = carry.by_start + jnp.einsum("rtop,rtoh->rph", pulled, h)
        state, z = carry.state, pulled
        if order:
            filtered = jax.vmap(coloured, in_axes=(0, 1, 0), out_axes=(0, 1))
            state, z = jax.vmap(filtered, in_axes=(None, 0, 0))(shape, pulled, state)
        meat = carry.meat + jnp.einsum("rtop,rtoq->opq", z, z)
        return Sums(bread, meat, state, by_start), None

    def zeros(*size):
        return jnp.zeros(size, y.dtype)

    empty = Sums(
        zeros(params, params),
        zeros(outputs, params, params),
        zeros(records, outputs, order, params),
        zeros(records, params, outputs * lags),
    )
    found, _ = stream(network, layout, y, drive, anchor, start, consume, empty, weight)
    return found


@program
def variances(
    network: Network,
    layout: Layout,
    drive: Drive,
    anchor: Bool[Array, "records time"],
    start: Int[Array, " records"],
    root: Float[Array, "columns rank"],
) -> Float[Array, "records time outputs"]:
    """Variance of the free run: squared norms of the rows of [S, H] times `root`."""
    y = states(network, drive, anchor)

    def consume(carry, s, _):
        return carry, jnp.sum((s @ root) ** 2, axis=3)

    _, out = stream(network, layout, y, drive, anchor, start, consume, None, None)
    return joined(out, y.shape[1])
