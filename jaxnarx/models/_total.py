"""A weighted sum of networks as one network."""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from jaxnarx.errors import SpecError
from jaxnarx.models._assemble import local_models, output_model
from jaxnarx.models.feedback import fed_back_variables
from jaxnarx.models.network import Network, OutputModel
from jaxnarx.models.validity import SigmoidTree
from jaxnarx.regressors import Variables

COMMON_FIELDS = "gain lower upper low high sample_time hold outside".split()
"""Fields that networks which are added have in common: they are made of one dataset."""


def total(networks: Sequence[Network], weights: Sequence[float]) -> Network:
    """The sum of networks of one output, times weights that are brought to sum one.

    Gates that are open to the same share everywhere stand above the trees of the parts,
    so that the result is a tree of gates too; one local model alone is a tree without.
    The local models of a part are a group that is fed back its own output: a free run
    is the sum of the parts' free runs, begun after the longest of their histories, as
    long as none meets its bounds.

    `SpecError` where no network is that sum: several outputs, channels or limits that
    differ, hidden channels, feedback of local models' own, other validity functions, or
    scheduling on the output.
    """
    for network in networks:
        _require_fit(network, networks[0])
    share = np.asarray(weights, float)
    if len(share) != len(networks) or np.any(share <= 0):
        raise SpecError("a sum has a positive weight for every part", field="weights")
    if len(networks) == 1:
        return networks[0]
    first, models = networks[0], [network.models[0] for network in networks]
    tables = [network.variables for network in networks]
    variables, scheduling = _all(tables), _all([m.scheduling for m in models])
    offset, span = _scales(models, scheduling)
    parts = [_part(model, scheduling, offset, span) for model in models]
    factor, theta = _terms(networks, parts, variables)
    validity = _above(parts, share / share.sum())
    local = local_models(factor, theta, sparse=True)
    model = output_model(local, validity, scheduling, offset, span)
    edges = np.cumsum([0, *(len(part.leaves) for part in parts)]).tolist()
    own = np.zeros((0, edges[-1]), bool)
    for network, (start, end) in zip(networks, itertools.pairwise(edges), strict=True):
        if fed_back_variables(network.variables, network.signals):
            row = np.isin(np.arange(edges[-1]), np.arange(start, end))
            own = np.concatenate([own, row[None]])
    if len(own):
        model = dataclasses.replace(model, own=jax.device_put(own))
    whole = dataclasses.replace(first, variables=variables, models=(model,))
    return dataclasses.replace(whole, domain=None, certificate=None, errors=None)


class _Part(NamedTuple):
    """A tree over the scheduling variables of all: its gates, the sides of its leaves,
    and which local models these are."""

    direction: Float[np.ndarray, "gates dims"]
    border: Float[np.ndarray, " gates"]
    log_steepness: Float[np.ndarray, " gates"]
    path: Int[np.ndarray, "leaves gates"]
    leaves: Int[np.ndarray, " leaves"]


def _require_fit(network: Network, first: Network) -> None:
    (model, *more), known = network.models, network.channels == first.channels
    same = [_equal(getattr(network, f), getattr(first, f)) for f in COMMON_FIELDS]
    if more or not known or network.modelled != first.modelled or not all(same):
        raise SpecError(
            "networks that are added have one output and the same channels, sample "
            "time, gains and limits",
            field="networks",
        )
    if network.hidden or network.parallel:
        raise SpecError(
            "networks that are added have no hidden channels, and local models that "
            "are fed back the network's output",
            field="networks",
        )
    alone = int(np.asarray(model.active).sum()) == 1
    if not alone and not isinstance(model.validity, SigmoidTree):
        raise SpecError(
            f"networks that are added are trees of gates, not of "
            f"{type(model.validity).__name__}",
            field="networks",
        )
    if fed_back_variables(model.scheduling, network.signals):
        raise SpecError(
            f"{network.output_names[0]} schedules itself; in a sum that would be the "
            "output of all parts",
            field="networks",
        )


def _equal(a, b) -> bool:
    return a is b or (a is not None and b is not None and np.array_equal(a, b))


def _all(tables: Sequence[Variables]) -> Variables:
    """Every variable of several tables, once."""
    entries = itertools.chain(*(table.entries for table in tables))
    return Variables.of(list(dict.fromkeys(entries)))


