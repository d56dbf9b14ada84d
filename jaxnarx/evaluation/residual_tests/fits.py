"""The effect of estimated coefficients on the residuals.

Least squares leave the residual e - B B'e of the noise e. A statistic z'(residual) is
therefore w'e with w = z - B B'z: it varies less the more of z the regressors explain.
When z holds residuals k samples ago and the regressors past outputs, this is what makes
the first autocorrelations of a fitted autoregression small.

Box and Pierce 1970; McLeod 1978; in this form, with the regressors as they are, Durbin
1970, Breusch 1978 and Godfrey 1978.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxnarx.arrays import directions


@dataclasses.dataclass(frozen=True, eq=False)
class ResidualBasis:
    """B of the residual e - B B'e. For a global fit B is an orthonormal basis.

    For local models estimated each by itself, with its validity phi as weight, B stacks
    sqrt(phi_m) Q_m, where Q_m is a basis of the columns sqrt(phi_m) P. The coefficients
    are off by `answer`'e. `condition` is that of each least squares problem.
    """

    basis: Float[np.ndarray, "rows rank"]
    answer: Float[np.ndarray, "rows params"]
    condition: tuple[float, ...]

    @property
    def parameters(self) -> float:
        """Effective number of parameters, the trace of B B'."""
        return float(np.sum(self.basis**2))

    @property
    def unexplained_constant(self) -> float:
        """Share of a constant that the regressors cannot express; 0 if one is there."""
        rows = max(len(self.basis), 1)
        return max(1.0 - float(np.sum(self.basis.sum(axis=0) ** 2)) / rows, 0.0)

    @property
    def leverage(self) -> Float[np.ndarray, " rows"]:
        """The share of its own noise that each sample's prediction takes over.

        The diagonal of B B', between 0 and 1 for a global fit.
        """
        return np.einsum("np,np->n", self.basis, self.basis)

    def remove_fit(
        self, z: Float[np.ndarray, "rows columns"]
    ) -> Float[np.ndarray, "rows columns"]:
        """z - B B'z: what the fit leaves of instruments."""
        return z - self.basis @ (self.basis.T @ z)


def no_fit(rows: int) -> ResidualBasis:
    """Nothing was estimated from these samples: the residual is the noise."""
    return ResidualBasis(np.zeros((rows, 0)), np.zeros((rows, 0)), ())


def global_fit(columns: Float[np.ndarray, "rows params"]) -> ResidualBasis:
    """All coefficients by one least squares problem."""
    basis, inverse, condition = _factorise(columns)
    return ResidualBasis(basis, basis @ inverse.T, (condition,))


def local_fit(
    columns: Sequence[Float[np.ndarray, "rows _"]],
    weights: Float[np.ndarray, "models rows"],
) -> ResidualBasis:
    """The coefficients of every local model by its own problem, weighted by phi_m."""
    bases, answers, conditions = [], [], []
    for p, phi in zip(columns, weights, strict=True):
        root = np.sqrt(np.maximum(phi, 0.0))[:, None]
        basis, inverse, condition = _factorise(root * p)
        bases.append(root * basis)
        answers.append(bases[-1] @ inverse.T)
        conditions.append(condition)
    return ResidualBasis(
        np.concatenate(bases, axis=1),
        np.concatenate(answers, axis=1),
        tuple(conditions),
    )


def _factorise(
    columns: Float[np.ndarray, "rows params"],
) -> tuple[Float[np.ndarray, "rows rank"], Float[np.ndarray, "params rank"], float]:
    """Basis of the columns, pseudo-inverse in it, condition of those of unit norm."""
    norm = np.linalg.norm(columns, axis=0)
    scale = np.where(norm > 0, norm, 1.0)
    found = directions(columns / scale[None])
    return found.basis, found.inverse / scale[:, None], found.condition
