"""The criteria D, A and G of an information matrix."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.settings import OptimalDesign


class Criteria(NamedTuple):
    """Figures of an information matrix M; see `OptimalDesign`."""

    log_det: Float[Array, ""]  # of M
    trace: Float[Array, ""]  # of M^-1
    largest: Float[Array, ""]  # prediction variance over the reference samples


@guard_arguments
def criteria(
    slope: Float[Array, "time outputs params"],
    reference: Float[Array, "samples outputs params"],
    *,
    power: float | int | None = None,
) -> Criteria:
    """All criteria of the experiment with sensitivities `slope`.

    The prediction variance of a reference sample is tr(S M^-1 S'), in units of the
    noise's. With `power` its maximum is replaced by the mean of that power, root taken,
    which is smooth. Not finite where the experiment does not determine the parameters.
    """
    rows = slope.reshape(-1, slope.shape[-1])
    # Columns of unit size: the determinant's own scale would underflow.
    size = jnp.sqrt(jnp.sum(rows**2, axis=0))
    safe = jnp.where(size > 0, size, 1.0)
    lower = jnp.linalg.qr(rows / safe[None], mode="r").T
    diagonal = jnp.abs(jnp.diagonal(lower))
    rounding = 64 * jnp.finfo(size.dtype).eps * rows.shape[0] ** 0.5
    diagonal = jnp.where((size > 0) & (diagonal > rounding), diagonal, 0.0)

    def whiten(rows: Float[Array, "rows params"]) -> Float[Array, "params rows"]:
        scaled = (rows / safe[None]).T
        return jax.scipy.linalg.solve_triangular(lower, scaled, lower=True)

    identity = jnp.eye(size.shape[0], dtype=size.dtype)
    points = reference.reshape(-1, reference.shape[-1])
    variance = jnp.sum(whiten(points) ** 2, axis=0)
    variance = jnp.sum(variance.reshape(reference.shape[:2]), axis=1)
    top = jnp.max(variance)
    if power is not None:
        share = jnp.mean((variance / jax.lax.stop_gradient(top)) ** power)
        top = jax.lax.stop_gradient(top) * share ** (1 / power)
    return Criteria(
        log_det=2 * jnp.sum(jnp.log(diagonal * safe)),
        trace=jnp.sum(whiten(identity) ** 2),
        largest=top,
    )


def objective(
    slope: Float[Array, "time outputs params"],
    reference: Float[Array, "samples outputs params"],
    method: OptimalDesign,
) -> Float[Array, ""]:
    """The criterion that `adjust` minimises: -log det M/p, log tr M^-1, or log of G's
    variance."""
    found = criteria(slope, reference, power=method.power)
    if method.criterion == "D":
        return -found.log_det / slope.shape[-1]
    return jnp.log(found.trace if method.criterion == "A" else found.largest)
