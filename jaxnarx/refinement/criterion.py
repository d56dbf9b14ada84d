"""How the errors of a run are weighed: transforms of the output and robust losses.

With T the transform of an output and e = T(run) - T(measured) the loss is

    sum w c^2 rho(e / c),   rho(x) = x^2, or for robust losses
    Huber:     x^2 up to |x| = 1, then 2 |x| - 1        (Huber 1964)
    log-cosh:  2 log cosh x .

All of them are x^2 near zero and two of them grow linearly far out, so outliers pull
with a bounded force. Gauss-Newton takes the weights rho'(x) / (2 x), between 0 and 1,
as fixed: iteratively reweighted least squares, which never overshoots these losses.

T is the Box-Cox transform (y^p - 1) / p, at p = 0 the logarithm, for outputs whose
error grows with their value (Box and Cox 1964). Below `floor` it goes on as its
tangent: a run may become negative where a measurement cannot.
"""

import math
from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.models import Network

LOGARITHM_EXPONENT = 1e-6
"""Exponents nearer to zero than this are the logarithm."""


class Criterion(eqx.Module):
    """Loss and transform of every output; `power` is None where no output has one.

    `corner` is the error at which a robust loss turns linear and `floor` the value
    below which a transform is its tangent, both in scaled and transformed units.
    """

    loss: str = eqx.field(static=True)
    power: Float[Array, " outputs"] | None
    floor: Float[Array, " outputs"]
    corner: Float[Array, " outputs"]

    def transform(
        self, y: Float[Array, "*rows outputs"]
    ) -> tuple[Float[Array, "*rows outputs"], Float[Array, "*rows outputs"]]:
        """T(y) and its derivative."""
        if self.power is None:
            return y, jnp.ones_like(y)
        lead = (None,) * (y.ndim - 1)
        power, floor = self.power[lead], self.floor[lead]
        inside = jnp.maximum(y, floor)
        logarithm = jnp.log(inside)
        bent = jnp.abs(power) > LOGARITHM_EXPONENT
        safe = jnp.where(bent, power, 1.0)
        value = jnp.where(bent, jnp.expm1(safe * logarithm) / safe, logarithm)
        slope = jnp.exp((power - 1.0) * logarithm)
        return value + slope * (y - inside), slope

    def errors(
        self,
        y: Float[Array, "*rows outputs"],
        measured: Float[Array, "*rows outputs"],
    ) -> tuple[Float[Array, "*rows outputs"], Float[Array, "*rows outputs"]]:
        """e, and its derivative by the run."""
        value, slope = self.transform(y)
        return value - self.transform(measured)[0], slope

    def share(self, e: Float[Array, "*rows outputs"]) -> Float[Array, "*rows outputs"]:
        """Weight of an error in Gauss-Newton: 1 where the loss is quadratic."""
        if self.loss == "squares":
            return jnp.ones_like(e)
        x = jnp.abs(e) / self.corner[(None,) * (e.ndim - 1)]
        beyond = jnp.maximum(x, 1.0)
        if self.loss == "huber":
            return 1.0 / beyond
        small = x < LOGARITHM_EXPONENT
        return jnp.where(small, 1.0, jnp.tanh(x) / jnp.where(small, 1.0, x))

    def __call__(
        self,
        y: Float[Array, "*rows outputs"],
        measured: Float[Array, "*rows outputs"],
        weight: Float[Array, "*rows outputs"],
    ) -> Float[Array, ""]:
        """The loss. Samples without weight do not count, whatever they hold."""
        e, _ = self.errors(y, measured)
        if self.loss == "squares":
            return jnp.sum(jnp.where(weight > 0, weight * e**2, 0.0))
        corner = self.corner[(None,) * (e.ndim - 1)]
        rho = self._rho(jnp.abs(e) / corner)
        return jnp.sum(jnp.where(weight > 0, weight * corner**2 * rho, 0.0))

    def roots(
        self,
        y: Float[Array, "*rows outputs"],
        measured: Float[Array, "*rows outputs"],
        weight: Float[Array, "*rows outputs"],
    ) -> Float[Array, "*rows outputs"]:
        """The roots whose sum of squares is the loss, with the sign of the error; zero
        where there is no weight."""
        e, _ = self.errors(y, measured)
        counted = weight > 0
        e = jnp.where(counted, e, 0.0)
        root = jnp.sqrt(jnp.where(counted, weight, 1.0))
        if self.loss == "squares":
            return root * e
        corner = self.corner[(None,) * (e.ndim - 1)]
        x = jnp.abs(e) / corner
        rho = self._rho(x)
        near = x < LOGARITHM_EXPONENT
        return root * jnp.where(
            near, e, jnp.sign(e) * corner * jnp.sqrt(jnp.where(near, 1.0, rho))
        )

    def _rho(self, x: Array) -> Array:
        """The robust loss of |e| / corner."""
        if self.loss == "huber":
            return jnp.where(x <= 1.0, x**2, 2.0 * x - 1.0)
        # Each form loses its digits where the other keeps them.
        near = jnp.log1p(2.0 * jnp.sinh(jnp.minimum(x, 1.0) / 2.0) ** 2)
        far = x + jnp.log1p(jnp.exp(-2.0 * x)) - math.log(2.0)
        return 2.0 * jnp.where(x < 1.0, near, far)


