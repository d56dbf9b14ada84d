"""A row of a table as a network again."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.errors import SpecError
from jaxnarx.models import (
    AbstractValidity,
    Boxes,
    Compact,
    Gaussians,
    LogSigmoids,
    Network,
    SigmoidTree,
    local_models,
    output_model,
)
from jaxnarx.partition import scheduling_table
from jaxnarx.sweep.identify.rows import Row
from jaxnarx.sweep.identify.work import IdentificationWork


def _empty_validity(kind: str, count: int, dims: int, dtype) -> AbstractValidity:
    """Validity functions of the right kind and size."""
    each = jnp.zeros((count, dims), dtype)
    gates = jnp.zeros(count - 1, dtype)
    if kind == "SigmoidTree":
        path = jnp.zeros((count, count - 1), int)
        return SigmoidTree(each[1:], gates, gates, path)
    if kind == "LogSigmoids":
        return LogSigmoids(gates, jnp.zeros((), dtype))
    if kind == "Compact":
        return Compact(each, each, each)
    return Boxes(each, each) if kind == "Boxes" else Gaussians(each, each)


@guard_arguments
def network_of(work: IdentificationWork, row: Row) -> Network:
    """The refined network of a row of this work; `row["engine"]` names the member.

    Gains and ranges come from the data.
    """
    fleet, pool, names = work.fleet, work.pool, tuple(row["scheduling"])
    prepared = work.prepared(fleet.index(row["engine"]), names)
    if prepared.member is None or not row["term_index"]:
        raise SpecError(
            f"engine {row['engine']!r} has no network: {row['status']}", field="row"
        )
    frame = jax.device_put(prepared.member.network)
    count = int(row["model_count"])
    dtype, dims = frame.models[0].offset.dtype, len(row["offset"])
    like = _empty_validity(row["validity"], count, dims, dtype)
    theta = np.asarray(row["coefficient"], dtype).reshape(count, -1)
    factor = pool.factor[np.asarray(row["term_index"])]
    model = output_model(
        local_models(factor, theta),
        _fill_validity(like, row["partition"]),
        scheduling_table(pool, names),
        np.asarray(row["offset"], dtype),
        np.asarray(row["span"], dtype),
    )
    return dataclasses.replace(frame, models=(model,))


def _fill_validity(like: AbstractValidity, values: list[float]) -> AbstractValidity:
    leaves, shape = jax.tree.flatten(like)
    ends = np.cumsum([leaf.size for leaf in leaves])[:-1]
    pieces = np.split(np.asarray(values, float), ends)
    new = [
        jnp.asarray(piece.reshape(leaf.shape).astype(leaf.dtype))
        for piece, leaf in zip(pieces, leaves, strict=True)
    ]
    return jax.tree.unflatten(shape, new)
