"""Residuals with what their tests must know: gaps, mean, and the fit behind them."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnarx.evaluation.residual_tests.fits import ResidualBasis, no_fit


@dataclasses.dataclass(frozen=True, eq=False)
class Residual:
    """One-step residuals of one output.

    `value` is zero where `known` is False, and without its `mean` where `centred`.
    `fit` tells at the flat places `at`, all known ones or evenly spaced among
    them, what the estimation did.
    """

    value: Float[np.ndarray, "records time"]
    known: Bool[np.ndarray, "records time"]
    at: Int[np.ndarray, " rows"]
    fit: ResidualBasis
    mean: float
    centred: bool

    @property
    def samples(self) -> int:
        """Known residuals."""
        return int(self.known.sum())

    @property
    def squares(self) -> float:
        """Their sum of squares."""
        return float(np.sum(self.value**2))

    @property
    def parameters(self) -> float:
        """Estimated parameters, the mean among them where it was taken out."""
        more = self.fit.unexplained_constant if self.centred else 0.0
        return self.fit.parameters + more

    @property
    def freedom(self) -> float:
        """Samples less parameters."""
        return max(self.samples - self.parameters, 1.0)

    @property
    def deviation(self) -> float:
        """Standard deviation of the noise, sqrt(squares/freedom)."""
        return float(np.sqrt(self.squares / self.freedom))

    def remove_fit_and_mean(
        self, z: Float[np.ndarray, "rows columns"]
    ) -> Float[np.ndarray, "rows columns"]:
        """The rest of instruments at the places `at` after fit and mean."""
        return self.fit.remove_fit(z - z.mean(axis=0)[None] if self.centred else z)

    @property
    def share(self) -> float:
        """Sums over the places `at` times this are those over all samples.

        Few places follow a fit of many parameters too closely: corrected.
        """
        rows = len(self.at)
        spare = max(rows - self.parameters, 1.0)
        return self.samples / rows * (self.freedom / self.samples) * (rows / spare)


def make_residual(
    value: Float[np.ndarray, "records time"],
    known: Bool[np.ndarray, "records time"],
    *,
    at: Int[np.ndarray, " rows"] | None = None,
    fit: ResidualBasis | None = None,
    centre: bool | None = None,
) -> Residual:
    """Residuals as the tests take them; without `fit` nothing was estimated.

    The mean is taken out unless `centre` is False. By default it stays after a fit
    without a constant: there, taking it out would disturb what the fit has made zero.
    """
    places = np.flatnonzero(known) if at is None else at
    fit = no_fit(len(places)) if fit is None else fit
    free = fit.basis.shape[1] == 0 or fit.unexplained_constant < 1e-6
    centred = free if centre is None else centre
    mean = float(value[known].mean()) if known.any() else 0.0
    taken = mean if centred else 0.0
    return Residual(
        np.where(known, value - taken, 0.0), known, places, fit, mean, centred
    )
