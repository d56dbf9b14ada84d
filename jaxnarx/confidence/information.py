"""Information that a free run has about the parameters, and their variances.

With S_t the derivative of the outputs y_t by the network's own parameters and H_t that
by the measured samples the run started from, both obey the recursion of
`arrays.recurrence` and share one pass.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays import linear_recurrence, program
from jaxnarx.models import Network, depth, fold_slopes
from jaxnarx.refinement import Layout, join_blocks, stream
from jaxnarx.simulation import RunInputs, states


class Sums(NamedTuple):
    """Sums over time and records that hold what a dataset says about the parameters.

    With J_t = S_t, masked and weighted: `bread` is sum w J'J over all outputs, `meat`
    for each output the sum of squares of w J behind the filter of the noise, `state`
    what that filter still holds at the end of each record. `by_start` is sum w J'H.
    """

    bread: Float[Array, "params params"]
    meat: Float[Array, "outputs params params"]
    state: Float[Array, "records outputs order params"]
    by_start: Float[Array, "records params starts"]


def _start_derivative(a, own, since) -> Float[Array, "rows outputs starts"]:
    """Direct derivative by the measured samples before the start, newest first.

    `since` counts samples from the start; there lag d is the measured sample d - since.
    """
    lags = jnp.arange(a.shape[3])
    sample = lags[None] - since[:, None]
    hit = sample[..., None] == lags[None, None]
    hit = hit & ~own[..., None] & (since >= 0)[:, None, None]
    found = jnp.einsum("toid,tdm->toim", a, hit.astype(a.dtype))
    return found.reshape(*found.shape[:2], -1)


def _stream(
    network: Network,
    layout: Layout,
    y: Float[Array, "records time states"],
    drive: RunInputs,
    anchor: Bool[Array, "records time"],
    start: Int[Array, " records"],
    *rest: Any,
) -> tuple[Any, Any]:
    """[S, H] of a finished run; see `sensitivity.stream`."""

    def direct(tangents, seen, time, record):
        a, own = seen
        by_start = _start_derivative(fold_slopes(network, a), own, time - start[record])
        return jnp.concatenate([tangents, by_start], axis=2)

    columns = layout.low.shape[0] + len(network.models) * depth(network)
    return stream(network, layout, y, drive, anchor, direct, columns, *rest)


def colour_noise(shape: Float[Array, " order"], j, past):
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
    drive: RunInputs,
    anchor: Bool[Array, "records time"],
    start: Int[Array, " records"],
    weight: Float[Array, "records time outputs"],
    shape: Float[Array, "outputs order"],
) -> Sums:
    """Everything about the parameters that their covariance needs, in one pass.

    Only the choice of parameters in `layout` counts, not their limits: covariances of a
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
            filtered = jax.vmap(colour_noise, in_axes=(0, 1, 0), out_axes=(0, 1))
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
    found, _ = _stream(network, layout, y, drive, anchor, start, consume, empty, weight)
    return found


@program
def variances(
    network: Network,
    layout: Layout,
    drive: RunInputs,
    anchor: Bool[Array, "records time"],
    start: Int[Array, " records"],
    root: Float[Array, "columns rank"],
) -> Float[Array, "records time outputs"]:
    """Variance of the free run: squared norms of the rows of [S, H] times `root`."""
    y = states(network, drive, anchor)

    def consume(carry, s, _):
        return carry, jnp.sum((s @ root) ** 2, axis=3)

    _, out = _stream(network, layout, y, drive, anchor, start, consume, None, None)
    return join_blocks(out, y.shape[1])
