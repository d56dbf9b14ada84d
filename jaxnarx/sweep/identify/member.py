"""One engine's records as the program takes them: masks, weights and ranges."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.data import Batch, Dataset, Fleet, Padded, check_precision
from jaxnarx.errors import DataError
from jaxnarx.models import Gaussians, Network, assemble, local_models, output_model
from jaxnarx.partition import Ground, make_ground
from jaxnarx.regressors import Pool
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
    fleet: Fleet, n: int, pool: Pool, scheduling: tuple[str, ...], most: int
) -> PreparedMember:
    """Bring one engine of the fleet into the program's form, for at most so many terms.

    `too_short` where a part has too few rows, `unidentifiable` where the output, all
    inputs or a scheduling variable are constant.
    """
    if fleet.status[n] != "ok":
        return PreparedMember(None, fleet.status[n], fleet.detail[n])
    check_precision(fleet.train.signals.dtype)
    data = fleet.dataset(n)
    try:
        few = pool.factor[:most]
        ground = make_ground(pool, [few], data, scheduling, None)
        passed_over = unusable_signals(data, pool)
    except DataError as error:
        status = "too_short" if error.channel is None else "unidentifiable"
        return PreparedMember(None, status, str(error))
    network = _frame_of(ground, data, few)
    parts = {name: make_part(p.pick([n]), network) for name, p in fleet.parts.items()}
    for name, part in parts.items():
        if not part.scored.any():
            return PreparedMember(
                None, "too_short", f"no sample of {name} can be scored"
            )
    names = pool.channels.names
    good = [names[s] not in passed_over for s, _ in pool.variables]
    member = Member(
        jax.tree.map(np.asarray, network),
        np.array([True, *good]),
        _row_weights(ground, parts["train"]),
        parts["train"],
        parts.get("validation"),
        parts.get("test"),
    )
    return PreparedMember(member)


def _frame_of(
    ground: Ground, data: Dataset, few: Int[np.ndarray, "_ degree"]
) -> Network:
    """A network with the ranges and gains of the data, whose model means nothing."""
    dims = len(ground.scheduling)
    nowhere = jnp.zeros((1, dims), ground.rows.y.dtype)
    local = local_models(few[:1], jnp.zeros((1, 1), nowhere.dtype))
    model = output_model(
        local,
        Gaussians(nowhere, nowhere),
        ground.scheduling,
        ground.offset,
        ground.span,
    )
    return assemble(ground.pool, data, ground.rows.gain, [model])


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


def _row_weights(ground: Ground, part: Part) -> Float[np.ndarray, "records time"]:
    """Weights of the rows, at their places in the padded records."""
    longest = ground.rows.batch.signals.shape[1]
    weight = np.zeros(part.anchors.shape, ground.rows.gain.dtype)
    rows = ground.rows.count
    record, time = np.divmod(ground.rows.at[:rows], longest)
    weight[record, time] = np.asarray(ground.rows.weight[0])[:rows]
    return weight


def stacked(trees: list):
    """Members, or settings, as one tree with a leading axis of lanes."""
    return jax.tree.map(lambda *leaves: jax.device_put(np.stack(leaves)), *trees)
