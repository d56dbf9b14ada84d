"""Another sample time: by a whole factor, or any."""

import dataclasses

import numpy as np

from jaxnarx.data.check_samples import signals
from jaxnarx.data.dataset import Dataset, Record
from jaxnarx.data.preparation.grid import on_grid
from jaxnarx.data.preparation.samples import mapped, rebuilt, require_valid
from jaxnarx.data.preparation.step import AbstractFitted, AbstractStep, cannot_undo
from jaxnarx.data.sampling import positive_sample_time
from jaxnarx.errors import SpecError


@dataclasses.dataclass(frozen=True, kw_only=True)
class Resample(AbstractStep, AbstractFitted):
    """All channels at another `sample_time` [s], from each record's first sample on.

    Longer steps come with an anti-aliasing filter, shorter ones with interpolation;
    see `grid.on_grid` for both and for what becomes of masked samples. Inputs that
    move in steps ring where they are filtered, by a tenth of the step at most.
    """

    sample_time: float | int

    def __post_init__(self):
        positive_sample_time(self.sample_time)

    def fit(self, data: Dataset) -> "Resample":
        """This step."""
        return self

    def apply(self, data: Dataset) -> Dataset:
        """Every record at the new sample time; its rows are no rows of its source."""
        return at_sample_time(data, float(self.sample_time))

    def undo(self, data: Dataset) -> Dataset:
        """Refused: filtering and interpolation both lose something."""
        raise cannot_undo(
            "Resample", "use Resample with the old sample time to come near to it"
        )

    def describe(self) -> str:
        """The new sample time [s]."""
        return f"resampled to {self.sample_time:g} s, anti-aliased where it is longer"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Decimate(AbstractStep, AbstractFitted):
    """Every `factor`-th sample after an anti-aliasing filter without phase.

    The filter and the rule for masked samples are those of `grid.on_grid`. A record
    with fewer than 10 samples left is a DataError.
    """

    factor: int

    def __post_init__(self):
        if self.factor < 2:
            raise SpecError(
                f"factor must be a whole number from 2 on, got {self.factor}",
                field="factor",
            )

    def fit(self, data: Dataset) -> "Decimate":
        """This step."""
        return self

    def apply(self, data: Dataset) -> Dataset:
        """Every record at `factor` times the sample time."""
        return at_sample_time(data, self.factor * data.sample_time)

    def undo(self, data: Dataset) -> Dataset:
        """Refused: high frequencies are gone."""
        raise cannot_undo("Decimate", "the samples between are lost")

    def describe(self) -> str:
        """The factor."""
        return f"one of {self.factor} samples kept, after an anti-aliasing filter"


def at_sample_time(data: Dataset, sample_time: float) -> Dataset:
    """Every record on a grid of `sample_time` [s]."""

    def one(record: Record) -> Record:
        require_valid(record, data.channels)
        t = np.arange(len(record)) * data.sample_time
        x, valid = on_grid(
            t, signals(record), record.valid, step=sample_time, name=record.name
        )
        return rebuilt(record, x, valid, data.channels)

    return mapped(data, one, sample_time=sample_time)
