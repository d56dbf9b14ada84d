"""The form of every step of preparation, and how it reaches the samples of its records.

Settings (`Scale(kind="min-max")`) hold wishes; `fit` looks at the training data and
returns a fitted step (`Scaled`) that holds every number it needs. Where there is
nothing to look at (`LowPass`), the settings are the fitted step. Fitted steps are
frozen, compare by value and survive as JSON.
"""

import abc
import dataclasses
from collections.abc import Callable, Iterable, Mapping
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.checks import require
from jaxnarx.data.channels import Channel, Channels
from jaxnarx.data.dataset import Dataset
from jaxnarx.data.missing import hold
from jaxnarx.data.record import Record
from jaxnarx.errors import DataError, SpecError


class AbstractFitted(abc.ABC):
    """A step that knows all its numbers; frozen dataclass of plain Python values.

    A channel is addressed by name, so that data with fewer channels than the training
    data can be prepared too. Samples that are not valid have no influence on others.
    """

    @abc.abstractmethod
    def apply(self, data: Dataset) -> Dataset:
        """`data` after this step."""

    @abc.abstractmethod
    def undo(self, data: Dataset) -> Dataset:
        """`data` before this step; SpecError where that cannot be found out."""

    @abc.abstractmethod
    def describe(self) -> str:
        """Describe the step in one line or more, with numbers and units."""

    def to_dict(self) -> dict[str, Any]:
        """Plain types for JSON; `kind` is the name of the class."""
        fields = dataclasses.fields(self)  # type: ignore[arg-type]
        return {"kind": type(self).__name__} | {
            f.name: _to_json(getattr(self, f.name)) for f in fields
        }


class AbstractLossy(AbstractFitted):
    """A step that loses something, so that it cannot be undone."""

    irreversible: ClassVar[str]
    """Reason why it cannot be undone, or what comes near to it."""

    def undo(self, data: Dataset) -> Dataset:
        """Raise `SpecError` with the reason."""
        raise SpecError(self.irreversible, field="undo")


class AbstractStep(abc.ABC):
    """Settings of a step, frozen dataclass; every option by keyword."""

    @abc.abstractmethod
    def fit(self, data: Dataset) -> AbstractFitted:
        """The step with its numbers, from the valid samples of training data."""


def _to_json(value: Any) -> Any:
    if isinstance(value, tuple):
        return list(value)
    return dict(value) if hasattr(value, "items") else value


def choose_channels(channels: Channels, names: Iterable[str] | None) -> list[int]:
    """Indices of the named channels, all for None; an unknown name is a SpecError."""
    if names is None:
        return list(range(len(channels.all)))
    return [channels.signal(name) for name in names]


def present(channels: Channels, names: Iterable[str] | None) -> list[int]:
    """Indices of those of the named channels that are there, all for None."""
    wanted = channels.names if names is None else set(names)
    return [j for j, name in enumerate(channels.names) if name in wanted]


def valid_samples(data: Dataset, j: int) -> Float[np.ndarray, " samples"]:
    """All valid samples of signal `j`; DataError where there is none."""
    parts = [r.signal(j)[r.valid[:, j]] for r in data]
    values = np.concatenate([np.zeros(0), *parts]).astype(np.float64)
    if not values.size:
        name = data.channels.names[j]
        raise DataError(
            f"{name} has no valid sample in any of {len(data)} record(s), so nothing "
            "can be fitted to it. Leave out the channel.",
            channel=name,
        )
    return values


def bridge_gaps(
    x: Float[np.ndarray, "time signals"], valid: Bool[np.ndarray, "time signals"]
) -> Float[np.ndarray, "time signals"]:
    """`x` in float64 with straight lines over masked samples, held at both ends.

    Unlike holding, this is the same forwards and backwards in time, as a filter without
    phase should be. Every column needs a valid sample.
    """
    out, rows = x.astype(np.float64), np.arange(len(x))
    for j in np.flatnonzero(~valid.all(axis=0)):
        known = np.flatnonzero(valid[:, j])
        out[:, j] = np.interp(rows, known, out[known, j])
    return out


def require_valid(record: Record, channels: Channels) -> None:
    """DataError unless each channel of the record has a valid sample."""
    _require_any(record.valid, record.name, channels, "")


def _require_any(valid, name: str, channels: Channels, after: str) -> None:
    empty = np.flatnonzero(~valid.any(axis=0))
    if empty.size:
        names = ", ".join(channels.names[j] for j in empty)
        raise DataError(
            f"{name}: {names} has no valid sample{after} ({len(valid)} rows, all "
            "masked). Leave out the channel or the record.",
            channel=channels.names[int(empty[0])],
        )


def rebuilt(
    record: Record,
    x: Float[np.ndarray, "_ signals"],
    valid: Bool[np.ndarray, "_ signals"],
    channels: Channels,
    *,
    start_row: int = 0,
) -> Record:
    """The record with other samples; masked ones are held as `missing="mask"` does.

    The number type stays. `start_row` is the source's row where rows still are rows of
    the source. A channel left without a valid sample is a DataError, a record of which
    only a part is scored a SpecError.
    """
    _require_any(valid, record.name, channels, " left")
    require(
        record.scored is None,
        "data",
        f"only a part of {record.name} is scored: prepare records before they are "
        "divided into groups, not after",
    )
    held = hold(x, valid).astype(record.y.dtype)
    n = record.u.shape[1]
    return dataclasses.replace(
        record, u=held[:, :n], y=held[:, n:], valid=valid, start_row=start_row
    )


def map_records(
    data: Dataset,
    change: Callable[[Record], Record],
    *,
    channels: Channels | None = None,
    sample_time: float | None = None,
) -> Dataset:
    """The dataset with every record changed, and channels or sample time with them."""
    return Dataset(
        tuple(change(r) for r in data),
        data.channels if channels is None else channels,
        data.sample_time if sample_time is None else sample_time,
    )


def map_same_rows(
    data: Dataset,
    change: Callable[[Record], tuple[np.ndarray, np.ndarray]],
    *,
    channels: Channels | None = None,
) -> Dataset:
    """The dataset with the samples and validity that `change` gives for each record."""
    schema = data.channels if channels is None else channels

    def one(record: Record) -> Record:
        x, valid = change(record)
        return rebuilt(record, x, valid, schema, start_row=record.start_row)

    return map_records(data, one, channels=schema)


def with_units(channels: Channels, units: Mapping[str, str]) -> Channels:
    """The same channels; those that `units` names get another unit."""

    def one(c: Channel) -> Channel:
        return Channel(c.name, units.get(c.name, c.unit))

    return Channels(tuple(map(one, channels.inputs)), tuple(map(one, channels.outputs)))


def units_by_name(channels: Channels, indices: Iterable[int]) -> dict[str, str]:
    """Units by name."""
    return {channels.all[j].name: channels.all[j].unit for j in indices}


def list_channels(names: Iterable[str] | None) -> str:
    """The named channels, for a description."""
    return "all channels" if names is None else ", ".join(names)


def number(value: float, unit: str = "") -> str:
    """`"12.5 rpm"`; a dimensionless number stands alone."""
    return f"{value:.6g} {'' if unit in ('1', '-') else unit}".strip()
