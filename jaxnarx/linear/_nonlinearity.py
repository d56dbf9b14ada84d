"""Is what the linear response leaves noise, or is the system not linear?

Coherence alone cannot tell: it is below one where there is noise, where the system is
nonlinear, where an input is missing, and where segments are too short (leakage). So the
spectrum that the response leaves is held against the spectrum of the noise alone,
which is known in one of three ways:

    a number        standard deviation of white noise [unit of the output], from a data
                    sheet, say
    a dataset       records at constant inputs, where the output moves by noise only
    "repeats"       the records repeat the same inputs; their outputs then differ by
                    noise only. The mean over P repetitions carries 1/P of the noise and
                    all of the nonlinearity

The first two see the noise of another occasion; the third is the strongest. Noise that
depends on the operating point, or a disturbance repeated with the inputs, is taken for
nonlinearity by all three.

Reference: R. Pintelon and J. Schoukens, System Identification: A Frequency Domain
Approach, 2nd ed. 2012, chapter 4.
"""

import dataclasses
from collections.abc import Sequence
from typing import Literal

import numpy as np
import scipy.special
from jaxtyping import Bool, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import not_negative
from jaxnarx.data import Channel, Dataset, match_channels
from jaxnarx.errors import DataError, SpecError
from jaxnarx.formatting import page
from jaxnarx.linear._spectra import (
    OVERLAP_SHARE,
    WINDOW_NAME,
    Spectra,
    default_segment,
    independent,
    segment_transforms,
    spectra,
)
from jaxnarx.linear.orders import output_place

LEAKAGE_SHARE = 0.01
"""Share of the output's spectrum that is excused as leakage."""


@dataclasses.dataclass(frozen=True, eq=False)
class NonlinearityCheck:
    """The spectrum of what the linear response leaves, beside that of the noise, one-
    sided [output^2/Hz].

    `exceeds` marks frequencies at which it is above the noise by more than chance (at
    `level`, shared among all frequencies) and more than leakage is excused. `share` is
    the excess summed over frequency, of the output's power in the same band.
    """

    frequency: Float[np.ndarray, " points"]
    residual: Float[np.ndarray, " points"]
    noise: Float[np.ndarray, " points"]
    exceeds: Bool[np.ndarray, " points"]
    share: float
    coherence: Float[np.ndarray, " points"]
    expected_coherence: Float[np.ndarray, " points"]
    output: Channel
    way: str

    @property
    def nonlinear(self) -> bool:
        """Whether any frequency exceeds."""
        return bool(self.exceeds.any())

    def __str__(self) -> str:
        """One sentence: the verdict, and against which noise."""
        against = f"noise from {self.way}"
        if not self.nonlinear:
            return f"{self.output.name}: nothing beyond a linear response and {against}"
        band = self.frequency[self.exceeds]
        return (
            f"{self.output.name}: {100 * self.share:.2g} % of its power is neither a "
            f"linear response nor {against}, at {len(band)} of {len(self.frequency)} "
            f"frequencies from {band.min():.3g} to {band.max():.3g} Hz"
        )

    _repr_html_ = page


@guard_arguments
def nonlinearity(
    data: Dataset,
    *,
    noise: float | int | Dataset | Literal["repeats"],
    inputs: Sequence[str] | None = None,
    output: str | None = None,
    segment: int | None = None,
    leakage: float | int = LEAKAGE_SHARE,
    level: float = 0.05,
) -> NonlinearityCheck:
    """Hold the spectrum that the linear response leaves against that of the noise.

    `noise` says how the latter is known, see the module; `leakage` is the share of the
    output's spectrum that is excused. Other options as in `spectra`. Records of
    `noise="repeats"` must have equal inputs and length (`DataError` if not).
    """
    segment = default_segment(data) if segment is None else segment
    options = {"inputs": inputs, "output": output, "segment": segment}
    if isinstance(noise, str):
        if noise != "repeats":
            raise SpecError(
                f"noise must be a number, a dataset or 'repeats', got {noise!r}",
                field="noise",
            )
        return _compare_with_repeats(data, options, leakage, level)
    found = spectra(data, **options)
    if isinstance(noise, Dataset):
        floor, freedom = _noise_spectrum(noise, data, output, segment)
        return _check(
            found, floor, freedom, leakage, level, "records at constant input"
        )
    not_negative(noise, "noise")
    floor = np.full(len(found.frequency), 2 * data.sample_time * float(noise) ** 2)
    return _check(found, floor, np.inf, leakage, level, "a stated level")


def _check(
    found: Spectra, floor, freedom: float, leakage, level, way: str
) -> NonlinearityCheck:
    own = 2 * max(found.averages - len(found.inputs), 1.0)
    tail = level / len(found.frequency)
    if np.isinf(freedom):
        limit = scipy.special.chdtri(own, tail) / own
    else:
        # The upper quantile of F from the beta distribution, exact for small tails.
        share = scipy.special.betaincinv(0.5 * freedom, 0.5 * own, tail)
        limit = freedom * (1 - share) / (own * share)
    excused = leakage * found.output_spectrum
    exceeds = found.residual_spectrum > limit * floor + excused
    excess = np.where(exceeds, found.residual_spectrum - floor, 0.0)
    total = found.output_spectrum
    expected = np.clip(1 - floor / np.where(total > 0, total, 1.0), 0.0, 1.0)
    return NonlinearityCheck(
        found.frequency,
        found.residual_spectrum,
        floor,
        exceeds,
        float(excess.sum() / total.sum()) if total.sum() > 0 else 0.0,
        found.coherence,
        expected,
        found.output,
        way,
    )


def _noise_spectrum(noise: Dataset, data: Dataset, output: str | None, segment: int):
    """Spectrum of the output in records without motion, and its degrees of freedom."""
    noise, _ = match_channels(noise, data.channels)
    step = segment - int(round(segment * OVERLAP_SHARE))
    place = output_place(noise, output)
    x, taper = segment_transforms(noise, (), place, segment, step, WINDOW_NAME)
    density = np.mean(np.abs(x[:, :, -1]) ** 2, axis=0)
    density *= 2 * data.sample_time / float(np.sum(taper**2))
    return density, 2 * independent(len(x), taper, step)


def _compare_with_repeats(data: Dataset, options, leakage, level) -> NonlinearityCheck:
    """Against the scatter of repeated records, all on their mean."""
    first, count = data.records[0], len(data)
    if count < 2:
        raise DataError("noise='repeats' needs at least two records")
    for record in data:
        same = len(record) == len(first) and np.array_equal(record.u, first.u)
        if not same or not record.valid.all():
            raise DataError(
                f"noise='repeats' needs records of equal inputs without gaps; "
                f"{record.name!r} differs from {first.name!r}"
            )
    y = np.stack([r.y for r in data])
    mean = dataclasses.replace(first, y=y.mean(axis=0))
    found = spectra(dataclasses.replace(data, records=(mean,)), **options)
    scatter = tuple(dataclasses.replace(r, y=r.y - mean.y) for r in data.records)
    segment = options["segment"]
    floor, freedom = _noise_spectrum(
        dataclasses.replace(data, records=scatter), data, options["output"], segment
    )
    # The scatter about the mean is short of one repetition; the mean has 1/P of it.
    share = (count - 1) / count
    return _check(
        found,
        floor / share / count,
        freedom * share,
        leakage,
        level,
        f"{count} repeated records",
    )
