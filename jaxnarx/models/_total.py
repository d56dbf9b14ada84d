"""A weighted sum of networks as one network."""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from jaxnarx.data import Channel, Channels
from jaxnarx.errors import SpecError
from jaxnarx.models._assemble import local_models, output_model
from jaxnarx.models._combine_outputs import hidden_names, move_terms, shift_hidden
from jaxnarx.models.network import Network, OutputModel
from jaxnarx.models.signed_root import SignedRoot
from jaxnarx.models.validity import AdditiveGates, GateProducts, SigmoidTree
from jaxnarx.regressors import Variables

COMMON_FIELDS = "sample_time hold outside nan invalid_after".split()
"""Fields that networks which are added have in common ..."""
COMMON_RANGES = "lower upper low high".split()
"""... and their ranges and bounds, in physical units."""
RANGE_TOLERANCE = 1e-9
"""Share of a range by which these may differ."""


def total(networks: Sequence[Network], weights: Sequence[float]) -> Network:
    """The sum of networks of one output, times weights that are brought to sum one.

    Gates that are open to the same share everywhere stand above the gates of the parts.
    Of trees the result is a tree; with additive gates among them it is a table of
    products of gates (`GateProducts`). Local models of a part that is fed back the
    output are a group that is fed back its own, and so are those that compute a root
    of the output. Hidden channels are numbered through.

    A free run is the sum of the parts' free runs, begun after the longest of their
    histories, as long as none meets its bounds. Where there are hidden channels they
    begin with what fits the measured outputs best as the sum computes these.

    `SpecError` where no network is that sum: several outputs, channels or limits that
    differ, feedback of local models' own, other validity functions, scheduling on the
    output, hidden channels or additive gates that look at the output.
    """
    for network in networks:
        _require_fit(network, networks[0])
    share = np.asarray(weights, float)
    if len(share) != len(networks) or np.any(share <= 0):
        raise SpecError("a sum has a positive weight for every part", field="weights")
    if len(networks) == 1:
        return networks[0]
    first, gain = networks[0], _common_gain(networks)
    networks = [_rescale(network, gain) for network in networks]
    measured = len(first.channels.measured.all)
    ends = np.cumsum([0, *(network.hidden for network in networks)]).tolist()
    moves = list(zip(networks, ends, strict=False))
    tables = [shift_hidden(n.variables, measured, by) for n, by in moves]
    zones = [shift_hidden(n.models[0].scheduling, measured, by) for n, by in moves]
    variables, scheduling = _all(tables), _all(zones)
    models = [network.models[0] for network in networks]
    offset, span = _scales(models, zones, scheduling)
    parts = [
        _part(model, zone, scheduling, offset, span)
        for model, zone in zip(models, zones, strict=True)
    ]
    factor, theta = _terms(networks, tables, parts, variables)
    whole_only = all(model.validity.sums_to_one for model in models)
    kind = SigmoidTree if whole_only else GateProducts
    model = output_model(
        local_models(factor, theta, sparse=True),
        _above(parts, share / share.sum(), kind),
        scheduling,
        offset,
        span,
    )
    model = _with_groups(model, networks, parts)
    entries = list(variables.entries)
    hidden = [
        move_terms(model, table, entries, measured, by)
        for (network, by), table in zip(moves, tables, strict=True)
        for model in network.models[1:]
    ]
    return _assemble_sum(networks, variables, (model, *hidden))


def _assemble_sum(
    networks: Sequence[Network], variables: Variables, models: tuple[OutputModel, ...]
) -> Network:
    """The first network with these models, and the hidden channels of all."""
    first, known = networks[0], networks[0].channels.measured
    count = len(known.all)

    def join(name: str, size: int) -> np.ndarray:
        behind = [np.asarray(getattr(network, name))[size:] for network in networks]
        return np.concatenate([np.asarray(getattr(first, name))[:size], *behind])

    fields = {name: join(name, count) for name in ("gain", "low", "high")}
    fields |= {name: join(name, 1) for name in ("lower", "upper")}
    names = hidden_names(known, sum(network.hidden for network in networks))
    channels = Channels(known.inputs, known.outputs, tuple(map(Channel, names)))
    bare = dict(domain=None, certificate=None, errors=None)
    return dataclasses.replace(
        first,
        channels=channels,
        variables=variables,
        models=models,
        window=max(network.window for network in networks),
        **jax.device_put(fields),
        **bare,
    )


class _Part(NamedTuple):
    """A part's gates over the scheduling variables of all, the sides of them that its
    local models lie behind, and which local models these are."""

    direction: Float[np.ndarray, "gates dims"]
    border: Float[np.ndarray, " gates"]
    log_steepness: Float[np.ndarray, " gates"]
    path: Int[np.ndarray, "leaves gates"]
    leaves: Int[np.ndarray, " leaves"]


