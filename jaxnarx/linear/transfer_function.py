"""A transfer function in z: poles, zeros, gain, step and frequency response."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from jaxnarx.data import Channel
from jaxnarx.errors import SpecError
from jaxnarx.formatting import page

ZERO_DENOMINATOR_SHARE = 1e-12
"""A denominator below this share of its coefficients' sum counts as zero at z = 1."""


class Bode(NamedTuple):
    """Frequency response: frequency [Hz], magnitude (a ratio of units), phase [deg].

    The phase is continuous from the lowest frequency on.
    """

    frequency: Float[np.ndarray, " points"]
    magnitude: Float[np.ndarray, " points"]
    phase: Float[np.ndarray, " points"]


@dataclasses.dataclass(frozen=True, eq=False)
class TransferFunction:
    """G(z) = sum_k numerator_k z^-k / sum_k denominator_k z^-k, as in (4.45).

    The delay stands as leading zeros of the numerator; the denominator begins with one.
    Gains are in units of the output per unit of the input, times in s. `input` is None
    for the noise, which has the unit of the output.
    """

    numerator: Float[np.ndarray, " _"]
    denominator: Float[np.ndarray, " _"]
    sample_time: float
    input: Channel | None
    output: Channel

    def __post_init__(self):
        if not len(self.denominator) or self.denominator[0] != 1:
            raise SpecError(
                "the denominator must begin with 1; divide both polynomials by its "
                "first coefficient",
                field="denominator",
            )

    @property
    def delay(self) -> int:
        """Samples until an input shows; the length of a numerator of zeros."""
        found = np.flatnonzero(self.numerator)
        return int(found[0]) if len(found) else len(self.numerator)

    @property
    def poles(self) -> Complex[np.ndarray, " poles"]:
        """Roots of the denominator, slowest first; those of a pure delay left out."""
        return _sort_roots(np.roots(np.trim_zeros(self.denominator, "b")))

    @property
    def zeros(self) -> Complex[np.ndarray, " zeros"]:
        """Roots of the numerator without its delay, largest first."""
        return _sort_roots(np.roots(np.trim_zeros(self.numerator)))

    @property
    def stable(self) -> bool:
        """Whether every pole lies inside the unit circle."""
        return bool(np.all(np.abs(self.poles) < 1))

    @property
    def dc_gain(self) -> float:
        """The value at which a unit step settles, G(1); infinite with a pole at one.

        For an unstable function this is G(1) too, but nothing settles there.
        """
        top, bottom = float(self.numerator.sum()), float(self.denominator.sum())
        if abs(bottom) <= ZERO_DENOMINATOR_SHARE * float(
            np.abs(self.denominator).sum()
        ):
            return float(np.copysign(np.inf, top))
        return top / bottom

    @property
    def natural_frequency(self) -> Float[np.ndarray, " poles"]:
        """|ln p| / T of every pole p [rad/s]."""
        return np.abs(self._continuous())

    @property
    def damping(self) -> Float[np.ndarray, " poles"]:
        """-cos arg(ln p) of every pole; 1 at and beyond the aperiodic limit.

        Negative outside the unit circle, zero on it; a pole at one has 1.
        """
        s, size = self._continuous(), self.natural_frequency
        return np.where(size > 0, -np.real(s) / np.where(size > 0, size, 1.0), 1.0)

    @property
    def time_constants(self) -> Float[np.ndarray, " poles"]:
        """Time in which every pole decays to 1/e, -T / ln |p| [s]; infinite from
        modulus one on.
        """
        rate = -np.real(self._continuous())
        return np.where(rate > 0, 1.0 / np.where(rate > 0, rate, 1.0), np.inf)

    def _continuous(self) -> Complex[np.ndarray, " poles"]:
        return np.log(self.poles.astype(complex)) / self.sample_time

    def frequency_response(
        self, frequency: Float[np.ndarray, " points"]
    ) -> Complex[np.ndarray, " points"]:
        """G at exp(2 pi i f T), f in Hz."""
        back = np.exp(-2j * np.pi * np.asarray(frequency) * self.sample_time)
        top = np.polyval(self.numerator[::-1], back)
        return top / np.polyval(self.denominator[::-1], back)

    def bode(self, frequency: Float[np.ndarray, " points"] | None = None) -> Bode:
        """Magnitude and phase; by default at 400 frequencies over three decades up to
        the Nyquist frequency, from lower on where a pole is slower.
        """
        if frequency is None:
            top = 0.5 / self.sample_time
            slow = self.natural_frequency[self.natural_frequency > 0] / (2 * np.pi)
            low = min([top / 1000, *(slow / 10)])
            frequency = np.geomspace(low, top, 400)
        g = self.frequency_response(frequency)
        phase = np.degrees(np.unwrap(np.angle(g)))
        return Bode(np.asarray(frequency), np.abs(g), phase)

    def impulse_response(self, length: int) -> Float[np.ndarray, " time"]:
        """Response to one sample of one, at samples 0 to length - 1."""
        return self._response(np.arange(length) == 0)

    def step_response(
        self, length: int | None = None
    ) -> tuple[Float[np.ndarray, " time"], Float[np.ndarray, " time"]]:
        """Time [s] and response to a unit step at time zero.

        By default until five of the longest time constants are over, at most 10,000
        samples, and 200 of an unstable function.
        """
        if length is None:
            length = self._settling_samples()
        time = np.arange(length) * self.sample_time
        return time, self._response(np.ones(length))

    def _settling_samples(self) -> int:
        longest = float(self.time_constants.max(initial=0.0)) / self.sample_time
        if not np.isfinite(longest):
            return 200
        return int(min(len(self.numerator) + 10 + np.ceil(5 * longest), 10_000))

    def _response(self, u: np.ndarray) -> np.ndarray:
        import scipy.signal

        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(
                scipy.signal.lfilter(self.numerator, self.denominator, u.astype(float))
            )

    def __str__(self) -> str:
        """`(41 z^-6 + 15.7 z^-7) / (1 - 0.43 z^-1)`."""
        top, bottom = _text(self.numerator), _text(self.denominator)
        return f"({top}) / ({bottom})"

    _repr_html_ = page


def _sort_roots(roots: np.ndarray) -> Complex[np.ndarray, " roots"]:
    """Largest modulus first, pairs together."""
    roots = np.asarray(roots, complex)
    size = np.round(np.abs(roots), 12)
    return roots[np.lexsort((np.imag(roots), np.real(roots), -size))]


def _text(polynomial: np.ndarray) -> str:
    parts = []
    for power, value in enumerate(polynomial.tolist()):
        if value == 0:
            continue
        sign = "-" if value < 0 else "+"
        z = f" z^-{power}" if power else ""
        parts.append(f"{sign} {abs(value):.4g}{z}")
    if not parts:
        return "0"
    first = parts[0].removeprefix("+ ").replace("- ", "-")
    return " ".join([first, *parts[1:]])
