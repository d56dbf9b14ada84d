"""Samples in time from samples at crank angles, and back."""

import dataclasses
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from jaxnarx.checks import positive
from jaxnarx.data.dataset import Dataset
from jaxnarx.data.preparation.resample import interpolate_on_grid
from jaxnarx.data.preparation.step import (
    AbstractLossy,
    AbstractStep,
    bridge_gaps,
    map_records,
    rebuilt,
    require_valid,
    valid_samples,
)
from jaxnarx.data.record import Record
from jaxnarx.data.sampling import positive_sample_time
from jaxnarx.errors import DataError, SpecError

_RPM_UNITS = {"", "rpm", "1/min", "r/min", "rev/min", "min-1", "min^-1", "u/min"}


@dataclasses.dataclass(frozen=True, kw_only=True)
class ToTime(AbstractStep, AbstractLossy):
    """Samples every `degrees` of crank angle, brought to every `sample_time` seconds.

    At the speed N [rpm] of the channel `speed` an event of D degrees lasts D / (6 N)
    seconds; from one sample to the next the mean of both durations passes. Records that
    ran faster become shorter. Filter, interpolation and masks as in
    `resample.interpolate_on_grid`. Speed must be positive: put this step before offset
    removal and scaling.
    """

    irreversible: ClassVar[str] = (
        "ToTime cannot be undone: use ToCrankAngle to come near to it"
    )
    speed: str
    degrees: float | int
    sample_time: float | int

    def __post_init__(self):
        positive(self.degrees, "degrees", "crank angle")
        positive_sample_time(self.sample_time)

    def fit(self, data: Dataset) -> "ToTime":
        """This step, its channel checked."""
        _speed_signal(data, self.speed)
        return self

    def apply(self, data: Dataset) -> Dataset:
        """Every record over time."""
        j, step = _speed_signal(data, self.speed), float(self.sample_time)

        def one(record: Record) -> Record:
            t = event_times(_speed(record, data, j), float(self.degrees))
            return _resample_record(record, data, t, step)

        return map_records(data, one, sample_time=step)

    def describe(self) -> str:
        """Degrees, speed channel and sample time [s]."""
        return (
            f"from every {self.degrees:g} degrees of crank angle (by {self.speed}) to "
            f"every {self.sample_time:g} s"
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class ToCrankAngle(AbstractStep):
    """Samples in time, brought to every `degrees` of crank angle.

    The angle is the integral of 6 N [degrees per s] by the trapezoidal rule, with N
    [rpm] from the channel `speed`. Fitting fixes the nominal sample time, an event at
    the mean speed of the training data, which all records then state.
    """

    speed: str
    degrees: float | int

    def __post_init__(self):
        positive(self.degrees, "degrees", "crank angle")

    def fit(self, data: Dataset) -> "AtCrankAngle":
        """The nominal sample time, from valid samples of speed."""
        j = _speed_signal(data, self.speed)
        for record in data:
            _speed(record, data, j)
        nominal = float(self.degrees / (6 * valid_samples(data, j).mean()))
        return AtCrankAngle(
            speed=self.speed,
            degrees=self.degrees,
            sample_time=float(f"{nominal:.6g}"),
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class AtCrankAngle(AbstractLossy):
    """`ToCrankAngle` with the nominal `sample_time` [s] of an event."""

    irreversible: ClassVar[str] = (
        "ToCrankAngle cannot be undone: use ToTime to come near to it"
    )
    speed: str
    degrees: float | int
    sample_time: float | int

    def __post_init__(self):
        positive(self.degrees, "degrees", "crank angle")
        positive_sample_time(self.sample_time)

    def apply(self, data: Dataset) -> Dataset:
        """Every record over crank angle."""
        j, step = _speed_signal(data, self.speed), float(self.degrees)

        def one(record: Record) -> Record:
            angle = crank_angles(_speed(record, data, j), data.sample_time)
            return _resample_record(record, data, angle, step)

        return map_records(data, one, sample_time=float(self.sample_time))

    def describe(self) -> str:
        """Degrees, speed channel and nominal sample time [s]."""
        return (
            f"from time to every {self.degrees:g} degrees of crank angle (by "
            f"{self.speed}), nominally {self.sample_time:g} s"
        )


def event_times(
    speed: Float[np.ndarray, " time"], degrees: float
) -> Float[np.ndarray, " time"]:
    """Times [s] of samples every `degrees`, from 0, at `speed` [rpm]."""
    duration = degrees / (6.0 * speed)
    return np.concatenate([[0.0], np.cumsum(0.5 * (duration[:-1] + duration[1:]))])


def crank_angles(
    speed: Float[np.ndarray, " time"], sample_time: float
) -> Float[np.ndarray, " time"]:
    """Crank angles [degrees] of samples every `sample_time` [s], from 0."""
    turned = 6.0 * sample_time * speed
    return np.concatenate([[0.0], np.cumsum(0.5 * (turned[:-1] + turned[1:]))])


def _resample_record(record: Record, data: Dataset, at, step: float) -> Record:
    x, valid = interpolate_on_grid(
        at, record.signals, record.valid, step=step, name=record.name
    )
    return rebuilt(record, x, valid, data.channels)


def _speed_signal(data: Dataset, name: str) -> int:
    j = data.channels.signal(name)
    unit = data.channels.all[j].unit
    if unit.strip(" []()").lower() not in _RPM_UNITS:
        raise SpecError(
            f"{name} is in {unit!r}; crank angle needs an engine speed in rpm, before "
            "any scaling",
            field="speed",
        )
    return j


def _speed(record: Record, data: Dataset, j: int) -> Float[np.ndarray, " time"]:
    """Speed of the record, bridged over masked samples; DataError unless positive."""
    require_valid(record, data.channels)
    x, name = record.signals[:, j : j + 1], data.channels.names[j]
    bad = np.flatnonzero((x[:, 0] <= 0) & record.valid[:, j])
    if bad.size:
        row, value = int(bad[0]) + record.start_row, float(x[bad[0], 0])
        raise DataError(
            f"{record.name}: {name} is {value:g} in row {row}, and {bad.size} time(s) "
            "not above zero; crank angle stands still there. Cut the record where the "
            "engine turns, or do this step before offset removal and scaling.",
            channel=name,
            row=row,
        )
    return bridge_gaps(x, record.valid[:, j : j + 1])[:, 0]
