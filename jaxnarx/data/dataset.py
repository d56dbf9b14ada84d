"""Measurements as values: several records of different lengths with named channels."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, overload

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.data.channels import Channel, Channels, make_channels
from jaxnarx.data.construct import array_sources
from jaxnarx.data.frames import frame_sources
from jaxnarx.data.missing import assemble, require_missing
from jaxnarx.data.overview import overview
from jaxnarx.data.record import Record
from jaxnarx.data.sampling import positive_sample_time
from jaxnarx.formatting import brief, page


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Dataset:
    """Records that share channels and sample time [s]. Immutable; host memory only.

    `notes` tell what reading has done to the samples, such as bringing channels to one
    raster.
    """

    records: tuple[Record, ...]
    channels: Channels
    sample_time: float
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        return overview(
            self.records, self.channels, float(self.sample_time), self.notes
        )

    __repr__, _repr_html_ = brief, page

    def __len__(self) -> int:
        return len(self.records)

    def __iter__(self) -> Iterator[Record]:
        return iter(self.records)

    @overload
    def __getitem__(self, index: int) -> "Dataset": ...
    @overload
    def __getitem__(self, index: slice) -> "Dataset": ...
    @overload
    def __getitem__(self, index: Sequence[int]) -> "Dataset": ...
    def __getitem__(self, index) -> "Dataset":
        """A dataset of the chosen records: `data[3]`, `data[:20]`, `data[[0, 5]]`."""
        if isinstance(index, slice):
            chosen = self.records[index]
        elif isinstance(index, Sequence):
            chosen = tuple(self.records[i] for i in index)
        else:
            chosen = (self.records[index],)
        return dataclasses.replace(self, records=chosen)

    @property
    def samples(self) -> int:
        """Number of rows over all records."""
        return sum(len(r) for r in self.records)

    @property
    def names(self) -> list[str]:
        """Names of the records."""
        return [r.name for r in self.records]

    @classmethod
    @guard_arguments
    def from_arrays(
        cls,
        u: Any,
        y: Any,
        *,
        inputs: str | Channel | Sequence[str | Channel],
        outputs: str | Channel | Sequence[str | Channel],
        sample_time: float | int,
        units: Mapping[str, str] | None = None,
        names: str | Sequence[str] | None = None,
        missing: str = "refuse",
    ) -> "Dataset":
        """Records from (time, channels) arrays in physical units.

        One-dimensional arrays stand for a single channel; integers and booleans become
        float64, float32 stays if every channel has it. A channel without any finite
        sample in a record, or with magnitudes whose squares overflow, is always a
        DataError.

        Args:
            u: Inputs, an array or a list of arrays, one per record; None with no
                `inputs` is a free series.
            y: Outputs, likewise.
            inputs: Names or channels of `u`.
            outputs: Names or channels of `y`.
            sample_time: Time from one sample to the next [s].
            units: Units by channel name.
            names: Names of the records (default "record 1", ...).
            missing: Treatment of NaN and inf: "refuse" raises DataError, "mask" holds
                the previous sample (the next at the beginning) and marks it invalid,
                "split" begins a new record after every gap, "interpolate" joins
                neighbours by a line and masks the ends.

        Returns:
            The dataset, with one or more records.

        Example:
            u, y = [r.u for r in data], [r.y for r in data]
            again = jnx.Dataset.from_arrays(
                u, y, inputs=["a", "b"], outputs=["y", "w"], sample_time=0.1
            )
            print(again.names)
        """
        require_missing(missing)
        channels = make_channels(inputs, outputs, units)
        sources = array_sources(u, y, channels, names)
        step = positive_sample_time(sample_time)
        return cls(assemble(sources, channels, step, missing), channels, step)

    @classmethod
    @guard_arguments
    def from_frame(
        cls,
        frame: Any,
        *,
        inputs: str | Channel | Sequence[str | Channel],
        outputs: str | Channel | Sequence[str | Channel],
        sample_time: float | int | None = None,
        time: str | None = None,
        time_unit: str | None = None,
        units: Mapping[str, str] | None = None,
        missing: str = "refuse",
        record: str | None = None,
    ) -> "Dataset":
        """Records from the columns of a pandas, polars or pyarrow table.

        The sample time [s] is stated as `sample_time` or taken from the column `time`
        (numbers, dates or durations), which must increase in uniform steps; given
        both, the column is checked against the number. `time_unit` is the unit of
        numbers ("s", "ms", "us", "min" or "h"); without it the column's name is asked
        ("t_ms", "time [s]"), and numbers that look like ms are refused. `record` names
        a column whose value changes from one record to the next. `missing` and `units`
        as in `from_arrays`; with `missing="split"` a jump in time begins a new record
        too.
        Columns that are not named are ignored; text columns are refused.
        """
        require_missing(missing)
        channels = make_channels(inputs, outputs, units)
        sources, step = frame_sources(
            frame,
            channels,
            sample_time=sample_time,
            time=time,
            time_unit=time_unit,
            split=missing == "split",
            record=record,
        )
        return cls(assemble(sources, channels, step, missing), channels, step)
