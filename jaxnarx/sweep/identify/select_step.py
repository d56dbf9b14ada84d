"""The selection inside the program: forward orthogonal least squares of one lane."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.selection import Program, make_lanes, path_of, search
from jaxnarx.settings import ForwardOLS
from jaxnarx.sweep.identify.settings import Settings
from jaxnarx.sweep.identify.shared_tables import Frame


class Chosen(eqx.Module):
    """Chosen terms in order: places in the pool, their ERR, and their factors.

    Slots past the count are not `used`; their factors mean nothing. `condition` is that
    of the scaled columns.
    """

    index: Int[Array, " slots"]
    used: Bool[Array, " slots"]
    err: Float[Array, " slots"]
    factor: Int[Array, "slots degree"]
    condition: Float[Array, ""]


def choose(
    frame: Frame,
    v: Float[Array, "vars rows"],
    y: Float[Array, " rows"],
    weight: Float[Array, " rows"],
    variables: Bool[Array, " vars"],
    settings: Settings,
) -> Chosen:
    """Choose among the terms of `variables`; the constant, where there is one, first.

    With the defaults of `ForwardOLS`.
    """
    first = [] if frame.constant is None else [frame.constant]
    lanes = make_lanes(
        v,
        y[None],
        weight[None],
        frame.factor,
        frame.position,
        jnp.asarray([first], int),
        jnp.asarray([len(first)]),
    )
    allowed = jnp.all(variables[frame.factor], axis=1) & settings.allowed
    basis, history, _ = search(
        v,
        lanes,
        frame.factor,
        frame.position,
        _program(allowed, settings, len(first)),
        max_terms=frame.slots,
        removes=False,
        exchanges=False,
    )
    path = jax.tree.map(lambda a: a[0], jax.vmap(path_of)(basis, lanes, history))
    used = jnp.arange(frame.slots) < path.count
    factor = frame.factor[path.index]
    return Chosen(path.index, used, path.err, factor, path.cond)


def _program(
    allowed: Bool[Array, " terms"], settings: Settings, started: int
) -> Program:
    """A forward search to the number of terms that the case asks for."""
    rho = jnp.asarray(settings.rho)
    zero = jnp.zeros_like(rho)
    return Program(
        stages=allowed[None],
        limits=(jnp.asarray(settings.terms) - started)[None],
        keep=jnp.zeros_like(allowed),
        rho=rho,
        tau=jnp.asarray(ForwardOLS().tau, rho.dtype),
        tau_absolute=zero,
        f_in=zero,
        f_out=zero,
        f_last=zero,
        rounds=jnp.asarray(0),
    )
