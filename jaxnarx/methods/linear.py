"""Settings of linear models: which polynomials there are, and of what order.

All are special cases of

    A(q) y(t) = sum_i B_i(q)/F_i(q) u_i(t - nk_i) + constant + C(q)/D(q) e(t)

(2.3), with A = 1 + a_1 q^-1 + ... + a_na q^-na, likewise C, D and F_i, and B_i =
b_0 + b_1 q^-1 + ... of `nb` coefficients. Orders of inputs are one number for all of
them, a sequence in the order of the channels, or a mapping by name; a mapping that
leaves an input out leaves it out of the model. `constant` estimates the constant term,
so that an operating point need not be subtracted from the data; without it the data
are taken as deviations from zero.

Reference: L. Ljung, System Identification: Theory for the User, 2nd ed. 1999, chapter
4.2.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from numbers import Integral

from jaxnarx.errors import SpecError

Orders = int | Sequence[int] | Mapping[str, int]
"""One number for all inputs, one for each in order, or by input name."""


def _whole(value: object, field: str, least: int) -> None:
    if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
        raise SpecError(
            f"{field} must be a whole number of at least {least}, got {value!r}",
            field=field,
        )


def _check(method: object, fields: Sequence[str], least: int) -> None:
    for field in fields:
        orders = getattr(method, field)
        if isinstance(orders, Mapping):
            values = list(orders.values())
        else:
            values = list(orders) if isinstance(orders, Sequence) else [orders]
        for value in values:
            _whole(value, field, least)


def _check_search(steps: int, tolerance: float | int) -> None:
    _whole(steps, "max_steps", 0)
    if not 0 <= tolerance < 1:
        raise SpecError(
            f"tolerance must lie in [0, 1), got {tolerance}", field="tolerance"
        )


@dataclasses.dataclass(frozen=True)
class FIR:
    """Finite impulse response, y = B u + e: (2.1). Linear least squares."""

    nb: Orders = 10
    """Coefficients of B."""
    nk: Orders = 1
    """Delay [samples]; 0 lets the input act at once."""
    constant: bool = True
    """Estimate the constant term."""

    def __post_init__(self):
        _check(self, ("nb",), 1)
        _check(self, ("nk",), 0)


@dataclasses.dataclass(frozen=True)
class ARX:
    """Autoregression with inputs, A y = B u + e. Linear least squares."""

    na: int = 2
    """Order of A."""
    nb: Orders = 2
    """Coefficients of B."""
    nk: Orders = 1
    """Delay [samples]; 0 lets the input act at once."""
    constant: bool = True
    """Estimate the constant term."""

    def __post_init__(self):
        _whole(self.na, "na", 0)
        _check(self, ("nb",), 1)
        _check(self, ("nk",), 0)


@dataclasses.dataclass(frozen=True)
class ARMAX:
    """ARX with a moving average of the noise, A y = B u + C e. Prediction error."""

    na: int = 2
    """Order of A."""
    nb: Orders = 2
    """Coefficients of B."""
    nc: int = 1
    """Order of C."""
    nk: Orders = 1
    """Delay [samples]; 0 lets the input act at once."""
    constant: bool = True
    """Estimate the constant term."""
    max_steps: int = 100
    """Accepted steps of the search."""
    tolerance: float | int = 1e-9
    """The search ends when a step lowers the loss by less than this share."""

    def __post_init__(self):
        _whole(self.na, "na", 0)
        _whole(self.nc, "nc", 0)
        _check(self, ("nb",), 1)
        _check(self, ("nk",), 0)
        _check_search(self.max_steps, self.tolerance)


@dataclasses.dataclass(frozen=True)
class OutputError:
    """Noise on the output only, y = B/F u + e. Prediction error."""

    nb: Orders = 2
    """Coefficients of B."""
    nf: Orders = 2
    """Order of F."""
    nk: Orders = 1
    """Delay [samples]; 0 lets the input act at once."""
    constant: bool = True
    """Estimate the constant term."""
    max_steps: int = 100
    """Accepted steps of the search."""
    tolerance: float | int = 1e-9
    """The search ends when a step lowers the loss by less than this share."""

    def __post_init__(self):
        _check(self, ("nb",), 1)
        _check(self, ("nk", "nf"), 0)
        _check_search(self.max_steps, self.tolerance)


@dataclasses.dataclass(frozen=True)
class BoxJenkins:
    """Dynamics and noise apart, y = B/F u + C/D e. Prediction error."""

    nb: Orders = 2
    """Coefficients of B."""
    nc: int = 1
    """Order of C."""
    nd: int = 1
    """Order of D."""
    nf: Orders = 2
    """Order of F."""
    nk: Orders = 1
    """Delay [samples]; 0 lets the input act at once."""
    constant: bool = True
    """Estimate the constant term."""
    max_steps: int = 100
    """Accepted steps of the search."""
    tolerance: float | int = 1e-9
    """The search ends when a step lowers the loss by less than this share."""

    def __post_init__(self):
        _whole(self.nc, "nc", 0)
        _whole(self.nd, "nd", 0)
        _check(self, ("nb",), 1)
        _check(self, ("nk", "nf"), 0)
        _check_search(self.max_steps, self.tolerance)


LinearMethod = FIR | ARX | ARMAX | OutputError | BoxJenkins
"""What `fit_linear` takes."""
