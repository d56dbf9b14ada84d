"""Partitions from outside: a network's, a validity function, or a function's."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxnarx.errors import SpecError, suggest
from jaxnarx.models import AbstractValidity, Network, OutputModel, count_models
from jaxnarx.partition.grid import fit_regions
from jaxnarx.partition.training_rows import TrainingRows
from jaxnarx.regressors import Pool, Variables, evaluate, variable_names
from jaxnarx.settings import PARTITIONS, Given, Partitioner


@dataclasses.dataclass(frozen=True, eq=False)
class Regions:
    """The regions in which the local models of one output are to be valid.

    `ranges` (dims, 2) are what 0 and 1 of the scheduling variables stand for, None
    where the data tell. A `Partitioner` stands for the validity functions that it will
    return; `count` is then zero.
    """

    scheduling: tuple[str, ...]
    ranges: np.ndarray | None
    validity: AbstractValidity | Partitioner
    count: int


def regions_of_method(pool: Pool, method: Given) -> list[Regions]:
    """The regions of every output of the pool."""
    names = [pool.channels.output_names[o] for o in pool.outputs]
    partition = method.partition
    if isinstance(partition, str):
        partition = PARTITIONS.find(partition, "partition")
    if isinstance(partition, Network):
        _refuse_scheduling(method)
        return [
            _regions_of_output(partition, _source(partition, n, method)) for n in names
        ]
    if not isinstance(partition, AbstractValidity | Partitioner):
        raise SpecError(
            "a partition is a Network, a validity function of jaxnarx.models, or a "
            "function of (scheduling, columns, output, weight) that returns one; got "
            f"{type(partition).__name__}",
            field="partition",
        )
    return [_regions_of_validity(partition, method)] * len(names)


def _refuse_scheduling(method: Given) -> None:
    if method.scheduling:
        raise SpecError(
            "a network has its scheduling variables; leave `scheduling` out",
            field="scheduling",
        )


def _source(network: Network, name: str, method: Given) -> int:
    """The output whose regions an output gets."""
    names = network.output_names
    wanted = method.output or (names[0] if len(names) == 1 else name)
    if wanted not in names:
        raise SpecError(
            f"the network whose partition is given has no output {wanted!r}; name one "
            f"with `output`. {suggest(wanted, names)}",
            field="output",
        )
    return names.index(wanted)


def _regions_of_output(network: Network, output: int) -> Regions:
    model: OutputModel = network.models[output]
    names = tuple(variable_names(network.channels, model.scheduling))
    if not names:
        raise SpecError(
            f"{network.output_names[output]} has one local model that is valid "
            "everywhere; there is no partition to take",
            field="partition",
        )
    low, span = np.asarray(model.offset), np.asarray(model.span)
    count = int(np.sum(np.asarray(model.active)))
    return Regions(names, np.stack([low, low + span], axis=1), model.validity, count)


def _regions_of_validity(
    validity: AbstractValidity | Partitioner, method: Given
) -> Regions:
    if not method.scheduling:
        raise SpecError(
            "a validity function, or a function that returns one, needs its "
            "scheduling variables, such as scheduling=['speed[t]', 'load[t]']",
            field="scheduling",
        )
    count = 0
    if isinstance(validity, AbstractValidity):
        count = _count_regions(validity, len(method.scheduling))
    ranges = np.array(method.ranges) if method.ranges else None
    return Regions(tuple(method.scheduling), ranges, validity, count)


def _count_regions(validity: AbstractValidity, dims: int) -> int:
    """The number of its regions."""
    try:
        return count_models(validity, dims)
    except ValueError as error:
        raise SpecError(str(error), field="partition") from error


def fit_given(
    training: TrainingRows, output: int, regions: Regions, method: Given
) -> tuple[OutputModel, list[int]]:
    """The model of one output, and which local models lack samples."""
    own, validity, count = place_regions(training, output, regions)
    return fit_regions(own, output, validity, count, method)


def place_regions(
    training: TrainingRows, output: int, regions: Regions
) -> tuple[TrainingRows, AbstractValidity, int]:
    """The rows of the regions, their validity functions, how many are in use."""
    own, validity = _select_scheduling(training, regions), regions.validity
    if isinstance(validity, AbstractValidity):
        return own, validity, regions.count
    p = evaluate(own.factors[output], own.rows.v)
    y, weight = own.rows.y[output], own.rows.weight[output]
    real = (np.asarray(a)[..., : own.rows.count] for a in (own.z, p, y, weight))
    found = ask_partition(validity, *real)
    return own, found, _count_regions(found, len(regions.scheduling))


def ask_partition(
    partition: Partitioner,
    scheduling: Float[np.ndarray, "dims rows"],
    columns: Float[np.ndarray, "terms rows"],
    output: Float[np.ndarray, " rows"],
    weight: Float[np.ndarray, " rows"],
) -> AbstractValidity:
    """The validity functions that a partitioner returns; else SpecError."""
    found = partition(scheduling, columns, output, weight)
    if not isinstance(found, AbstractValidity):
        raise SpecError(
            "a partition function returns a validity function of jaxnarx.models, got "
            f"{type(found).__name__}",
            field="partition",
        )
    _count_regions(found, len(scheduling))
    return jax.tree.map(jnp.asarray, found)


def _select_scheduling(training: TrainingRows, regions: Regions) -> TrainingRows:
    """The rows with these scheduling variables only, on the scale of the regions."""
    at = np.array([training.names.index(name) for name in regions.scheduling])
    low, span = training.offset[at], training.span[at]
    z = training.z[at]
    if regions.ranges is not None:
        x = low[:, None] + span[:, None] * z
        low, span = regions.ranges[:, 0], np.diff(regions.ranges, axis=1)[:, 0]
        low, span = low.astype(z.dtype), span.astype(z.dtype)
        z = (x - low[:, None]) / span[:, None]
    entries = training.scheduling.entries
    table = Variables.of([entries[n] for n in at])
    return dataclasses.replace(
        training, scheduling=table, offset=low, span=span, z=jnp.asarray(z)
    )
