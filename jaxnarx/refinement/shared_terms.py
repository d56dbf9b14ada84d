"""Sensitivities of networks in which everything computed has the same terms.

States and outputs of a state-space model are sums of the same products, and of the same
sigmoid gates, of the last states and the inputs,

    z_o(t) = sum_k theta_ok f_k(t) ,   f = terms, sigma(w_1 . v - c_1), ...

so the direct tangents are f by an output's own coefficients and
(d z_o / d sigma_k) sigma_k' v by the gates, which all share: a few numbers of each
sample in place of a matrix of outputs times parameters. They are spread out inside the
time loop, where they stay in the cache; and the values that a record begins with have
columns of that record alone. Of five outputs and states, 235 parameters and 20 records
normal equations take a quarter of the time (`experiments/benchmarks/states.py`).

What is left is mostly the product J'J. Of long runs it is that of every k-th sample
times k: neighbours say nearly the same. J'r is that of all, so that a training ends
where it would end otherwise.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays import gram
from jaxnarx.models import (
    AdditiveGates,
    Network,
    depth,
    fed_back_variables,
    scheduling_values,
    term_values,
    with_history,
)
from jaxnarx.refinement.layout import Layout
from jaxnarx.refinement.sensitivity import walk_blocks
from jaxnarx.simulation import RunInputs

GRAM_SAMPLES = 60_000
"""Samples of all records that J'J is made of, about, before twice as many are taken."""


def shares_terms(layout: Layout) -> bool:
    """Whether everything computed has the same terms and gates, of hidden channels one
    sample ago and of inputs, and all of it is trained; host only."""
    network = layout.base
    first, *others = network.models
    if not network.hidden or depth(network) != 1 or network.parallel:
        return False
    tables = [network.variables, *(m.scheduling for m in network.models)]
    fed = [o for t in tables for _, o, _ in fed_back_variables(t, network.signals)]
    if min(fed, default=0) < len(network.modelled):
        return False
    several = int(np.asarray(first.active).sum()) > 1
    if several and not isinstance(first.validity, AdditiveGates):
        return False
    if several and any(layout.owners or range(len(network.models))):
        return False
    if not all(np.asarray(model.active).all() for model in network.models):
        return False
    kept = (True, *(several for _ in first.validity.trained))
    if layout.chosen[0] != kept or not all(keep[0] for keep in layout.chosen):
        return False
    names = ("factor", "index", "used")
    return all(
        np.array_equal(getattr(first.local, name), getattr(other.local, name))
        for other in others
        for name in names
    )


