"""A penalty on steps that do not contract, for least-squares refinement.

Residuals are h_t = max(0, ||L A_t L^-1||_2 - target) at a few hundred fixed samples,
for a fixed norm L; a solver that adds weight * sum h_t^2 needs their first derivative
only. With p_t and q_t from the leading singular vectors of the present L A_t L^-1, held
constant,

    ||L A_t L^-1||_2 = p_t' A_t q_t + (a part that the shift gives) ,

exactly, and so is the first derivative of the right side; A_t q_t is a directional
derivative of the network's step. Singular vectors need no derivative, and values where
two singular values meet get one of the subgradients.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxnarx.arrays import program
from jaxnarx.models import Network, general_step, sources
from jaxnarx.refinement._stability.norm import contracting_norm
from jaxnarx.refinement._stability.points import (
    Points,
    choose_points,
    companion,
    group_block,
    jacobians,
    linked_groups,
    moduli,
)
from jaxnarx.refinement.layout import Layout
from jaxnarx.simulation import Masks, RunInputs, first_anchor, states


class Metric(eqx.Module):
    """The norm |L s| of the state of every group of outputs that act on one another."""

    groups: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    factor: tuple[Float[Array, "n n"], ...]


def penalty_points(
    network: Network, drive: RunInputs, masks: Masks, *, count: int = 300
) -> Points:
    """Up to `count` samples with measured histories, evenly spaced.

    Hidden channels are not measured: with them histories are those of the free run.
    """
    own = None
    if network.hidden:
        own = np.asarray(states(network, drive, jnp.asarray(first_anchor(masks))))
        begun = np.arange(own.shape[1])[None] >= masks.start[:, None]
        start = np.asarray(drive.measured)[..., sources(network)]
        own = np.where(begun[..., None], own, start)
    return choose_points(network, drive, masks, count=count, outputs=own)


def find_metric(network: Network, points: Points) -> Metric:
    """The norm in which the network contracts best at the points.

    Samples whose poles are unstable are left out while others remain: no norm mends
    them, and they would spoil it for the rest.
    """
    a = jacobians(network, points)
    groups = linked_groups(np.abs(a).max(axis=(0, 3)) > 0)
    dtype = points.v.dtype
    factor = []
    for group in groups:
        m = companion(group_block(a, group))
        stable = moduli(m) < 1
        found = contracting_norm(m[stable] if stable.any() else m)
        factor.append(jnp.asarray(found, dtype))
    return Metric(groups, tuple(factor))


def _leading_vectors(l, a):  # noqa: E741
    """p_t, q_t (points, group, ...) and the shift's part of p' M q."""
    group = a.shape[1]
    inverse = jnp.linalg.inv(l)
    m = companion(a, jnp)
    u, _, vt = jnp.linalg.svd(l @ m @ inverse)
    p = u[:, :, 0] @ l
    q = vt[:, 0] @ inverse.T
    rest = jnp.sum(p[:, group:] * q[:, : q.shape[1] - group], axis=1)
    past = jnp.swapaxes(q.reshape(q.shape[0], -1, group), 1, 2)
    return p[:, :group], past, rest


def penalty_residuals(
    layout: Layout,
    u: Float[Array, " params"],
    points: Points,
    metric: Metric,
    target: float | Float[Array, ""] = 0.999,
) -> Float[Array, " residuals"]:
    """Hinges max(0, ||L A_t L^-1||_2 - target) of every group at every point.

    Zero where a step contracts by `target` or better. One residual per point and group
    of outputs that act on one another, groups behind one another; value and first
    derivative by `u` are exact, second derivatives are not. Outputs are taken as
    unlimited at the points.
    """
    network = layout.place(u)
    step, params = general_step(network), eqx.filter(network, eqx.is_array)

    def slope(v, x, history, along):
        """A_t times a direction of the history, all outputs."""
        f = lambda h: step(params, (v, x), h)  # noqa: E731
        return jax.jvp(f, (history,), (along,))[1]

    drive = (points.v.T, tuple(x.T for x in points.x))
    a = jax.lax.stop_gradient(
        jax.vmap(
            lambda v, x, h: jax.jacfwd(lambda past: step(params, (v, x), past))(h)
        )(*drive, points.history)
    )
    out = []
    for group, l in zip(metric.groups, metric.factor, strict=True):  # noqa: E741
        at = np.array(group)
        p, q, rest = _leading_vectors(l, a[:, at[:, None], at[None]])
        along = jnp.zeros_like(points.history).at[:, at].set(q)
        top = jax.vmap(slope)(*drive, points.history, along)[:, at]
        value = jnp.sum(p * top, axis=1) + rest
        out.append(jnp.maximum(value - target, 0.0))
    return jnp.concatenate(out)


@program
def penalty(
    layout: Layout,
    u: Float[Array, " params"],
    points: Points,
    metric: Metric,
    target: float | Float[Array, ""] = 0.999,
) -> tuple[Float[Array, ""], Float[Array, " params"], Float[Array, "params params"]]:
    """Sum h't h, J'h and J'J of the residuals, the form of `normal_equations`."""

    def f(u):
        return penalty_residuals(layout, u, points, metric, target)

    h, pull = jax.vjp(f, u)
    jacobian = jax.vmap(lambda row: pull(row)[0])(jnp.eye(h.shape[0], dtype=h.dtype))
    return h @ h, h @ jacobian, jacobian.T @ jacobian
