"""Fed-back variables, and the collapse of a network onto their monomials.

Every term splits into an input part, known before the run, and a monomial h_a of lagged
outputs, of which there are few. Where no scheduling variable is an output, all work
over models and terms is done before the time loop,

    G_t[a] = sum_(m,k : h of k is a) phi_m(z_t) theta[m, k] e_k(t) ,

and the loop is only y_t = G_t . h(lags).

Groups of local models that are fed back their own outputs add these to what the loop
carries: behind the network's outputs come, output by output, those of all its groups.
All of them start from the measured outputs. Each has a G_t of its own, the output gets
that of all other local models and the groups' values times their summed weights.
"""

import itertools
import math
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxnarx.arrays import polynomial_step
from jaxnarx.models.network import Network, OutputModel
from jaxnarx.models.scheduling import scheduling_values
from jaxnarx.models.signed_root import SignedRoot
from jaxnarx.regressors import Variables, evaluate

MOST_COLLAPSED_MONOMIALS = 128
"""Feedback monomials up to which the collapsed loop is used; beyond, a step that
evaluates the terms is no slower and needs less memory."""


def fed_back_variables(
    variables: Variables, signals: tuple[int, ...]
) -> list[tuple[int, int, int]]:
    """(row, output, lag - 1) of the variables that are modelled outputs."""
    return [
        (row, signals.index(s), lag - 1)
        for row, (s, lag) in enumerate(variables)
        if s in signals
    ]


def looks_back(network: Network) -> bool:
    """Whether past outputs enter terms or the scheduling."""
    tables = [network.variables, *(m.scheduling for m in network.models)]
    return any(s in network.signals for table in tables for s, _ in table)


def depth(network: Network) -> int:
    """Past outputs the time loop must carry; at least one."""
    tables = [network.variables, *(m.scheduling for m in network.models)]
    lags = [lag for t in tables for s, lag in t if s in network.signals]
    return max([1, *lags])


def monomials(network: Network) -> np.ndarray:
    """Table of all monomials of fed-back variables, rows into [1, x_e1 ... x_eE]."""
    count = len(fed_back_variables(network.variables, network.signals))
    degree = max(m.local.factor.shape[1] for m in network.models)
    return np.array(
        list(itertools.combinations_with_replacement(range(count + 1), degree))
    )


def collapses(network: Network) -> bool:
    """True where the loop can be reduced to feedback monomials."""
    scheduled = any(
        fed_back_variables(m.scheduling, network.signals) for m in network.models
    )
    count = len(fed_back_variables(network.variables, network.signals))
    degree = max(m.local.factor.shape[1] for m in network.models)
    return (
        not scheduled and math.comb(count + degree, degree) <= MOST_COLLAPSED_MONOMIALS
    )


def _collapse_one(
    model: OutputModel, lookup: np.ndarray, table: np.ndarray, v, x
) -> Float[Array, "states monomials rows"]:
    factor = model.local.factor
    phi = model.validity(scheduling_values(model, x), model.active)
    weights = model.rest(phi)[None]
    if model.own is not None:
        weights = jnp.concatenate([weights, model.shares(phi)])
    weight = jnp.einsum("smr,mk->skr", weights, model.local.dense())
    own = jnp.asarray(lookup)[factor]
    inputs_only = evaluate(jnp.where(own > 0, 0, factor), v)
    beyond = _gain_beyond(factor, len(lookup), v)
    if beyond is not None:
        inputs_only += jnp.where((own == 0).all(axis=1)[:, None], beyond, 0.0)
    own = jnp.sort(own, axis=1)
    pad = table.shape[1] - own.shape[1]
    own = jnp.pad(own, ((0, 0), (pad, 0)))
    match = jnp.all(own[:, None] == table[None], axis=2).astype(v.dtype)
    return jnp.einsum("ka,skr->sar", match, weight * inputs_only[None])


def _gain_beyond(
    factor: Int[Array, "terms degree"], rows: int, v: Float[Array, "vars *rows"]
) -> Float[Array, "terms *rows"] | None:
    """The gain of the terms beyond the ranges of the inputs, to first order: their
    slope times how far the variables, so many with the leading one, are beyond them.
    None where `v` does not tell."""
    if v.shape[0] == rows:
        return None
    far = v[rows:]
    along = jnp.concatenate([jnp.zeros_like(far[:1]), far])
    return jax.jvp(lambda v: jnp.asarray(evaluate(factor, v)), (v[:rows],), (along,))[1]