def _require_fit(network: Network, first: Network) -> None:
    known = network.channels.measured == first.channels.measured
    several = len(network.modelled) > 1 or network.modelled != first.modelled
    same = [_equal(getattr(network, f), getattr(first, f)) for f in COMMON_FIELDS]
    if several or not known or not all(same) or not _has_ranges_of(network, first):
        raise SpecError(
            "networks that are added have one output and the same channels, sample "
            "time and limits",
            field="networks",
        )
    model, output = network.models[0], network.signals[0]
    if any(m.own is not None and not _computes_root(m) for m in network.models):
        raise SpecError(
            "networks that are added have local models that are fed back the network's "
            "output",
            field="networks",
        )
    alone = int(np.asarray(model.active).sum()) == 1
    if not alone and not isinstance(model.validity, SigmoidTree | AdditiveGates):
        raise SpecError(
            f"networks that are added are trees of gates, or have gates that add up, "
            f"not {type(model.validity).__name__}",
            field="networks",
        )
    if any(s == output for m in network.models for s, _ in m.scheduling):
        raise SpecError(
            f"{network.output_names[0]} schedules itself; in a sum that would be the "
            "output of all parts",
            field="networks",
        )
    looks = any(s == output for s, _ in network.variables)
    if looks and (network.hidden or not model.validity.sums_to_one):
        raise SpecError(
            f"hidden channels, or gates that add up, look at "
            f"{network.output_names[0]}; in a sum that would be the output of all "
            "parts",
            field="networks",
        )


def _computes_root(model: OutputModel) -> bool:
    """Whether all local models are one group, which computes a root."""
    if model.own is None or model.root is None or len(model.own) != 1:
        return False
    return bool(np.all(np.asarray(model.own)[0] | ~np.asarray(model.active)))


def _equal(a, b) -> bool:
    return a is b or (a is not None and b is not None and np.array_equal(a, b))


def _has_ranges_of(network: Network, first: Network) -> bool:
    """Whether ranges of all measured channels and bounds of the output are the same, in
    physical units."""
    known, output = len(first.channels.measured.all), first.signals[0]
    size = [np.asarray(n.gain)[output] for n in (network, first)]
    least, most = (np.asarray(a)[:known] for a in (first.low, first.high))
    for name in COMMON_RANGES:
        one, other = (np.asarray(getattr(n, name)) for n in (network, first))
        if name in ("lower", "upper"):
            one, other = one[:1] * size[0], other[:1] * size[1]
            room = (most - least)[output]
        else:
            one, other, room = one[:known], other[:known], most - least
        room = RANGE_TOLERANCE * np.maximum(room, np.abs(other))
        if one.shape != other.shape or np.any(np.abs(one - other) > room):
            return False
    return True


def _common_gain(networks: Sequence[Network]) -> Float[np.ndarray, " measured"]:
    """The gains of the measured channels: those of the first."""
    known = len(networks[0].channels.measured.all)
    return np.asarray(networks[0].gain)[:known]


def _rescale(network: Network, gain: Float[np.ndarray, " measured"]) -> Network:
    """The same network with other gains of its measured channels."""
    known = len(gain)
    old = np.asarray(network.gain)
    if np.array_equal(old[:known], gain):
        return network
    new = np.concatenate([gain, old[known:]])
    ratio = new / old
    own, variables = network.signals, network.variables
    models = []
    for s, model in zip(own, network.models, strict=True):
        by = np.concatenate([[1.0], ratio[list(variables.signal)]])
        size, root = ratio[s], model.root
        if root is not None:  # one group of all; its own lags are roots too
            squares = bool(np.asarray(root.squares)[0])
            floor = jax.device_put(np.asarray(root.floor) / ratio[s])
            size = np.sqrt(size) if squares else size
            by[1:][np.array(list(variables.signal)) == s] = size
            root = dataclasses.replace(root, floor=floor)
        local = model.local
        each = np.prod(by[np.asarray(local.factor)], axis=1) / size
        coefficient = np.asarray(local.coefficient) * each[np.asarray(local.index)]
        local = dataclasses.replace(local, coefficient=jax.device_put(coefficient))
        models.append(dataclasses.replace(model, local=local, root=root))
    scale = ratio[list(own)]
    bounds = {n: np.asarray(getattr(network, n)) / scale for n in ("lower", "upper")}
    fields = jax.device_put(bounds | {"gain": new})
    return dataclasses.replace(network, models=tuple(models), **fields)


def _all(tables: Sequence[Variables]) -> Variables:
    """Every variable of several tables, once."""
    entries = itertools.chain(*(table.entries for table in tables))
    return Variables.of(list(dict.fromkeys(entries)))


def _places(table: Variables, among: Variables) -> list[int]:
    return [among.entries.index(entry) for entry in table.entries]


