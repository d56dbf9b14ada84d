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

from jaxnarx.checks import whole
from jaxnarx.errors import SpecError

Orders = int | Sequence[int] | Mapping[str, int]
"""One number for all inputs, one for each in order, or by input name."""


class _Linear:
    """What every class checks of the fields it has."""

    def __post_init__(self):
        least = {"na": 0, "nb": 1, "nc": 0, "nd": 0, "nf": 0, "nk": 0, "max_steps": 0}
        for field, smallest in least.items():
            orders = getattr(self, field, smallest)
            if isinstance(orders, Mapping):
                orders = list(orders.values())
            for value in orders if isinstance(orders, Sequence) else [orders]:
                whole(value, field, smallest)
        tolerance = getattr(self, "tolerance", 0)
        if not 0 <= tolerance < 1:
            raise SpecError(
                f"tolerance must lie in [0, 1), got {tolerance}", field="tolerance"
            )


@dataclasses.dataclass(frozen=True)
class FIR(_Linear):
    """Finite impulse response, y = B u + e: (2.1). Linear least squares."""

    nb: Orders = 10
    """Coefficients of B."""
    nk: Orders = 1
    """Delay [samples]; 0 lets the input act at once."""
    constant: bool = True
    """Estimate the constant term."""


@dataclasses.dataclass(frozen=True)
class ARX(_Linear):
    """Autoregression with inputs, A y = B u + e. Linear least squares."""

    na: int = 2
    """Order of A."""
    nb: Orders = 2
    """Coefficients of B."""
    nk: Orders = 1
    """Delay [samples]; 0 lets the input act at once."""
    constant: bool = True
    """Estimate the constant term."""


@dataclasses.dataclass(frozen=True)
class ARMAX(_Linear):
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


@dataclasses.dataclass(frozen=True)
class OutputError(_Linear):
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


@dataclasses.dataclass(frozen=True)
class BoxJenkins(_Linear):
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


@dataclasses.dataclass(frozen=True)
class GeneralLinear(_Linear):
    """All polynomials together, A y = B/F u + C/D e: (2.3). Prediction error.

    Dynamics that input and noise share are in A, the others apart in F and D. Orders
    that are zero leave a polynomial out; all other classes are such cases.
    """

    na: int = 1
    """Order of A."""
    nb: Orders = 2
    """Coefficients of B."""
    nc: int = 1
    """Order of C."""
    nd: int = 1
    """Order of D."""
    nf: Orders = 1
    """Order of F."""
    nk: Orders = 1
    """Delay [samples]; 0 lets the input act at once."""
    constant: bool = True
    """Estimate the constant term."""
    max_steps: int = 100
    """Accepted steps of the search."""
    tolerance: float | int = 1e-9
    """The search ends when a step lowers the loss by less than this share."""


LinearMethod = FIR | ARX | ARMAX | OutputError | BoxJenkins | GeneralLinear
"""What `fit_linear` takes."""