def term_values(
    network: Network, model: OutputModel, v: Float[Array, "vars *rows"]
) -> Float[Array, "terms *rows"]:
    """The terms, fed-back variables in `v` as they are.

    Where `v` tells how far inputs are beyond their ranges, terms of inputs alone go on
    from the edge to first order. Products with fed-back variables stay as they are
    there, and so do poles.
    """
    factor = model.local.factor
    terms = jnp.asarray(evaluate(factor, v))
    beyond = _gain_beyond(factor, len(network.variables) + 1, v)
    if beyond is None:
        return terms
    rows = [
        row + 1 for row, *_ in fed_back_variables(network.variables, network.signals)
    ]
    fed = jnp.isin(factor, jnp.asarray(rows, factor.dtype)).any(axis=1)
    return terms + jnp.where(fed[(...,) + (None,) * (terms.ndim - 1)], 0.0, beyond)


def collapse(
    network: Network,
    v: Float[Array, "vars rows"],
    x: tuple[Float[Array, "_ rows"], ...],
) -> Float[Array, "states monomials rows"]:
    """G of every output and group: what multiplies each feedback monomial at each
    sample.

    `v` holds the scaled lagged variables behind a leading one, `x` the scheduling
    variables of every output in physical units.
    """
    lookup = np.zeros(len(network.variables) + 1, dtype=np.int64)
    for e, (row, _, _) in enumerate(
        fed_back_variables(network.variables, network.signals)
    ):
        lookup[row + 1] = e + 1
    table = monomials(network)
    every = [
        _collapse_one(model, lookup, table, v, x_o)
        for model, x_o in zip(network.models, x, strict=True)
    ]
    groups = [one[1:] for one in every]
    return jnp.concatenate([*(one[:1] for one in every), *groups])


def group_weights(
    network: Network, x: tuple[Float[Array, "_ rows"], ...]
) -> Float[Array, "groups rows"]:
    """Summed weights of every group's local models."""
    every = [
        model.group_weights(model.validity(scheduling_values(model, x_o), model.active))
        for model, x_o in zip(network.models, x, strict=True)
    ]
    return jnp.concatenate(every)


def collapsed_step(network: Network):
    """Step of the recursion on `G_t`: y = G_t . h(history); with groups, on that and
    their weights, with `group_root` as its parameters."""
    own, of = fed_back_variables(network.variables, network.signals), sources(network)
    outputs = len(network.models)
    states = np.arange(len(of))[:, None]
    output = np.array([o for _, o, _ in own], dtype=np.int64)[None]
    lag = np.array([d for _, _, d in own], dtype=np.int64)
    mine = (states >= outputs) & (of[:, None] == output)
    source = np.where(mine, states, output)
    plain = polynomial_step(monomials(network), source, lag)
    if not network.parallel:
        return plain

    def step(params, drive, history):
        (g, weight), root = drive, params
        if root is not None:
            seen = history[:outputs], root.to_root(history[outputs:])
            history = jnp.concatenate(seen)
        value = plain(None, g, history)
        alone = value[outputs:]
        if root is not None:
            alone = root.to_output(alone)
        groups = list(zip(of[outputs:], alone * weight, strict=True))
        mixed = [sum((y for i, y in groups if i == o), value[o]) for o in of[:outputs]]
        return jnp.concatenate([jnp.stack(mixed), alone])

    return step


def group_root(network: Network) -> SignedRoot | None:
    """The roots of all groups of all outputs; None where there are none."""
    if all(model.root is None for model in network.models):
        return None
    squares, floor = [], []
    for model in network.models:
        size = 0 if model.own is None else len(model.own)
        root = model.root
        squares.append(jnp.zeros(size, bool) if root is None else root.squares)
        floor.append(
            jnp.zeros(size, network.gain.dtype) if root is None else root.floor
        )
    return SignedRoot(jnp.concatenate(squares), jnp.concatenate(floor))


