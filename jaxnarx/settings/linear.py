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

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from jaxnarx.settings.fields import Rule, Share, Steps, settings


def _orders(least: int) -> Rule:
    """At least so much for every input."""

    def holds(orders: Any) -> bool:
        if isinstance(orders, Mapping):
            orders = tuple(orders.values())
        values = orders if isinstance(orders, Sequence) else (orders,)
        return all(value >= least for value in values)

    return Rule(f"be at least {least}", holds)


Orders = Annotated[int | Sequence[int] | Mapping[str, int], _orders(0)]
"""One number for all inputs, one for each in order, or by input name."""
Counts = Annotated[int | Sequence[int] | Mapping[str, int], _orders(1)]
"""The same of at least one."""


@settings
class FIR:
    """Finite impulse response, y = B u + e: (2.1). Linear least squares."""

    nb: Counts = 10
    """Coefficients of B."""
    nk: Orders = 1
    """Delay [samples]; 0 lets the input act at once."""
    constant: bool = True
    """Estimate the constant term."""


@settings
class ARX:
    """Autoregression with inputs, A y = B u + e. Linear least squares."""

    na: Steps = 2
    """Order of A."""
    nb: Counts = 2
    """Coefficients of B."""
    nk: Orders = 1
    """Delay [samples]; 0 lets the input act at once."""
    constant: bool = True
    """Estimate the constant term."""


@settings
class ARMAX:
    """ARX with a moving average of the noise, A y = B u + C e. Prediction error."""

    na: Steps = 2
    """Order of A."""
    nb: Counts = 2
    """Coefficients of B."""
    nc: Steps = 1
    """Order of C."""
    nk: Orders = 1
    """Delay [samples]; 0 lets the input act at once."""
    constant: bool = True
    """Estimate the constant term."""
    max_steps: Steps = 100
    """Accepted steps of the search."""
    tolerance: Share = 1e-9
    """The search ends when a step lowers the loss by less than this share."""


@settings
class OutputError:
    """Noise on the output only, y = B/F u + e. Prediction error."""

    nb: Counts = 2
    """Coefficients of B."""
    nf: Orders = 2
    """Order of F."""
    nk: Orders = 1
    """Delay [samples]; 0 lets the input act at once."""
    constant: bool = True
    """Estimate the constant term."""
    max_steps: Steps = 100
    """Accepted steps of the search."""
    tolerance: Share = 1e-9
    """The search ends when a step lowers the loss by less than this share."""


@settings
class BoxJenkins:
    """Dynamics and noise apart, y = B/F u + C/D e. Prediction error."""

    nb: Counts = 2
    """Coefficients of B."""
    nc: Steps = 1
    """Order of C."""
    nd: Steps = 1
    """Order of D."""
    nf: Orders = 2
    """Order of F."""
    nk: Orders = 1
    """Delay [samples]; 0 lets the input act at once."""
    constant: bool = True
    """Estimate the constant term."""
    max_steps: Steps = 100
    """Accepted steps of the search."""
    tolerance: Share = 1e-9
    """The search ends when a step lowers the loss by less than this share."""


@settings
class GeneralLinear:
    """All polynomials together, A y = B/F u + C/D e: (2.3). Prediction error.

    Dynamics that input and noise share are in A, the others apart in F and D. Orders
    that are zero leave a polynomial out; all other classes are such cases.
    """

    na: Steps = 1
    """Order of A."""
    nb: Counts = 2
    """Coefficients of B."""
    nc: Steps = 1
    """Order of C."""
    nd: Steps = 1
    """Order of D."""
    nf: Orders = 1
    """Order of F."""
    nk: Orders = 1
    """Delay [samples]; 0 lets the input act at once."""
    constant: bool = True
    """Estimate the constant term."""
    max_steps: Steps = 100
    """Accepted steps of the search."""
    tolerance: Share = 1e-9
    """The search ends when a step lowers the loss by less than this share."""


LinearMethod = FIR | ARX | ARMAX | OutputError | BoxJenkins | GeneralLinear
"""Methods that `fit_linear` takes."""
