"""Datasets brought into the order of a model's channels, by name."""

import dataclasses

import numpy as np

from jaxnarx.checks import require_known
from jaxnarx.data.channels import Channel, Channels
from jaxnarx.data.dataset import Dataset
from jaxnarx.data.record import Record
from jaxnarx.data.units import Conversion, conversion
from jaxnarx.errors import SpecError


def match_channels(data: Dataset, channels: Channels) -> tuple[Dataset, list[str]]:
    """`data` with the inputs and outputs of `channels`, and the names left over.

    Channels are matched by name wherever they stand, so an output of the data may serve
    as an input. Where both sides state a unit the data are converted to that of
    `channels`, which `notes` of the result tell; a channel that is missing, or whose
    unit cannot be converted, is a SpecError. Surplus channels are dropped and their
    names returned. A unit stated on one side only is accepted. Hidden channels are in
    no data and asked of none.
    """
    channels, own = channels.measured, data.channels
    extra = [name for name in own.names if name not in channels.names]
    if channels == own:
        return data, extra
    how = [_conversion(channel, own) for channel in channels.all]
    inputs = [own.signal(name) for name in channels.input_names]
    outputs = [own.signal(name) for name in channels.output_names]
    matched = Channels(
        tuple(_fill_unit(c, own) for c in channels.inputs),
        tuple(_fill_unit(c, own) for c in channels.outputs),
    )
    records = tuple(_pick(record, inputs, outputs, how) for record in data)
    told = tuple(
        f"{c.name} converted from {_unit(c, own)} to {c.unit}, {one}"
        for c, one in zip(channels.all, how, strict=True)
        if one != (1.0, 0.0)
    )
    return Dataset(records, matched, data.sample_time, data.notes + told), extra


def convert_units(data: Dataset, channels: Channels) -> Dataset:
    """All of `data`, those of its channels that `channels` name too in their units.

    Where a unit cannot be converted it stays.
    """
    wanted = {c.name: c.unit for c in channels.measured.all}

    def own(channel: Channel) -> Channel:
        unit = wanted.get(channel.name, "")
        if unit and channel.unit and conversion(channel.unit, unit) is not None:
            return Channel(channel.name, unit)
        return channel

    new = Channels(
        *(tuple(map(own, c)) for c in (data.channels.inputs, data.channels.outputs))
    )
    return match_channels(data, new)[0]


def _conversion(channel: Channel, own: Channels) -> Conversion:
    """The conversion from the data's unit of a channel to the model's."""
    require_known(
        channel.name,
        own.names,
        channel.name,
        f"the data have no channel {channel.name!r}, which the model needs",
    )
    unit = _unit(channel, own)
    if not unit or not channel.unit:
        return Conversion(1.0, 0.0)
    found = conversion(unit, channel.unit)
    if found is None:
        raise SpecError(
            f"{channel.name} is in {unit!r} in the data, but the model has it in "
            f"{channel.unit!r}. Convert the data first.",
            field=channel.name,
        )
    return found


def _unit(channel: Channel, own: Channels) -> str:
    return own.all[own.signal(channel.name)].unit


def _fill_unit(channel: Channel, own: Channels) -> Channel:
    return channel if channel.unit else own.all[own.signal(channel.name)]


def _pick(
    record: Record, inputs: list[int], outputs: list[int], how: list[Conversion]
) -> Record:
    signals = record.signals
    for s, convert in zip(inputs + outputs, how, strict=True):
        signals[:, s] = convert(signals[:, s])
    return dataclasses.replace(
        record,
        u=np.ascontiguousarray(signals[:, inputs]),
        y=np.ascontiguousarray(signals[:, outputs]),
        valid=record.valid[:, inputs + outputs],
    )
