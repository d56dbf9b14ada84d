"""Datasets brought into the order of a model's channels, by name."""

import dataclasses

import numpy as np

from jaxnarx.checks import known_name
from jaxnarx.data.channels import Channel, Channels
from jaxnarx.data.dataset import Dataset
from jaxnarx.data.record import Record
from jaxnarx.errors import SpecError

_DIMENSIONLESS = {"1", "-"}


def match_channels(data: Dataset, channels: Channels) -> tuple[Dataset, list[str]]:
    """`data` with the inputs and outputs of `channels`, and the names left over.

    Channels are matched by name wherever they stand, so an output of the data may serve
    as an input. A channel that is missing, or has another unit where both are stated,
    is a SpecError; surplus channels are dropped and their names returned. A unit stated
    on one side only is accepted. Hidden channels are in no data and asked of none.
    """
    channels, own = channels.measured, data.channels
    extra = [name for name in own.names if name not in channels.names]
    if channels == own:
        return data, extra
    for channel in channels.all:
        _require(channel, own)
    inputs = [own.signal(name) for name in channels.input_names]
    outputs = [own.signal(name) for name in channels.output_names]
    matched = Channels(
        tuple(_stated(c, own) for c in channels.inputs),
        tuple(_stated(c, own) for c in channels.outputs),
    )
    records = tuple(_pick(record, inputs, outputs) for record in data)
    return Dataset(records, matched, data.sample_time), extra


def _require(channel: Channel, own: Channels):
    known_name(
        channel.name,
        own.names,
        channel.name,
        f"the data have no channel {channel.name!r}, which the model needs",
    )
    unit = own.all[own.signal(channel.name)].unit
    if unit and channel.unit and not same_unit(unit, channel.unit):
        raise SpecError(
            f"{channel.name} is in {unit!r} in the data, but the model has it in "
            f"{channel.unit!r}. Convert the data first.",
            field=channel.name,
        )


def same_unit(a: str, b: str) -> bool:
    """Whether two stated units are the same text; "1" and "-" are dimensionless."""
    a, b = a.strip(" []()"), b.strip(" []()")
    return a == b or {a, b} <= _DIMENSIONLESS


def _stated(channel: Channel, own: Channels) -> Channel:
    return channel if channel.unit else own.all[own.signal(channel.name)]


def _pick(record: Record, inputs: list[int], outputs: list[int]) -> Record:
    signals = record.signals
    return dataclasses.replace(
        record,
        u=np.ascontiguousarray(signals[:, inputs]),
        y=np.ascontiguousarray(signals[:, outputs]),
        valid=record.valid[:, inputs + outputs],
    )
