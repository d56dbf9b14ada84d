"""One engine's records as the program takes them: masks, weights and ranges."""

import dataclasses

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.data import Batch, Fleet, Padded, check_precision
from jaxnarx.errors import DataError
from jaxnarx.models import (
    Gaussians,
    Network,
    local_models,
    output_model,
    training_bounds,
)
from jaxnarx.partition import scheduling_ranges, scheduling_table
from jaxnarx.regressors import Pool, row_columns, row_places
from jaxnarx.selection import unusable_signals
from jaxnarx.simulation import make_masks

Arrays = np.ndarray | Array


class Part(eqx.Module):
    """Records of one part with what `jaxnarx.simulation.Masks` tells of them."""

    signals: Float[Arrays, "*lanes records time signals"]
    valid: Bool[Arrays, "*lanes records time signals"]
    start: Int[Arrays, "*lanes records"]
    end: Int[Arrays, "*lanes records"]
    anchors: Bool[Arrays, "*lanes records time"]
    scored: Bool[Arrays, "*lanes records time outputs"]


class Member(eqx.Module):
    """One engine: records, and a network that lacks nothing but its model.

    `weight` is that of the rows of selection and growth; `variables` are the lagged
    variables that the data excite, behind "times one".
    """

    network: Network
    variables: Bool[Arrays, "*lanes vars"]
    weight: Float[Arrays, "*lanes records time"]
    train: Part
    validation: Part | None
    test: Part | None


@dataclasses.dataclass(frozen=True, eq=False)
class PreparedMember:
    """A member, or None and the reason why it cannot be identified."""

    member: Member | None
    status: str = "ok"
    detail: str = ""


def prepare(
    fleet: Fleet, n: int, pool: Pool, blank: Network, most: int
) -> PreparedMember:
    """Bring one engine of the fleet into the program's form, for at most so many terms.

    On the host alone. `too_short` where a part has too few rows, `unidentifiable` where
    the output, all inputs or a scheduling variable are constant.
    """
    if fleet.status[n] != "ok":
        return PreparedMember(None, fleet.status[n], fleet.detail[n])
    check_precision(fleet.train.signals.dtype)
    data, scheduling = fleet.dataset(n), blank.models[0].scheduling
    try:
        batch, at, weight, gain = row_places(
            data,
            pool.variables,
            pool.outputs,
            history=max(pool.variables.longest, scheduling.longest),
            need=min(most, len(pool)) + 1,
        )
        x = row_columns(batch, at, scheduling, data.sample_time)
        span = scheduling_ranges(pool, x, scheduling)
        passed_over = unusable_signals(data, pool)
    except DataError as error:
        status = "too_short" if error.channel is None else "unidentifiable"
        return PreparedMember(None, status, str(error))
    parts = {name: make_part(p.pick([n]), blank) for name, p in fleet.parts.items()}
    for name, part in parts.items():
        if not part.scored.any():
            return PreparedMember(
                None, "too_short", f"no sample of {name} can be scored"
            )
    names = pool.channels.names
    good = [names[s] not in passed_over for s, _ in pool.variables]
    rows = np.zeros(parts["train"].anchors.shape, gain.dtype)
    count = int(np.count_nonzero(weight[0]))
    record, time = np.divmod(at[:count], batch.signals.shape[1])
    rows[record, time] = weight[0, :count]
    bounds = training_bounds(data, gain, np.array(blank.signals))
    member = Member(
        eqx.tree_at(_own_leaves, blank, (gain, *bounds, *span)),
        np.array([True, *good]),
        rows,
        parts["train"],
        parts.get("validation"),
        parts.get("test"),
    )
    return PreparedMember(member)


def _own_leaves(network: Network) -> tuple:
    """The arrays that a member's network has of its own before there is a model."""
    bounds = network.lower, network.upper, network.low, network.high
    (model,) = network.models
    return network.gain, *bounds, model.offset, model.span


def make_blank(fleet: Fleet, pool: Pool, scheduling: tuple[str, ...]) -> Network:
    """A network of the fleet's channels whose ranges, gains and model mean nothing."""
    table = scheduling_table(pool, scheduling)
    dtype = fleet.train.signals.dtype
    nothing, one = np.zeros(len(table), dtype), np.zeros((1, 1), dtype)
    every = np.ones(len(fleet.channels.all), dtype)
    validity = Gaussians(*jax.device_put((nothing[None], nothing[None])))
    local = local_models(pool.factor[:1], one)
    model = output_model(local, validity, table, nothing, nothing)
    time = np.asarray(fleet.sample_time, dtype)
    leaves = jax.device_put((every, *(every[:1],) * 2, *(every,) * 2, time))
    network = Network(fleet.channels, pool.outputs, pool.variables, (model,), *leaves)
    return jax.tree.map(np.asarray, network)


def make_part(padded: Padded, network: Network) -> Part:
    """The only member of `padded`, with its masks."""
    signals, valid = padded.signals[0], padded.valid[0]
    masks = make_masks(network, Batch(jax.device_put(signals), valid))
    # A record that is all padding ends where it begins.
    there = valid.any(axis=(1, 2))
    return Part(
        signals,
        valid,
        masks.start,
        np.where(there, masks.end, 0),
        masks.anchors,
        np.asarray(masks.scored),
    )


def stack_lanes(trees: list):
    """Members, or settings, as one tree with a leading axis of lanes."""
    return jax.tree.map(lambda *leaves: jax.device_put(np.stack(leaves)), *trees)
