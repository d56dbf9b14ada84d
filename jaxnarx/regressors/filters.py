"""Fixed stable filters an input may pass before it becomes a lagged variable.

They give a model long memory without feedback of its outputs. All of them are functions
of one orthonormal cascade (Heuberger, Van den Hof, Bosgra 1995; Ninness and Gustafsson
1997, eq. 8). With discrete poles a_k = exp(p_k T), sample time T [s], the k-th function
is

    F_k(z) = sqrt(1 - a_k^2) z / (z - a_k) prod_(j<k) (1 - a_j z) / (z - a_j)

for real poles; a pair of complex poles contributes the two functions of Wahlberg (1994,
eq. 7). The factor z makes functions use u(t) at t, save the second of a complex pair,
which begins with u(t-1); lag 1 gives the strictly proper ones of the literature.

These are settings: hashable, without arrays. `jaxnarx.regressors.filtering` runs them.
"""

import abc
import dataclasses
import math
import numbers
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar

from jaxnarx.argument_checks import guard_arguments, guard_fields
from jaxnarx.checks import positive, require, whole
from jaxnarx.errors import SpecError

LARGEST_ORDER = 30
"""Functions a cascade may have; the state grows with them."""

SLOWEST_SAMPLES = 1e8
"""Time constant, in samples, beyond which a pole cannot be told from an integrator."""


class AbstractFilter(abc.ABC):
    """A filter as a function of the orthonormal cascade."""

    unit_gain: ClassVar[bool] = False
    """True where the static gain is one, False where the impulse response has norm
    one."""

    @property
    @abc.abstractmethod
    def sections(self) -> tuple[complex, ...]:
        """Poles [1/s] of the cascade up to this function; a complex one stands for
        itself and its conjugate."""

    @property
    @abc.abstractmethod
    def function(self) -> int:
        """Number of the function in the cascade, from 1."""

    @property
    def state(self) -> tuple[int, int]:
        """(section, 0 or 1) of the function: complex sections have two."""
        left = self.function
        for section, pole in enumerate(self.sections):
            width = 2 if pole.imag else 1
            if left <= width:
                return section, left - 1
            left -= width
        raise AssertionError("the cascade is too short")


def _settle(filter_: AbstractFilter, **checked: Any) -> None:
    """Put checked values into the frozen fields while they are being built."""
    for name, value in checked.items():
        object.__setattr__(filter_, name, value)


@dataclasses.dataclass(frozen=True)
class LowPass(AbstractFilter):
    """First-order lag, y(t) = a y(t-1) + (1 - a) u(t), a = exp(-T / time_constant).

    `time_constant` [s]: after a step the output has covered 63 % of its way in this
    time. The static gain is one; the unit stays that of the input. Causal, unlike the
    zero-phase filter `jaxnarx.data.LowPass` that prepares records.
    """

    time_constant: float | int
    unit_gain: ClassVar[bool] = True

    def __post_init__(self):
        _settle(self, time_constant=positive(self.time_constant, "time_constant"))

    @property
    def sections(self) -> tuple[complex, ...]:
        """One real pole."""
        return (complex(-1 / self.time_constant),)

    @property
    def function(self) -> int:
        """The first."""
        return 1


@dataclasses.dataclass(frozen=True)
class Laguerre(AbstractFilter):
    """Discrete Laguerre function number `order` (1, 2, ...), pole exp(-T /
    time_constant).

    The first is a first-order lag, each further one passes one more all-pass section,
    so that a bank of them acts as a tapped delay line with long delays. Wahlberg 1991,
    eq. 4. `time_constant` in s.
    """

    time_constant: float | int
    order: int

    def __post_init__(self):
        time_constant = positive(self.time_constant, "time_constant")
        _settle(
            self,
            time_constant=time_constant,
            order=whole(self.order, "order", most=LARGEST_ORDER),
        )

    @property
    def sections(self) -> tuple[complex, ...]:
        """The same real pole as often as the order says."""
        return (complex(-1 / self.time_constant),) * self.order

    @property
    def function(self) -> int:
        """The order."""
        return self.order


