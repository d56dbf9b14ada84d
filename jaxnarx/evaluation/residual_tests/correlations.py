"""The correlations of a residual that a right model leaves at zero.

    residual          r_k      = E e(t) e(t-k),          k >= 1   Box and Jenkins 1970
    input             phi_ue   = E e(t) u(t-k)                    same
    squared input     phi_u2e  = E e(t) u2'(t-k)                  Billings and Voon 1986
    squares           phi_u2e2 = E e2'(t) u2'(t-k)                same
    residual x input  phi_eeu  = E e(t) (e u)(t-1-k)              same
    variance          phi_e2e2 = E e2'(t) e2'(t-k),   k >= 1     McLeod and Li 1983
    output x residual, residual   E (y e)'(t) e2'(t-k),  k >= 1   Billings and Zhu 1994
    output x residual, input      E (y e)'(t) u2'(t-k)            same

A prime takes the mean out; y and u are without theirs throughout. The residual's square
alone enters by its normal score, see `normal_scores_of_squares`. The first two see
what a linear model lacks, the others terms of higher degree: an omitted u^2 of an even
distribution leaves no trace in the first two.
"""

import dataclasses

import numpy as np
import scipy.special
from jaxtyping import Bool, Float

from jaxnarx.evaluation.residual_tests.fits import no_fit
from jaxnarx.evaluation.residual_tests.lag_tests import (
    LagTest,
    linear_test,
    product_test,
)
from jaxnarx.evaluation.residual_tests.residual import Residual

LAG_TEST_TITLES = {
    "autocorrelation": "residual",
    "input": "input",
    "squared input": "u²",
    "squares": "u² and residual²",
    "residual x input": "residual × input",
    "variance": "residual² in time",
    "product, residual": "y × residual, residual²",
    "product, input": "y × residual, u²",
}
"""Names of the tests, and how a figure calls them."""


def autocorrelation(
    residual: Residual, *, lags: int = 20, level: float = 0.05
) -> LagTest:
    """r_k of the residual, k = 1 to `lags`."""
    return linear_test(
        residual,
        residual.value,
        np.arange(1, lags + 1),
        name="autocorrelation",
        level=level,
        itself=True,
    )


def input_correlation(
    residual: Residual,
    values: Float[np.ndarray, "records time"],
    known: Bool[np.ndarray, "records time"],
    *,
    signal: str,
    lags: int = 20,
    level: float = 0.05,
) -> LagTest:
    """Correlation of the residual with an input, k = -`lags` to `lags`.

    Negative lags are shown but not tested: there the input follows the residual, which
    tells of a loop closed around the process and not of a wrong model.
    """
    at = np.arange(-lags, lags + 1)
    return linear_test(
        residual,
        remove_mean(values, known),
        at,
        name="input",
        signal=signal,
        level=level,
        shown_only=at < 0,
    )


def higher_order(
    residual: Residual,
    values: Float[np.ndarray, "records time"],
    known: Bool[np.ndarray, "records time"],
    output: Float[np.ndarray, "records time"],
    *,
    signal: str,
    lags: int = 20,
    level: float = 0.05,
    scores: Residual | None = None,
) -> tuple[LagTest, ...]:
    """The tests of one input beyond linear correlation, k = 0 to `lags`.

    `output` is measured where the residual is known; `scores` is what `squared` gives,
    where it is at hand.
    """
    scores = normal_scores_of_squares(residual) if scores is None else scores
    at = np.arange(lags + 1)
    u = remove_mean(values, known)
    square = remove_mean(u**2, known)
    product = remove_mean(u * residual.value, known & residual.known)
    common = {"signal": signal, "level": level}
    return (
        linear_test(residual, square, at, name="squared input", **common),
        linear_test(scores, square, at, name="squares", **common),
        _shift_lags(
            linear_test(residual, product, at + 1, name="residual x input", **common)
        ),
        product_test(
            residual,
            remove_mean(output, residual.known),
            square,
            at,
            name="product, input",
            **common,
        ),
    )


def output_product(
    residual: Residual,
    output: Float[np.ndarray, "records time"],
    *,
    lags: int = 20,
    level: float = 0.05,
) -> LagTest:
    """(y e) against the square of the residual k = 1 to `lags` samples before."""
    return product_test(
        residual,
        remove_mean(output, residual.known),
        normal_scores_of_squares(residual).value,
        np.arange(1, lags + 1),
        name="product, residual",
        level=level,
    )


def changing_variance(
    residual: Residual, *, lags: int = 20, level: float = 0.05
) -> LagTest:
    """Autocorrelation of the squared residual, k = 1 to `lags`: McLeod and Li 1983.

    Where it is found, the noise has quiet and loud spells, and the bounds of the other
    tests, which take one variance for all samples, are too narrow.
    """
    square = normal_scores_of_squares(residual)
    return linear_test(
        square,
        square.value,
        np.arange(1, lags + 1),
        name="variance",
        level=level,
        itself=True,
    )


def remove_mean(
    values: Float[np.ndarray, "records time"], known: Bool[np.ndarray, "records time"]
) -> Float[np.ndarray, "records time"]:
    """`values` less their mean where `known`, zero elsewhere."""
    if not known.any():
        return np.zeros(values.shape)
    return np.where(known, values - values[known].mean(), 0.0)


def normal_scores_of_squares(residual: Residual) -> Residual:
    """The squares' normal scores, as a residual of their own.

    Instead of the square stands the normal quantile of its rank: outliers of the noise
    would else decide the correlation alone, and no bound that is known beforehand would
    hold (Dufour and Roy 1985 on serial correlation by ranks). Estimation does not
    change these correlations to first order: the derivative of e^2 by a coefficient is
    2 e x, of mean zero whatever multiplies it from the past.
    """
    square = residual.value[residual.known] ** 2
    value = np.zeros(residual.value.shape)
    # Equal values share the mean of their ranks.
    _, place, ties = np.unique(square, return_inverse=True, return_counts=True)
    rank = (np.cumsum(ties) - 0.5 * (ties - 1))[place]
    value[residual.known] = scipy.special.ndtri(rank / (len(square) + 1))
    return dataclasses.replace(
        residual,
        value=remove_mean(value, residual.known),
        fit=no_fit(len(residual.at)),
        centred=True,
    )


def _shift_lags(test: LagTest) -> LagTest:
    """Lags counted from 0 where the product is one sample old: Billings and Voon."""
    return dataclasses.replace(test, lags=test.lags - 1)