def _scales(
    models: Sequence[OutputModel], zones: Sequence[Variables], table: Variables
):
    """Offset and span of the scheduling variables, by the first that has each."""
    offset, span = np.zeros(len(table)), np.ones(len(table))
    for model, zone in reversed(list(zip(models, zones, strict=True))):
        at = _places(zone, table)
        offset[at], span[at] = np.asarray(model.offset), np.asarray(model.span)
    return offset, span


def _part(
    model: OutputModel,
    zone: Variables,
    table: Variables,
    offset: Float[np.ndarray, " dims"],
    span: Float[np.ndarray, " dims"],
) -> _Part:
    """A model's gates in these scheduling variables, z' = (x - offset)/span.

    A gate's argument is s (d . z - b), with d of length one and z = (span z' + offset -
    own offset)/own span; its direction is brought to length one again.
    """
    leaves, gates = np.flatnonzero(np.asarray(model.active)), model.validity
    if isinstance(gates, SigmoidTree):
        unit, border = gates.unit(np), np.asarray(gates.border)
        steep, path = np.asarray(gates.log_steepness), np.asarray(gates.path)
    elif isinstance(gates, AdditiveGates):
        unit, border = np.asarray(gates.direction), np.asarray(gates.border)
        steep, path = np.zeros(len(border)), np.eye(len(border) + 1, dtype=np.int32)
        path = path[:, 1:]
    else:
        nothing = np.zeros(0)
        none = np.zeros((0, len(table)))
        return _Part(none, nothing, nothing, np.zeros((1, 0), np.int32), leaves)
    at = _places(zone, table)
    unit = unit / np.asarray(model.span)[None]
    border = border - unit @ (offset[at] - np.asarray(model.offset))
    direction = np.zeros((len(unit), len(table)))
    direction[:, at] = unit * span[at][None]
    size = np.linalg.norm(direction, axis=1)
    size = np.where(size > 0, size, 1.0)  # a gate that is open to a share everywhere
    steep = steep + np.log(size)
    return _Part(direction / size[:, None], border / size, steep, path[leaves], leaves)


def _above(
    parts: Sequence[_Part], share: Float[np.ndarray, " parts"], kind: type[SigmoidTree]
) -> SigmoidTree:
    """The gates of the parts behind gates that give each its share: the first gate
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
    return kind(*jax.device_put(fields))


def _terms(
    networks: Sequence[Network],
    tables: Sequence[Variables],
    parts: Sequence[_Part],
    variables: Variables,
) -> tuple[Int[np.ndarray, "terms degree"], Float[np.ndarray, "models terms"]]:
    """All terms, and the coefficients of all leaves over them."""
    found: dict[tuple[int, ...], int] = {}
    rows_of = []
    for network, own in zip(networks, tables, strict=True):
        place = np.array([0, *(n + 1 for n in _places(own, variables))])
        rows = np.sort(place[np.asarray(network.models[0].local.factor)], axis=1)
        named = [tuple(r[r > 0].tolist()) for r in rows]
        rows_of.append([found.setdefault(row, len(found)) for row in named])
    degree = max(1, *map(len, found))
    factor = np.array([(0,) * (degree - len(row)) + row for row in found], np.int32)
    blocks = []
    for network, part, at in zip(networks, parts, rows_of, strict=True):
        dense = np.asarray(network.models[0].local.dense())[part.leaves]
        block = np.zeros((len(found), len(dense)))
        np.add.at(block, at, dense.T)
        blocks.append(block.T)
    return factor, np.concatenate(blocks)


def _with_groups(
    model: OutputModel, networks: Sequence[Network], parts: Sequence[_Part]
) -> OutputModel:
    """Parts that are fed back the output, or compute a root of it, as groups."""
    edges = np.cumsum([0, *(len(part.leaves) for part in parts)]).tolist()
    own, squares, floor = [], [], []
    for network, (start, end) in zip(networks, itertools.pairwise(edges), strict=True):
        root = network.models[0].root
        looks = _looks_at_output(network)
        if root is None and not looks:
            continue
        own.append((np.arange(edges[-1]) >= start) & (np.arange(edges[-1]) < end))
        squares.append(False if root is None else bool(np.asarray(root.squares)[0]))
        floor.append(0.0 if root is None else float(np.asarray(root.floor)[0]))
    if not own:
        return model
    found = None
    if any(squares):
        dtype = np.asarray(networks[0].gain).dtype
        found = SignedRoot(*jax.device_put((np.array(squares), np.array(floor, dtype))))
    return dataclasses.replace(model, own=jax.device_put(np.stack(own)), root=found)


def _looks_at_output(network: Network) -> bool:
    """Whether a term of the output has the output's past in it."""
    return any(s == network.signals[0] for s, _ in network.variables)