@dataclasses.dataclass(frozen=True)
class Kautz(AbstractFilter):
    """Discrete two-parameter Kautz function number `order`, for systems that swing.

    The conjugate poles have natural frequency `frequency` [rad/s] and `damping` ratio
    between 0 and 1: -damping frequency +- i frequency sqrt(1 - damping^2) in 1/s. Odd
    and even orders belong together. Wahlberg 1994, eq. 7.
    """

    frequency: float | int
    damping: float | int
    order: int

    def __post_init__(self):
        _settle(
            self,
            frequency=positive(self.frequency, "frequency"),
            damping=positive(self.damping, "damping", below=1.0),
            order=whole(self.order, "order", most=LARGEST_ORDER),
        )

    @property
    def sections(self) -> tuple[complex, ...]:
        """The same pair once for every two orders."""
        swing = math.sqrt((1 - self.damping) * (1 + self.damping))
        pole = self.frequency * complex(-self.damping, swing)
        return (pole,) * ((self.order + 1) // 2)

    @property
    def function(self) -> int:
        """The order."""
        return self.order


@guard_fields
@dataclasses.dataclass(frozen=True)
class Orthonormal(AbstractFilter):
    """Takenaka-Malmquist function number `order` of the cascade with given poles.

    `poles` in 1/s, real part negative; a complex one, given with positive imaginary
    part, stands for itself and its conjugate and makes two functions. After the last
    pole the first comes again. One real pole makes Laguerre functions, one complex pole
    Kautz functions. Heuberger, Van den Hof and Bosgra 1995; Ninness and Gustafsson
    1997.
    """

    poles: tuple[float | int | complex, ...]
    order: int

    def __post_init__(self):
        if not 1 <= len(self.poles) <= LARGEST_ORDER:
            raise SpecError(
                f"poles must be 1 to {LARGEST_ORDER} numbers, got {len(self.poles)}",
                field="poles",
            )
        poles = tuple(map(_pole, self.poles))
        _settle(self, poles=poles, order=whole(self.order, "order", most=LARGEST_ORDER))

    @property
    def sections(self) -> tuple[complex, ...]:
        """Sections with as many poles, in turn, as the order needs."""
        chosen: list[complex] = []
        count = 0
        while count < self.order:
            chosen.append(complex(self.poles[len(chosen) % len(self.poles)]))
            count += 2 if chosen[-1].imag else 1
        return tuple(chosen)

    @property
    def function(self) -> int:
        """The order."""
        return self.order


def _pole(value: object) -> complex:
    if isinstance(value, bool) or not isinstance(value, numbers.Complex):
        raise SpecError(f"a pole must be a number, got {value!r}", field="poles")
    pole = complex(value)
    if not (math.isfinite(pole.real) and math.isfinite(pole.imag)) or pole.real >= 0:
        raise SpecError(
            f"poles must be finite with a negative real part [1/s], got {value!r}",
            field="poles",
        )
    if pole.imag < 0:
        raise SpecError(
            f"a complex pole stands for itself and its conjugate: give the one with "
            f"positive imaginary part alone, not {value!r}",
            field="poles",
        )
    return pole


@guard_arguments
def low_pass_bank(time_constants: Iterable[float | int]) -> tuple[LowPass, ...]:
    """A first-order lag for each time constant [s]."""
    return tuple(LowPass(t) for t in time_constants)


@guard_arguments
def laguerre_bank(time_constant: float | int, orders: int) -> tuple[Laguerre, ...]:
    """Laguerre functions 1 to `orders` with one time constant [s]."""
    orders = whole(orders, "orders", 0, LARGEST_ORDER)
    return tuple(Laguerre(time_constant, k + 1) for k in range(orders))


@guard_arguments
def kautz_bank(
    frequency: float | int, damping: float | int, orders: int
) -> tuple[Kautz, ...]:
    """Kautz functions 1 to `orders` with one pair of poles [rad/s, damping ratio]."""
    orders = whole(orders, "orders", 0, LARGEST_ORDER)
    return tuple(Kautz(frequency, damping, k + 1) for k in range(orders))


@guard_arguments
def orthonormal_bank(
    poles: Sequence[float | int | complex], orders: int | None = None
) -> tuple[Orthonormal, ...]:
    """Functions 1 to `orders` of the cascade with these poles [1/s].

    Without `orders`, one per pole and two per complex one.
    """
    for pole in poles:
        require(
            isinstance(pole, numbers.Complex),
            "poles",
            f"poles must be numbers [1/s], got {pole!r}",
        )
    if orders is None:
        orders = sum(2 if complex(p).imag else 1 for p in poles)
    orders = whole(orders, "orders", 0, LARGEST_ORDER)
    return tuple(Orthonormal(tuple(poles), k + 1) for k in range(orders))


def require_filter(filter_: object, field: str = "filters") -> AbstractFilter:
    """`filter_` itself, or a `SpecError` if it is none."""
    if not isinstance(filter_, AbstractFilter):
        raise SpecError(
            "a filter must be a LowPass, Laguerre, Kautz or Orthonormal, got "
            f"{filter_!r}",
            field=field,
        )
    return filter_


def require_sampled(filters: Iterable[AbstractFilter | None], sample_time: float):
    """SpecError for a filter that a sample time [s] cannot represent.

    Oscillations must stay below half the sampling frequency, decays must show within
    1e8 samples.
    """
    for filter_ in filters:
        for pole in filter_.sections if filter_ is not None else ():
            if pole.imag * sample_time >= math.pi:
                raise SpecError(
                    f"{filter_} swings with {pole.imag:.6g} rad/s, which a sample time "
                    f"of {sample_time:g} s cannot show; stay below "
                    f"{math.pi / sample_time:.6g} rad/s",
                    field="filters",
                )
            if -pole.real * sample_time * SLOWEST_SAMPLES < 1:
                raise SpecError(
                    f"{filter_} decays over {-1 / pole.real:.6g} s, more than "
                    f"{SLOWEST_SAMPLES:g} samples of {sample_time:g} s; use a shorter "
                    "one",
                    field="filters",
                )


_FILTER_KINDS: dict[str, type[AbstractFilter]] = {
    "low_pass": LowPass,
    "laguerre": Laguerre,
    "kautz": Kautz,
    "orthonormal": Orthonormal,
}


def filter_to_dict(filter_: AbstractFilter) -> dict[str, Any]:
    """Plain values for JSON; complex poles as pairs of real and imaginary part."""
    (kind,) = (k for k, c in _FILTER_KINDS.items() if c is type(filter_))
    out: dict[str, Any] = {"kind": kind}
    out |= dataclasses.asdict(filter_)  # type: ignore[call-overload]
    if isinstance(filter_, Orthonormal):
        poles = map(complex, filter_.poles)
        out["poles"] = [[p.real, p.imag] for p in poles]
    return out


def filter_from_dict(values: dict[str, Any]) -> AbstractFilter:
    """The filter that `filter_to_dict` described; anything else is a `SpecError`."""
    if not isinstance(values, dict) or values.get("kind") not in _FILTER_KINDS:
        raise SpecError(
            f"a filter must be one of {', '.join(_FILTER_KINDS)}, got {values!r}",
            field="filters",
        )
    kind = _FILTER_KINDS[values["kind"]]
    settings = {k: v for k, v in values.items() if k != "kind"}
    known = {f.name for f in dataclasses.fields(kind)}  # type: ignore[arg-type]
    if set(settings) != known:
        raise SpecError(
            f"a filter {values['kind']} has {', '.join(sorted(known))}, got {values!r}",
            field="filters",
        )
    if "poles" in settings:
        settings["poles"] = tuple(map(_pole_from_pair, settings["poles"]))
    return kind(**settings)


def _pole_from_pair(pair: Any) -> complex:
    real, imaginary = pair
    return complex(_pole(real).real, imaginary)