def _places(table: Variables, among: Variables) -> list[int]:
    return [among.entries.index(entry) for entry in table.entries]


def _scales(models: Sequence[OutputModel], table: Variables):
    """Offset and span of the scheduling variables, by the first that has each."""
    offset, span = np.zeros(len(table)), np.ones(len(table))
    for model in reversed(models):
        at = _places(model.scheduling, table)
        offset[at], span[at] = np.asarray(model.offset), np.asarray(model.span)
    return offset, span


def _part(
    model: OutputModel,
    table: Variables,
    offset: Float[np.ndarray, " dims"],
    span: Float[np.ndarray, " dims"],
) -> _Part:
    """A model's tree in these scheduling variables, z' = (x - offset)/span.

    A gate's argument is s (d . z - b), with d of length one and z = (span z' + offset -
    own offset)/own span; its direction is brought to length one again.
    """
    leaves = np.flatnonzero(np.asarray(model.active))
    if not isinstance(model.validity, SigmoidTree):
        nothing = np.zeros(0)
        none = np.zeros((0, len(table)))
        return _Part(none, nothing, nothing, np.zeros((1, 0), np.int32), leaves)
    at, tree = _places(model.scheduling, table), model.validity
    unit = tree.unit(np) / np.asarray(model.span)[None]
    border = np.asarray(tree.border) - unit @ (offset[at] - np.asarray(model.offset))
    direction = np.zeros((len(unit), len(table)))
    direction[:, at] = unit * span[at][None]
    size = np.linalg.norm(direction, axis=1)
    size = np.where(size > 0, size, 1.0)  # a gate that is open to a share everywhere
    steep = np.asarray(tree.log_steepness) + np.log(size)
    path = np.asarray(tree.path)[leaves]
    return _Part(direction / size[:, None], border / size, steep, path, leaves)


def _above(parts: Sequence[_Part], share: Float[np.ndarray, " parts"]) -> SigmoidTree:
    """The trees of the parts behind gates that give each its share: the first gate
    opens to the first part and else to the next gate."""
    count, dims = len(parts), parts[0].direction.shape[1]
    rest = share[:-1] / np.cumsum(share[::-1])[::-1][:-1]
    gates = [count - 1, *(len(part.border) for part in parts)]
    edges = np.cumsum(gates).tolist()
    path = np.zeros((sum(len(p.leaves) for p in parts), edges[-1]), np.int32)
    row = 0
    for n, (part, (start, end)) in enumerate(
        zip(parts, itertools.pairwise(edges), strict=True)
    ):
        own = path[row : row + len(part.leaves)]
        own[:, : min(n, count - 1)] = -1
        own[:, n : min(n + 1, count - 1)] = 1
        own[:, start:end] = part.path
        row += len(part.leaves)
    direction = [np.zeros((count - 1, dims)), *(part.direction for part in parts)]
    border = [np.log((1 - rest) / rest), *(part.border for part in parts)]
    steep = [np.zeros(count - 1), *(part.log_steepness for part in parts)]
    fields = (*(np.concatenate(f) for f in (direction, border, steep)), path)
    return SigmoidTree(*jax.device_put(fields))


def _terms(
    networks: Sequence[Network], parts: Sequence[_Part], variables: Variables
) -> tuple[Int[np.ndarray, "terms degree"], Float[np.ndarray, "models terms"]]:
    """All terms, and the coefficients of all leaves over them."""
    found: dict[tuple[int, ...], int] = {}
    tables = []
    for network in networks:
        place = np.array([0, *(n + 1 for n in _places(network.variables, variables))])
        rows = np.sort(place[np.asarray(network.models[0].local.factor)], axis=1)
        named = [tuple(r[r > 0].tolist()) for r in rows]
        tables.append([found.setdefault(row, len(found)) for row in named])
    degree = max(1, *map(len, found))
    factor = np.array([(0,) * (degree - len(row)) + row for row in found], np.int32)
    blocks = []
    for network, part, at in zip(networks, parts, tables, strict=True):
        dense = np.asarray(network.models[0].local.dense())[part.leaves]
        block = np.zeros((len(found), len(dense)))
        np.add.at(block, at, dense.T)
        blocks.append(block.T)
    return factor, np.concatenate(blocks)
