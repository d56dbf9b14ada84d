"""The result of a search: the chosen terms in order, statistics of every nested
size."""

import dataclasses
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy.linalg
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.selection.basis import Basis, Lane


class PartialFHistory(eqx.Module):
    """Partial F of every term in the model after each round, thesis Table 5.2.

    Row r lists the terms in order of entry; `f` is NaN-free: unused slots hold 0.
    """

    term: Int[Array, "*lanes rounds slots"]
    used: Bool[Array, "*lanes rounds slots"]
    f: Float[Array, "*lanes rounds slots"]
    rounds: Int[Array, "*lanes"]

    @staticmethod
    def empty(rounds: int, slots: int, dtype) -> "PartialFHistory":
        """Room for `rounds` rows."""
        shape = (rounds, slots)
        return PartialFHistory(
            jnp.zeros(shape, int),
            jnp.zeros(shape, bool),
            jnp.zeros(shape, dtype),
            jnp.asarray(0),
        )

    def append(
        self, basis: Basis, f: Float[Array, " slots"], wanted: Bool[Array, ""]
    ) -> "PartialFHistory":
        """The history with one more row where `wanted`."""
        row = jnp.where(wanted, self.rounds, self.term.shape[0])
        return PartialFHistory(
            self.term.at[row].set(basis.index, mode="drop"),
            self.used.at[row].set(basis.used, mode="drop"),
            self.f.at[row].set(jnp.where(basis.used, f, 0.0), mode="drop"),
            self.rounds + wanted.astype(self.rounds.dtype),
        )


class Path(eqx.Module):
    """Chosen terms in order, and the nested models of the first 1, 2, ... of them.

    `err` are shares of `power`, the weighted <y, y>; `sse` and `press` (prediction sum
    of squares, each sample left out) belong to the nested models, `nested` and `errors`
    hold their coefficients and standard errors row by row, `cond` is the condition of
    all chosen columns, scaled to unit norm. Slots past `count` hold zeros, `sse` and
    `press` repeat.
    """

    index: Int[Array, "*lanes slots"]
    count: Int[Array, "*lanes"]
    power: Float[Array, "*lanes"]
    samples: Float[Array, "*lanes"]
    err: Float[Array, "*lanes slots"]
    sse: Float[Array, "*lanes slots"]
    press: Float[Array, "*lanes slots"]
    nested: Float[Array, "*lanes slots slots"]
    errors: Float[Array, "*lanes slots slots"]
    cond: Float[Array, "*lanes"]
    history: PartialFHistory


def path_of(
    basis: Basis,
    lane: Lane,
    history: PartialFHistory,
    back: Float[Array, "slots slots"] | None = None,
) -> Path:
    """Compute coefficients, standard errors and criteria of all nested models of a
    search.

    `back` makes the chosen columns of others, P; coefficients and their standard errors
    are then those of P. Row n may hold the columns up to the n-th.
    """
    used = basis.used
    both = used[:, None] & used[None]
    small, r = jnp.linalg.qr(basis.matrix)
    gain = jnp.where(used, small.T @ basis.gain, 0.0)
    inverse = jax.scipy.linalg.solve_triangular(r, jnp.eye(r.shape[0], dtype=r.dtype))
    if back is not None:
        inverse = back.T @ inverse
    sse, press = _nested_errors(basis, lane, small, gain)
    # Of R^-1 the model of the first n terms needs the first n columns.
    nested = jnp.cumsum(inverse * gain[None], axis=1).T
    sizes = jnp.arange(1, len(gain) + 1, dtype=gain.dtype)
    spare = jnp.maximum(lane.samples - sizes, 1.0)
    errors = jnp.sqrt(jnp.cumsum(inverse**2, axis=1).T * (sse / spare)[:, None])
    power = jnp.where(lane.power > 0, lane.power, 1.0)
    norm = jnp.sqrt(jnp.sum(r**2, axis=0))
    singular = jnp.linalg.svd(r / norm[None], compute_uv=False)
    return Path(
        index=basis.index,
        count=basis.count,
        power=lane.power,
        samples=lane.samples,
        err=gain**2 / power,
        sse=sse,
        press=press,
        nested=jnp.where(jnp.tril(both), nested, 0.0),
        errors=jnp.where(jnp.tril(both), errors, 0.0),
        cond=singular[0] / singular[-1],
        history=history,
    )


def _nested_errors(basis: Basis, lane: Lane, small, gain):
    """Squared errors and PRESS of every size, from residuals and leverages.

    A sample left out leaves the error e / (1 - h); a leverage h of one has no such
    error, and counts with what rounding makes of it.
    """
    tiny = jnp.finfo(gain.dtype).eps

    def one(carry, turn):
        residual, leverage = carry
        weights, g = turn
        q = weights @ basis.direction
        residual, leverage = residual - g * q, leverage + q**2
        left_out = residual / jnp.maximum(1.0 - leverage, tiny)
        return (residual, leverage), (residual @ residual, left_out @ left_out)

    start = (lane.target, jnp.zeros_like(lane.target))
    return jax.lax.scan(
        one, start, (jnp.where(basis.used[:, None], small.T, 0.0), gain)
    )[1]


def resize(path: Path, slots: int) -> Path:
    """Make room for `slots` terms, at least those that are chosen."""

    def fit(
        array: Array, axes: int = 1, mode: Literal["constant", "edge"] = "constant"
    ) -> Array:
        kept = np.asarray(array)[(..., *[slice(slots)] * axes)]
        more = [(0, 0)] * (kept.ndim - axes)
        more += [(0, slots - size) for size in kept.shape[-axes:]]
        return jax.device_put(np.pad(kept, more, mode=mode))

    return dataclasses.replace(
        path,
        index=fit(path.index),
        err=fit(path.err),
        sse=fit(path.sse, mode="edge"),
        press=fit(path.press, mode="edge"),
        nested=fit(path.nested, 2),
        errors=fit(path.errors, 2),
        history=dataclasses.replace(
            path.history,
            term=fit(path.history.term),
            used=fit(path.history.used),
            f=fit(path.history.f),
        ),
    )
