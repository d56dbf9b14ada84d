"""How far measurements lie from a free run: prediction intervals.

The size of an error is a product of what every one of some variables says of it,

    s(t) = exp(c + sum_j f_j(z_j(t))) max(1, index)^n ,

with f_j linear between knots and constant beyond them. The variables are the features
of the network's domain, how far each input is from the same filtered, the run, its step
from sample to sample, and the index of the domain. The interval of probability p is

    y(t) - q_p s(t)  to  y(t) + q_p s(t) ,

where q_p is such that it holds p of the samples of records left out, whatever their
errors are distributed like: normalised conformal prediction. J. Lei, M. G'Sell, A.
Rinaldo, R. Tibshirani, L. Wasserman, Distribution-free predictive inference for
regression, JASA 113 (2018) 1094-1111, section 5.2; by groups, pooled: R. Dunn, L.
Wasserman, A. Ramdas, Distribution-free prediction sets for two-layer hierarchical
models, JASA 118 (2023) 2491-2502, section 3.1.
"""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

STORED_PROBABILITIES = (0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.925, 0.95, 0.975, 0.99)
"""Probabilities of which a quantile is stored."""
GROWTH_EXPONENT = 3.0
"""Exponent n of the index beyond the border: what nine in ten errors of 15 outputs of
virtual engines kept to grew about so (`experiments/edge`)."""


class ErrorModel(eqx.Module):
    """Sizes of the errors of all outputs; see the module.

    `height` is f_j at the `knots`, which rise strictly, `constant` c in the logarithm
    of the output's unit, `quantile` q_p for all `STORED_PROBABILITIES`.
    """

    knots: Float[Array, "outputs variables knots"]
    height: Float[Array, "outputs variables knots"]
    constant: Float[Array, " outputs"]
    quantile: Float[Array, "outputs levels"]

    def size(
        self, output: int, z: Float[np.ndarray, "variables time"]
    ) -> Float[np.ndarray, " time"]:
        """s(t) of one output, in its unit; the last variable is the index."""
        knots, height = np.asarray(self.knots)[output], np.asarray(self.height)[output]
        total = np.full(z.shape[1], float(np.asarray(self.constant)[output]))
        for k, h, value in zip(knots, height, z, strict=True):
            total += np.interp(value, k, h)
        return np.exp(total) * np.maximum(z[-1], 1.0) ** GROWTH_EXPONENT

    def reach(self, output: int, level: float) -> float:
        """q_p of one output; `level` is one of those stored, or between two."""
        return float(
            np.interp(level, STORED_PROBABILITIES, np.asarray(self.quantile)[output])
        )
