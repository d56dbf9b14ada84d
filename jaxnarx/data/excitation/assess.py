"""What the inputs of a data set excite: ranges, cells and frequencies, as one value."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxnarx.data.dataset import Dataset
from jaxnarx.data.excitation.coverage import Coverage, coverage
from jaxnarx.data.excitation.require import Number, Pair, span
from jaxnarx.data.excitation.spectrum import Spectrum, bandwidth, spectrum
from jaxnarx.errors import DataError, SpecError, suggest


@dataclasses.dataclass(frozen=True, eq=False)
class Assessment:
    """Operating space, its coverage, and the spectra of the inputs.

    `low` and `high` in the units of the inputs; `bandwidth` in Hz, the frequency below
    which `share` of an input's power lies.
    """

    labels: tuple[str, ...]
    low: Float[np.ndarray, " inputs"]
    high: Float[np.ndarray, " inputs"]
    coverage: Coverage
    spectrum: Spectrum
    bandwidth: Float[np.ndarray, " inputs"]
    share: float

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, lists and names, ready for JSON; without the spectra."""
        return {
            "labels": list(self.labels),
            "low": self.low.tolist(),
            "high": self.high.tolist(),
            "coverage": self.coverage.to_dict(),
            "bandwidth": self.bandwidth.tolist(),
            "share": self.share,
        }

    def __str__(self) -> str:
        width = max(len(label) for label in self.labels)
        lines = [
            f"{label:<{width}}  {low:g} to {high:g}, {self.share:.0%} of the power "
            f"below {hertz:.3g} Hz"
            for label, low, high, hertz in zip(
                self.labels, self.low, self.high, self.bandwidth, strict=True
            )
        ]
        return "\n".join([*lines, str(self.coverage)])


def assess(
    data: Dataset,
    *,
    ranges: Mapping[str, Pair] | None = None,
    bins: int = 10,
    share: Number = 0.95,
) -> Assessment:
    """Coverage and spectra of the inputs of `data`, all records together.

    `ranges` gives the operating space by input name as (low, high) in its unit; an
    input it does not name has the range of its valid samples (a constant one half a
    unit to both sides). Only samples at which all inputs are valid count as visited;
    spectra take the held values of the others.
    """
    names = data.channels.input_names
    if not names:
        raise DataError("the data set has no inputs, so there is no excitation")
    points = visited(data)
    if not len(points):
        raise DataError("the data set has no sample at which all inputs are valid")
    low, high = operating_space(points, names, ranges or {})
    power = spectrum([r.u for r in data], data.sample_time)
    return Assessment(
        labels=tuple(c.label for c in data.channels.inputs),
        low=low,
        high=high,
        coverage=coverage(points, low, high, bins=bins, names=names),
        spectrum=power,
        bandwidth=bandwidth(power, share),
        share=float(share),
    )


def visited(data: Dataset) -> Float[np.ndarray, "samples inputs"]:
    """Rows of the inputs of all records, where all of them are valid."""
    inputs = len(data.channels.inputs)
    rows = [r.u[np.all(r.valid[:, :inputs], axis=1)] for r in data]
    return np.concatenate(rows).astype(float)


def operating_space(
    points: Float[np.ndarray, "samples inputs"],
    names: list[str],
    ranges: Mapping[str, Pair],
) -> tuple[Float[np.ndarray, " inputs"], Float[np.ndarray, " inputs"]]:
    """The given ranges, where there are none those of the points."""
    for name in ranges:
        if name not in names:
            raise SpecError(
                f"ranges names {name!r}, which is no input. {suggest(name, names)}",
                field="ranges",
            )
    low, high = points.min(axis=0), points.max(axis=0)
    for i, name in enumerate(names):
        if name in ranges:
            low[i], high[i] = span(ranges[name], "ranges")
    same = low == high
    return np.where(same, low - 0.5, low), np.where(same, high + 0.5, high)
