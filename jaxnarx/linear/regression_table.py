"""A regression as text: one line per coefficient, in the manner of statsmodels."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxnarx.linear.regression import Regression


def regression_table(value: "Regression") -> str:
    """Head with the fit as a whole, then a line per coefficient.

    t and p test each coefficient in the model as it is; they know nothing of a search
    that chose the columns.
    """
    method = value.method
    width = max(11, *(len(name) for name in value.names))
    head = [
        f"{len(value.residual)} samples, {len(value.names)} coefficients, "
        f"{value.degrees:.6g} degrees of freedom",
        f"algorithm {method.algorithm}, columns scaled by {method.scaling}, ridge "
        f"{method.ridge:g}, forgetting {method.forgetting:g}",
        f"rank {value.rank}, condition {value.condition:.3g}, sigma "
        f"{value.sigma:.6g}, R2 {value.r2:.6g}",
        "",
        f"{'':{width}s} {'coefficient':>13s} {'std. error':>11s} {'t':>9s} "
        f"{'P>|t|':>9s} {'[0.025':>13s} {'0.975]':>13s}",
    ]
    columns = (value.coefficient, value.standard_error, value.t, value.p)
    rows = np.column_stack([*columns, value.interval()])
    return "\n".join(
        head
        + [
            f"{name:{width}s} {b:13.6g} {e:11.3g} {t:9.2f} {p:9.2g} "
            f"{low:13.6g} {high:13.6g}"
            for name, (b, e, t, p, low, high) in zip(value.names, rows, strict=True)
        ]
    )
