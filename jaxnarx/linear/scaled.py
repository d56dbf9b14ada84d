"""The unit-size signals a search works on, and the way back to physical units."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxnarx.linear.recursion import Signals
from jaxnarx.linear.structure import Structure


@dataclasses.dataclass(frozen=True, eq=False)
class Scale:
    """(x - mean) / spread of the inputs in use and, last, the output.

    Without a constant term the means are zero: the data are deviations as they are. A
    signal that rests at its mean has infinite spread: scaled it is zero, where rounding
    would be fitted, and its coefficients are zero too.
    """

    mean: Float[np.ndarray, " signals"]
    spread: Float[np.ndarray, " signals"]

    @classmethod
    def of(cls, data: Signals, valid: np.ndarray, *, constant: bool) -> "Scale":
        """From the valid samples of all records."""
        every = np.concatenate([data.u, np.asarray(data.y)[..., None]], axis=2)[valid]
        mean = every.mean(axis=0) if constant else np.zeros(every.shape[1])
        spread = np.sqrt(np.mean((every - mean[None]) ** 2, axis=0))
        still = spread <= 1e-12 * np.abs(every).max(axis=0, initial=0.0)
        return cls(mean, np.where(still, np.inf, spread))

    def apply(self, data: Signals) -> Signals:
        """The scaled signals."""
        u = (data.u - self.mean[None, None, :-1]) / self.spread[None, None, :-1]
        y = (data.y - self.mean[-1]) / self.spread[-1]
        return Signals(jnp.asarray(u), jnp.asarray(y), data.known)

    def physical(
        self,
        structure: Structure,
        parameters: Float[np.ndarray, " params"],
        covariance: Float[np.ndarray, "params params"],
    ) -> tuple[Float[np.ndarray, " params"], Float[np.ndarray, "params params"]]:
        """Parameters and covariance in physical units.

        b_i by the ratio of spreads; the constant takes up the means, constant' = s_y
        constant + A(1) mean_y - sum_i B_i(1)/F_i(1) mean_i. The covariance follows by
        the derivative of this map.
        """
        value, slope = _mapped(
            structure,
            jnp.asarray(parameters),
            jnp.asarray(self.mean),
            jnp.asarray(self.spread),
        )
        slope = np.asarray(slope)
        return np.asarray(value), slope @ covariance @ slope.T


@eqx.filter_jit
def _mapped(structure: Structure, parameters, mean, spread):
    def physical(theta):
        p = structure.split(theta)
        b = tuple(x * spread[-1] / spread[i] for i, x in enumerate(p.b))
        offset = spread[-1] * p.constant + jnp.sum(p.a) * mean[-1]
        for i, f in enumerate(p.f):
            offset = offset - jnp.sum(b[i]) / jnp.sum(f) * mean[i]
        new = structure.join(p._replace(b=b, constant=offset))
        return new, new

    slope, value = jax.jacfwd(physical, has_aux=True)(parameters)
    return value, slope
