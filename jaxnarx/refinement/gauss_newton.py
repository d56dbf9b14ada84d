"""Loss of a run and its normal equations, accumulated in one pass over time.

Residuals are r = sqrt(weight) (run - measured), scaled signals. Blocks of their
sensitivities by all parameters are summed into J'J and J'r at once.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxnarx.arrays import gram, program
from jaxnarx.models import fold_slopes
from jaxnarx.refinement.criterion import Criterion, squares
from jaxnarx.refinement.layout import Layout
from jaxnarx.refinement.sensitivity import stream
from jaxnarx.refinement.shared_terms import normal_equations_of_shared
from jaxnarx.simulation import RunInputs, run, states


@program
def loss(
    layout: Layout,
    u: Float[Array, " params"],
    drive: RunInputs,
    anchor: Bool[Array, "records time"],
    weight: Float[Array, "records time outputs"],
    criterion: Criterion | None = None,
) -> Float[Array, ""]:
    """Weighted errors of the run restarted at anchors; by default their squares."""
    started = _start(layout, u, drive)
    y = run(layout.place(u), started, anchor)
    rule = _rule(criterion, y)
    return rule(y, drive.measured, weight) + _initial_loss(layout, u)


def _rule(criterion: Criterion | None, y) -> Criterion:
    return squares(y.shape[-1], y.dtype) if criterion is None else criterion


def _start(layout: Layout, u, drive: RunInputs) -> RunInputs:
    measured = layout.begin(u, drive.measured)
    return eqx.tree_at(lambda d: d.measured, drive, measured)


def _initial_loss(layout: Layout, u) -> Float[Array, ""]:
    """The penalty of the offsets of the initial conditions."""
    if layout.initial is None:
        return jnp.zeros((), u.dtype)
    offset = u[layout.parameters :]
    return jnp.sum(layout.initial.weight.reshape(-1) * offset**2)


@program
def roots(
    layout: Layout,
    u: Float[Array, " params"],
    drive: RunInputs,
    anchor: Bool[Array, "records time"],
    weight: Float[Array, "records time outputs"],
    criterion: Criterion,
) -> Float[Array, " errors"]:
    """The roots whose sum of squares is the loss, for solvers that ask for that."""
    y = run(layout.place(u), _start(layout, u, drive), anchor)
    found = criterion.roots(y, drive.measured, weight).reshape(-1)
    if layout.initial is None:
        return found
    offset = jnp.sqrt(layout.initial.weight.reshape(-1)) * u[layout.parameters :]
    return jnp.concatenate([found, offset])


@program
def normal_equations(
    layout: Layout,
    u: Float[Array, " params"],
    drive: RunInputs,
    anchor: Bool[Array, "records time"],
    weight: Float[Array, "records time outputs"],
    criterion: Criterion | None = None,
) -> tuple[Float[Array, ""], Float[Array, " params"], Float[Array, "params params"]]:
    """Loss, J'r and J'J of the run restarted at anchors, by the coordinates `u`.

    J'r is half the gradient of the loss; of long runs of networks that share terms J'J
    is an estimate (`shared_terms`). Under a robust loss J'J holds the weights of
    iteratively reweighted least squares.
    """
    network, drive_of = layout.place(u), _start(layout, u, drive)
    every = states(network, drive_of, anchor)
    y = every[..., : len(network.models)]
    rule = _rule(criterion, y)
    error, bend = rule.errors(y, drive.measured)
    share = weight * rule.share(error)
    params, slope = u.shape[0], layout.slope(u)

    def direct(tangents, seen, time, record):
        if layout.initial is None:
            return tangents
        (a, own), at = seen, layout.parameters
        by_start = layout.initial.direct(fold_slopes(network, a), own, time, record)
        return tangents.at[..., at:].add(by_start)

    scored = len(network.modelled)  # hidden channels are measured by nobody

    def consume(carry, s, block):
        gradient, products = carry
        root, error, bend = (part[..., :scored] for part in block)
        s = s[:, :, :scored]
        # Unscored stretches may be unstable: what overflows there must not count.
        jacobian = jnp.where(root[..., None] > 0, s * (root * bend)[..., None], 0.0)
        jacobian = jacobian.reshape(-1, params) * slope[None]
        r = jnp.where(root > 0, error * root, 0.0).reshape(-1)
        return (gradient + r @ jacobian, products + gram(jacobian)), None

    finished = network, layout, every, drive_of, anchor
    block = jnp.sqrt(share), error, bend
    if layout.shared_terms:
        gradient, products = normal_equations_of_shared(*finished, slope, block)
    else:
        zero = jnp.zeros(params, y.dtype), jnp.zeros((params, params), y.dtype)
        rest = direct, params, consume, zero, block
        (gradient, products), _ = stream(*finished, *rest)
    if layout.initial is not None:
        extra = layout.initial.weight.reshape(-1)
        at = layout.parameters + jnp.arange(extra.shape[0])
        gradient = gradient.at[at].add(extra * u[layout.parameters :])
        products = products.at[at, at].add(extra)
    value = rule(y, drive.measured, weight) + _initial_loss(layout, u)
    return value, gradient, products
