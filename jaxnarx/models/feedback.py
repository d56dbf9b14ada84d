"""Which variables are fed back, and the collapse of a network onto their monomials.

Every term splits into an input part, known before the run, and a monomial h_a of lagged
outputs, of which there are few. Where no scheduling variable is an output, all work
over models and terms is done before the time loop,

    G_t[a] = sum_(m,k : h of k is a) phi_m(z_t) theta[m, k] e_k(t) ,

and the loop is only y_t = G_t . h(lags).

Local models that are fed back their own outputs add these to what the loop carries:
behind the network's outputs come, output by output, those of all its local models. All
of them start from the measured outputs.
"""

import itertools
import math
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxnarx.arrays.recurrence import polynomial_step
from jaxnarx.models.network import Network, OutputModel, scheduling_values
from jaxnarx.regressors import Variables, evaluate

WIDEST = 128
"""Feedback monomials up to which the collapsed loop is used; beyond, a step that
evaluates the terms is no slower and needs less memory."""


def fed_back(
    variables: Variables, signals: tuple[int, ...]
) -> list[tuple[int, int, int]]:
    """(row, output, lag - 1) of the variables that are modelled outputs."""
    return [
        (row, signals.index(s), lag - 1)
        for row, (s, lag) in enumerate(variables)
        if s in signals
    ]


def depth(network: Network) -> int:
    """Past outputs the time loop must carry; at least one."""
    tables = [network.variables, *(m.scheduling for m in network.models)]
    lags = [lag for t in tables for s, lag in t if s in network.signals]
    return max([1, *lags])


def monomials(network: Network) -> np.ndarray:
    """Table of all monomials of fed-back variables, rows into [1, x_e1 ... x_eE]."""
    count = len(fed_back(network.variables, network.signals))
    degree = max(m.local.factor.shape[1] for m in network.models)
    return np.array(
        list(itertools.combinations_with_replacement(range(count + 1), degree))
    )


def collapses(network: Network) -> bool:
    """True where the loop can be reduced to feedback monomials."""
    if network.parallel:
        return False
    scheduled = any(fed_back(m.scheduling, network.signals) for m in network.models)
    count = len(fed_back(network.variables, network.signals))
    degree = max(m.local.factor.shape[1] for m in network.models)
    return not scheduled and math.comb(count + degree, degree) <= WIDEST


def _collapse_one(
    model: OutputModel, lookup: np.ndarray, table: np.ndarray, v, x
) -> Float[Array, "monomials *rows"]:
    factor = model.local.factor
    phi = model.validity(scheduling_values(model, x), model.active)
    weight = jnp.tensordot(model.local.dense().T, phi, axes=1)
    own = jnp.asarray(lookup)[factor]
    inputs_only = evaluate(jnp.where(own > 0, 0, factor), v)
    own = jnp.sort(own, axis=1)
    pad = table.shape[1] - own.shape[1]
    own = jnp.pad(own, ((0, 0), (pad, 0)))
    match = jnp.all(own[:, None] == table[None], axis=2).astype(v.dtype)
    return jnp.tensordot(match.T, weight * inputs_only, axes=1)


def collapse(
    network: Network,
    v: Float[Array, "vars *rows"],
    x: tuple[Float[Array, "_ *rows"], ...],
) -> Float[Array, "outputs monomials *rows"]:
    """G of every output: what multiplies each feedback monomial at each sample.

    `v` holds the scaled lagged variables behind a leading one, `x` the scheduling
    variables of every output in physical units.
    """
    lookup = np.zeros(len(network.variables) + 1, dtype=np.int64)
    for e, (row, _, _) in enumerate(fed_back(network.variables, network.signals)):
        lookup[row + 1] = e + 1
    table = monomials(network)
    return jnp.stack(
        [
            _collapse_one(model, lookup, table, v, x_o)
            for model, x_o in zip(network.models, x, strict=True)
        ]
    )


def collapsed_step(network: Network):
    """Step of the recursion on `G_t`: y = G_t . h(history)."""
    own = fed_back(network.variables, network.signals)
    output = np.array([o for _, o, _ in own], dtype=np.int64)
    lag = np.array([d for _, _, d in own], dtype=np.int64)
    return polynomial_step(monomials(network), output, lag, len(network.models))