def with_history(network: Network, v, x, history):
    """Lagged and scheduling variables with the fed-back ones taken from `history`.

    `history` is (outputs, depth, *rows), scaled; samples are trailing axes.
    """
    for row, o, d in fed_back_variables(network.variables, network.signals):
        v = v.at[row + 1].set(history[o, d])
    out = []
    for model, x_o in zip(network.models, x, strict=True):
        for row, o, d in fed_back_variables(model.scheduling, network.signals):
            x_o = x_o.at[row].set(history[o, d] * network.gain[network.signals[o]])
        out.append(x_o)
    return v, tuple(out)


def respond(
    network: Network,
    v: Float[Array, "vars *rows"],
    x: tuple[Float[Array, "_ *rows"], ...],
) -> Float[Array, "outputs *rows"]:
    """Compute scaled outputs from given lagged and scheduling variables."""
    return jnp.stack(
        [
            model.blend(term_values(network, model, v), scheduling_values(model, x_o))
            for model, x_o in zip(network.models, x, strict=True)
        ]
    )


def sources(network: Network) -> Int[np.ndarray, " states"]:
    """The output that each entry of the loop's state is a value of.

    The outputs themselves, then the groups with feedback of their own of those that
    have any.
    """
    own = [[o] * len(m.own) for o, m in enumerate(network.models) if m.own is not None]
    return np.array([*range(len(network.models)), *itertools.chain(*own)], np.int64)


def widen(
    network: Network, values: Float[Array, "*rows outputs"]
) -> Float[Array, "*rows states"]:
    """Repeat values of the outputs for every entry of the loop's state."""
    return values[..., sources(network)] if network.parallel else values


def fold_slopes(
    network: Network, a: Float[Array, "rows states states depth"]
) -> Float[Array, "rows states outputs depth"]:
    """Slopes by the measured past: all entries of one output start from the same."""
    if not network.parallel:
        return a
    of = sources(network)[:, None] == np.arange(len(network.models))[None]
    return jnp.einsum("tsid,io->tsod", a, jnp.asarray(of, a.dtype))


def own_rows(network: Network, output: int) -> list[tuple[int, int]]:
    """(row, lag - 1) of the variables that are lags of one output."""
    every = fed_back_variables(network.variables, network.signals)
    return [(row, d) for row, o, d in every if o == output]


def with_own(network: Network, output: int, v: Array, history: Array) -> Array:
    """The variables as each local model sees them, (models, vars, *rows).

    `history` (groups, depth, *rows) are the groups' own past outputs.
    """
    own, root = network.models[output].own, network.models[output].root
    assert own is not None
    if root is not None:
        history = root.to_root(history)

    def one(member, group):
        mine, seen = v, history[group]
        for row, d in own_rows(network, output):
            mine = mine.at[row + 1].set(jnp.where(member, seen[d], v[row + 1]))
        return mine

    return jax.vmap(one)(own.any(axis=0), own.argmax(axis=0))


def places(network: Network) -> list[slice]:
    """The places of every output's groups in the loop's state."""
    size = [0 if m.own is None else len(m.own) for m in network.models]
    ends = np.cumsum([len(network.models), *size]).tolist()
    return [slice(a, b) for a, b in itertools.pairwise(ends)]


def advance(
    network: Network,
    v: Float[Array, "vars *rows"],
    x: tuple[Float[Array, "_ *rows"], ...],
    history: Float[Array, "states depth *rows"],
) -> Float[Array, "states *rows"]:
    """The next entry of the loop's state, not limited: outputs, then groups."""
    v, x = with_history(network, v, x, history)
    outputs, alone = [], []
    parts = zip(network.models, x, places(network), strict=True)
    for o, (model, x_o, at) in enumerate(parts):
        z = scheduling_values(model, x_o)
        if model.own is None:
            outputs.append(model.blend(term_values(network, model, v), z))
            continue
        terms = jax.vmap(partial(term_values, network, model))(
            with_own(network, o, v, history[at])
        )
        local = jax.vmap(lambda a, b: jnp.tensordot(a, b, axes=1))(
            model.local.dense(), terms
        )
        output, groups = model.add_up(model.validity(z, model.active), local)
        outputs.append(output)
        alone.append(groups)
    return jnp.concatenate([jnp.stack(outputs), *alone])


def general_step(network: Network):
    """Step of the recursion that evaluates the network; `params` is its arrays."""
    static = eqx.filter(network, eqx.is_array, inverse=True)

    def step(params, drive, history):
        v, x = drive
        return advance(eqx.combine(params, static), v, x, history)

    return step