def squares(outputs: int, dtype) -> Criterion:
    """Plain least squares."""
    one = jax.device_put(np.ones(outputs, dtype))
    return Criterion("squares", None, one, one)


def make_criterion(
    network: Network,
    data: Dataset,
    measured: Float[np.ndarray, "records time outputs"],
    scored: Bool[np.ndarray, "records time outputs"],
    *,
    loss: str = "squares",
    corner: float | int = 0.2,
    box_cox: float | int | Mapping[str, float | int] = 1.0,
) -> tuple[Criterion, Float[np.ndarray, " outputs"]]:
    """The criterion of a refinement, and the spread of every transformed output.

    `measured` are the scaled outputs of `data`; `corner` is a share of the spread. A
    counted value that is not positive cannot be transformed: `DataError` names the
    channel, the record and the row.
    """
    power = _powers(network, box_cox)
    counted = [measured[..., o][scored[..., o]] for o in range(len(power))]
    if np.all(power == 1.0):
        rule = squares(len(power), measured.dtype)
    else:
        _require_positive(network, data, measured, scored, power)
        floor = [0.5 * v.min() if v.size else 0.5 for v in counted]
        rule = Criterion(
            loss,
            jnp.asarray(power, measured.dtype),
            # Where the exponent is one this is where value and tangent change over,
            # and they agree.
            jnp.asarray(np.where(power == 1.0, 1.0, floor), measured.dtype),
            jnp.ones(len(power), measured.dtype),
        )
    spread = output_spread(rule, measured, scored)
    bend = jax.device_put((corner * spread).astype(measured.dtype))
    return Criterion(loss, rule.power, rule.floor, bend), spread


def output_spread(
    rule: Criterion,
    measured: Float[np.ndarray, "records time outputs"],
    scored: Bool[np.ndarray, "records time outputs"],
) -> Float[np.ndarray, " outputs"]:
    """Standard deviation of every transformed output; one where it rests."""
    shown = measured
    if rule.power is not None:
        shown = np.asarray(rule.transform(jnp.asarray(measured))[0])
    counted = [shown[..., o][scored[..., o]] for o in range(shown.shape[-1])]
    spread = np.array([v.std() if v.size else 0.0 for v in counted], measured.dtype)
    return np.where(spread > 0, spread, 1.0).astype(measured.dtype)


def _powers(network: Network, box_cox) -> Float[np.ndarray, " outputs"]:
    names = network.output_names
    hidden = np.ones(network.hidden)
    if not isinstance(box_cox, Mapping):
        return np.append(np.full(len(names), float(box_cox)), hidden)
    unknown = sorted(set(box_cox) - set(names))
    if unknown:
        raise SpecError(
            f"box_cox names {unknown[0]!r}, but the modelled outputs are {names}",
            field="box_cox",
        )
    return np.append([float(box_cox.get(name, 1.0)) for name in names], hidden)


def _require_positive(network, data, measured, scored, power) -> None:
    bad = np.argwhere(scored & (measured <= 0) & (power != 1.0)[None, None])
    if not bad.size:
        return
    n, t, o = bad[0].tolist()
    record, name = data.records[n], network.output_names[o]
    row = t + record.start_row
    raise DataError(
        f"{name} is {record.y[t, network.modelled[o]]:g} at row {row} of record "
        f"{record.name!r}, but a Box-Cox transform with exponent {power[o]:g} needs "
        f"positive values; leave {name} as it is (box_cox=1) or mask the sample",
        channel=name,
        row=row,
    )