def normal_equations_of_shared(
    network: Network,
    layout: Layout,
    y: Float[Array, "records time states"],
    drive: RunInputs,
    anchor: Bool[Array, "records time"],
    slope: Float[Array, " params"],
    block: tuple[Float[Array, "records time outputs"], ...],
) -> tuple[Float[Array, " params"], Float[Array, "params params"]]:
    """J'r and J'J, as `gauss_newton.normal_equations` has them, without the penalty of
    initial conditions; J'J of runs of `2 * GRAM_SAMPLES` and more is an estimate.

    `slope` is that of the coordinates, `block` the roots of the weights, the errors and
    the criterion's share in a derivative.
    """
    records, time, states = y.shape
    every = max(1, records * time // GRAM_SAMPLES)
    count, own = layout.parameters, states - len(network.modelled)
    initial = layout.initial
    slope = slope[:count]

    def rows(block, at, record, past):
        return _record_rows(network, layout, block, at, record, past)

    def consume(carry, s, block):
        gradient, products, beside, alone, moment = carry
        root, error, bend = (x[:, :, : len(network.modelled)] for x in block)
        # Unscored stretches may be unstable: what overflows there must not count.
        jacobian = jnp.where(root[..., None] > 0, s * (root * bend)[..., None], 0.0)
        r = jnp.where(root > 0, error * root, 0.0)
        jacobian = jacobian.reshape(records, -1, count + own)
        r = r.reshape(records, -1)
        inner, begun = jacobian[..., :count] * slope[None, None], jacobian[..., count:]
        gradient = gradient + r.reshape(-1) @ inner.reshape(-1, count)
        moment = moment + jnp.einsum("rt,rtk->rk", r, begun)
        # Rows of several outputs follow one another: their samples are thinned.
        inner, begun = (_thin(a, s.shape[2], every) for a in (inner, begun))
        carry = (
            gradient,
            products + every * gram(inner.reshape(-1, count)),
            beside + every * jnp.einsum("rtp,rtk->rpk", inner, begun),
            alone + every * jnp.einsum("rtj,rtk->rjk", begun, begun),
            moment,
        )
        return carry, None

    def zeros(*shape: int):
        return jnp.zeros(shape, y.dtype)

    carry = (
        zeros(count),
        zeros(count, count),
        zeros(records, count, own),
        zeros(records, own, own),
        zeros(records, own),
    )
    past = zeros(records, own, count + own)
    (gradient, products, beside, alone, moment), _ = walk_blocks(
        network, y, drive, anchor, rows, past, consume, carry, block
    )
    if initial is None:
        return gradient, products
    size = layout.low.shape[0]
    # Offsets of every record: of what is measured, which has no effect, then hidden.
    place = count + np.arange(initial.size).reshape(records, states)
    place = place[:, states - own :]
    whole = jnp.zeros((size, size), y.dtype).at[:count, :count].set(products)
    by_record = jnp.moveaxis(beside, 1, 0).reshape(count, -1)
    flat = place.reshape(-1)
    whole = whole.at[:count, flat].set(by_record).at[flat, :count].set(by_record.T)
    whole = whole.at[place[:, :, None], place[:, None]].set(alone)
    return jnp.pad(gradient, (0, size - count)).at[flat].set(moment.reshape(-1)), whole


def _thin(
    a: Float[Array, "records rows columns"], outputs: int, every: int
) -> Float[Array, "records _ columns"]:
    """The rows of every so many-th sample; each sample has one for every output."""
    if every == 1:
        return a
    records, _, columns = a.shape
    a = a.reshape(records, -1, outputs, columns)[:, ::every]
    return a.reshape(records, -1, columns)


def _record_rows(
    network: Network, layout: Layout, block: Any, at, record, past
) -> tuple[Float[Array, "hidden columns"], Float[Array, "rows outputs columns"]]:
    """The sensitivities of one record over one block; the end and all."""
    v, x, history, own = block
    states, measured = len(network.models), len(network.modelled)
    features, a, gates, z, limited = _linearise(network, layout, v, x, history)
    own = own[:, 0]
    first = jnp.zeros_like(own)
    if layout.initial is not None:
        first = (at == layout.initial.at[record]) & ~own
    unit = jnp.eye(states, dtype=a.dtype)

    def step(past, row):
        a, f, gates, z, limited, own, first = row
        past = jnp.where(own, past, 0.0)
        by_coefficient = unit[:, :, None] * f[None, None]
        tangents = jnp.concatenate(
            [  # As they stand in the vector: the first output owns the gates.
                by_coefficient[:, 0],
                (gates[:, :, None] * z[None, None]).reshape(states, -1),
                -gates,
                by_coefficient[:, 1:].reshape(states, -1),
                jnp.where(first, a, 0.0),
            ],
            axis=1,
        )
        now = jnp.where(limited[:, None], 0.0, a @ past + tangents)
        return now[measured:], now[:measured]

    return jax.lax.scan(step, past, (a, features, gates, z, limited, own, first))


def _linearise(
    network: Network,
    layout: Layout,
    v: Float[Array, "vars rows"],
    x: tuple[Float[Array, "_ rows"], ...],
    history: Float[Array, "rows states depth"],
) -> tuple[
    Float[Array, "rows features"],
    Float[Array, "rows states hidden"],
    Float[Array, "rows states gates"],
    Float[Array, "rows dims"],
    Bool[Array, "rows states"],
]:
    """A finished run, sample by sample: what the coefficients in the vector multiply;
    the derivatives of all that is computed by the hidden channels a sample ago and by
    the arguments of the gates; the variables of these; and where a value is held."""
    first, measured = network.models[0], len(network.modelled)
    states, hidden = len(network.models), len(network.models) - measured
    model, term, used, back = _places(layout)
    seen = jnp.moveaxis(history, 0, -1)

    def features(seen):
        v_, x_ = with_history(network, v, x, seen)
        phi = first.validity(scheduling_values(first, x_[0]), first.active)
        values = phi[model] * term_values(network, first, v_)[term]
        return jnp.where(used[:, None], values, 0.0)

    f, along = jax.linearize(features, seen)
    unit = jnp.eye(states, dtype=seen.dtype)[measured:, :, None, None]
    slopes = jax.vmap(along)(jnp.broadcast_to(unit, (hidden, *seen.shape)))
    theta = jnp.stack(
        [m.local.coefficient.reshape(-1)[_slots(layout)] for m in network.models]
    )
    raw = theta @ f
    free = (raw >= network.lower[:, None]) & (raw <= network.upper[:, None])
    a = jnp.einsum("ok,jkr->roj", theta, slopes)
    v, x = with_history(network, v, x, seen)
    found = (back @ f).T, jnp.where(free.T[..., None], a, 0.0)
    if not isinstance(first.validity, AdditiveGates):
        rows = v.shape[1]
        none = jnp.zeros((rows, states, 0), v.dtype), jnp.zeros((rows, 0), v.dtype)
        return *found, *none, ~free.T
    z = scheduling_values(first, x[0])
    terms = term_values(network, first, v)
    behind = jnp.stack([m.local.dense()[1:] for m in network.models])
    gates = jnp.einsum("oqk,kr->roq", behind, terms)
    gates = gates * first.validity.slopes(z).T[:, None]
    return *found, gates, z.T, ~free.T


def _slots(layout: Layout) -> Int[Array, " features"]:
    """The places of the coefficients of an output that stand in the vector."""
    own = layout.slots[0] if layout.slots else None
    if own is not None:
        return own
    return jnp.arange(layout.base.models[0].local.coefficient.size)


def _places(
    layout: Layout,
) -> tuple[
    Int[Array, " features"],
    Int[Array, " features"],
    Bool[Array, " features"],
    Float[Array, "features features"],
]:
    """Local model and term of every such coefficient, whether it is used, and what
    makes derivatives by the vector of those by the coefficients."""
    local = layout.base.models[0].local
    count = local.index.shape[1]
    at = _slots(layout)
    model, slot = at // count, at % count
    term, used = local.index[model, slot], local.used[model, slot]
    if layout.back is None:
        return model, term, used, jnp.eye(at.shape[0], dtype=layout.low.dtype)
    same = model[:, None] == model[None]
    back = layout.back[0][model[:, None], slot[:, None], slot[None]]
    return model, term, used, jnp.where(same, back, 0.0)