def with_history(network: Network, v, x, history):
    """Lagged and scheduling variables with the fed-back ones taken from `history`.

    `history` is (outputs, depth, *rows), scaled; samples are trailing axes.
    """
    for row, o, d in fed_back(network.variables, network.signals):
        v = v.at[row + 1].set(history[o, d])
    out = []
    for model, x_o in zip(network.models, x, strict=True):
        for row, o, d in fed_back(model.scheduling, network.signals):
            x_o = x_o.at[row].set(history[o, d] * network.gain[network.signals[o]])
        out.append(x_o)
    return v, tuple(out)


def respond(
    network: Network,
    v: Float[Array, "vars *rows"],
    x: tuple[Float[Array, "_ *rows"], ...],
) -> Float[Array, "outputs *rows"]:
    """Scaled outputs from lagged and scheduling variables as they are."""
    return jnp.stack(
        [
            model(v, scheduling_values(model, x_o))
            for model, x_o in zip(network.models, x, strict=True)
        ]
    )


def sources(network: Network) -> Int[np.ndarray, " states"]:
    """The output that each entry of the loop's state is a value of.

    The outputs themselves, then the local models of those that have any with feedback
    of its own.
    """
    own = [[o] * len(m.own) for o, m in enumerate(network.models) if m.own is not None]
    return np.array([*range(len(network.models)), *itertools.chain(*own)], np.int64)


def widened(
    network: Network, values: Float[Array, "*rows outputs"]
) -> Float[Array, "*rows states"]:
    """What holds for the outputs, for every entry of the loop's state."""
    return values[..., sources(network)] if network.parallel else values


def folded(
    network: Network, a: Float[Array, "rows states states depth"]
) -> Float[Array, "rows states outputs depth"]:
    """Slopes by the measured past: all entries of one output start from the same."""
    if not network.parallel:
        return a
    of = sources(network)[:, None] == np.arange(len(network.models))[None]
    return jnp.einsum("tsid,io->tsod", a, jnp.asarray(of, a.dtype))


def own_rows(network: Network, output: int) -> list[tuple[int, int]]:
    """(row, lag - 1) of the variables that are lags of one output."""
    every = fed_back(network.variables, network.signals)
    return [(row, d) for row, o, d in every if o == output]


def with_own(network: Network, output: int, v: Array, history: Array) -> Array:
    """The variables as each local model sees them, (models, vars, *rows).

    `history` (models, depth, *rows) are the local models' own past outputs.
    """
    own = network.models[output].own
    assert own is not None

    def one(own, history):
        mine = v
        for row, d in own_rows(network, output):
            mine = mine.at[row + 1].set(jnp.where(own, history[d], v[row + 1]))
        return mine

    return jax.vmap(one)(own, history)


def places(network: Network) -> list[slice]:
    """Where the local models of every output stand in the loop's state."""
    size = [0 if m.own is None else len(m.own) for m in network.models]
    ends = np.cumsum([len(network.models), *size]).tolist()
    return [slice(a, b) for a, b in itertools.pairwise(ends)]


def advance(
    network: Network,
    v: Float[Array, "vars *rows"],
    x: tuple[Float[Array, "_ *rows"], ...],
    history: Float[Array, "states depth *rows"],
) -> Float[Array, "states *rows"]:
    """The next entry of the loop's state, not limited: outputs, then local models."""
    v, x = with_history(network, v, x, history)
    outputs, alone = [], []
    parts = zip(network.models, x, places(network), strict=True)
    for o, (model, x_o, at) in enumerate(parts):
        z = scheduling_values(model, x_o)
        if model.own is None:
            outputs.append(model(v, z))
            continue
        terms = jax.vmap(partial(evaluate, model.local.factor))(
            with_own(network, o, v, history[at])
        )
        local = jax.vmap(lambda a, b: jnp.tensordot(a, b, axes=1))(
            model.local.dense(), terms
        )
        outputs.append(jnp.sum(model.validity(z, model.active) * local, axis=0))
        alone.append(local)
    return jnp.concatenate([jnp.stack(outputs), *alone])


def general_step(network: Network):
    """Step of the recursion that evaluates the network; `params` is its arrays."""
    static = eqx.filter(network, eqx.is_array, inverse=True)

    def step(params, drive, history):
        v, x = drive
        return advance(eqx.combine(params, static), v, x, history)

    return step
