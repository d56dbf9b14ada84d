"""Several datasets as one."""

import dataclasses
from collections.abc import Sequence

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.data.align_channels import match_channels
from jaxnarx.data.dataset import Dataset
from jaxnarx.errors import SpecError

SAMPLE_TIME_TOLERANCE = 1e-6
"""Sample times may differ by this share."""


@guard_arguments
def join(datasets: Sequence[Dataset]) -> Dataset:
    """The records of several datasets behind one another, with the first's channels.

    Channels are matched by name and converted to the first's units; what only others
    have is left out, which `notes` tell. Records keep their groups; a record's name
    that is there already gets a number behind it.

    Raises:
        SpecError: where there is none, or one lacks a channel of the first, has a unit
            that cannot be converted, or another sample time.

    Example:
        both = jnx.data.join([data[:1], data[1:]])
    """
    if not datasets:
        raise SpecError("join: no datasets are given", field="datasets")
    first, *others = datasets
    records, notes = list(first.records), list(first.notes)
    taken = set(first.names)
    for number, other in enumerate(others, 2):
        if (
            abs(other.sample_time - first.sample_time)
            > SAMPLE_TIME_TOLERANCE * first.sample_time
        ):
            raise SpecError(
                f"dataset {number} has a sample time of {other.sample_time:g} s, "
                f"the first of {first.sample_time:g} s. Resample one of them first.",
                field="sample_time",
            )
        matched, surplus = match_channels(other, first.channels)
        notes += matched.notes
        if surplus:
            notes.append(f"dataset {number}: left out {', '.join(surplus)}")
        for record in matched:
            name = _new(record.name, taken)
            taken.add(name)
            records.append(dataclasses.replace(record, name=name))
    return dataclasses.replace(first, records=tuple(records), notes=tuple(notes))


def _new(name: str, taken: set[str]) -> str:
    number, found = 1, name
    while found in taken:
        number += 1
        found = f"{name} ({number})"
    return found
