"""A network's view of a test before it is run: outputs, index, information.

The information of a test is twofold. About the coefficients: derivatives of the free
run along the directions of the coefficients that it follows most over the allowed
space. About what the network does not express yet: an error that is a polynomial of the
inputs z, and of the same as slow as the memory of the network, from -1 to 1 in the
allowed ranges,

    e(t) = a(t) (w + sum_i w_i z_i + sum_ij w_ij z_i z_j + sum_ijk w_ijk z_i z_j z_k) ,

of third degree in the inputs themselves, larger where the index a of the domain is, up
to a limit. With rows R of both, linear in unknowns of unit variance, over the standard
deviation of the noise, a test tells log det(1 + R'R).

Linear model and a smooth error beside it: M. C. Kennedy and A. O'Hagan, Journal of the
Royal Statistical Society B 63, 2001; designs for both: W. J. Welch, Technometrics 25,
1983.
"""

from itertools import combinations_with_replacement
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxnarx.design.sensitivity import NetworkSensitivity, rest_run
from jaxnarx.design.stretches import Space
from jaxnarx.models import Domain, Network
from jaxnarx.regressors import Variables, record_columns

MAX_DIRECTIONS = 40
"""Most directions of the coefficients."""
WEAKEST_SHARE = 1e-4
"""Directions whose outputs are smaller than this share of the largest are left out."""
ROW_NOISE = 0.1
"""Standard deviation of a row's noise, in that of the outputs over the space: what is
left of both kinds of unknowns where a test has been once."""
ERROR_SIZE_RANGE = 0.5, 2.0
"""Least and largest size of the error: the index between."""
CUBIC_INPUTS = 8
"""Most inputs for which the error has terms of third degree."""


class Seen(NamedTuple):
    """Samples of tests, on the host or not: `y` (*tests, time, outputs) in physical
    units, `x` (*tests, features, time) of the domain, `far` (*tests, time) its index.
    """

    y: Any
    x: Any
    far: Any


class View(eqx.Module):
    """A network with all that its tests are judged by; see the module."""

    sensitivity: NetworkSensitivity
    domain: Domain
    table: Variables = eqx.field(static=True)
    directions: Float[Array, "params directions"]
    spread: Float[Array, " outputs"]
    middle: Float[Array, " features"]
    half: Float[Array, " features"]

    @property
    def terms(self) -> int:
        """The terms of the error."""
        return len(_factors(len(self.table) // 2))

    def view_from_rest(self, u: Float[Array, "time inputs"]) -> Seen:
        """The view of a test that begins at rest."""
        network = self.sensitivity.network
        y = rest_run(network, u, self.sensitivity.lead) * _gain(network)[None]
        return Seen(y, self.features(u), self.index(u))

    def features(self, u: Float[Array, "time inputs"]) -> Float[Array, "features time"]:
        """The features of the domain."""
        at, time = jnp.arange(u.shape[0]), self.sensitivity.network.sample_time
        return record_columns(u, None, at, self.domain.features, time)

    def index(self, u: Float[Array, "time inputs"]) -> Float[Array, " time"]:
        """Index of the domain, one at its border."""
        own = u[:, np.array(self.domain.inputs)]
        step = jnp.diff(own, axis=0, prepend=own[:1]).T
        return self.domain.layers(self.features(u), step)[0].max(axis=1)

    def slopes(
        self, u: Float[Array, "time inputs"], at: Int[Array, " rows"]
    ) -> Float[Array, "outputrows directions"]:
        """Rows of the coefficients at some samples, from a free run."""
        network, p = self.sensitivity.network, self.sensitivity.parameters

        def run(w):
            moved = self.sensitivity.place(p + self.directions @ w)
            return rest_run(moved, u, self.sensitivity.lead)[at]

        zero = jnp.zeros(self.directions.shape[1], p.dtype)
        size = _gain(network) / (self.spread * ROW_NOISE)
        rows = jax.jacfwd(run)(zero) * size[None, :, None]
        return rows.reshape(-1, rows.shape[-1])

    def errors(
        self, u: Float[Array, "time inputs"], at: Int[Array, " rows"]
    ) -> Float[Array, "rows terms"]:
        """Rows of the error at some samples."""
        time = self.sensitivity.network.sample_time
        z = record_columns(u, None, at, self.table, time) - self.middle[:, None]
        z = z / self.half[:, None]
        v = jnp.concatenate([jnp.ones_like(z[:1]), z])
        terms = jnp.prod(v[_factors(len(self.table) // 2)], axis=1)
        return (
            terms * jnp.clip(self.index(u)[at], *ERROR_SIZE_RANGE)[None] / ROW_NOISE
        ).T


def _factors(inputs: int) -> Int[np.ndarray, "terms degree"]:
    """Rows of the terms into one, inputs, slow inputs: squares of all, cubes of the
    inputs."""
    rows = list(combinations_with_replacement(range(1 + 2 * inputs), 2))
    rows = [(0, *row) for row in rows]
    if inputs <= CUBIC_INPUTS:
        rows += list(combinations_with_replacement(range(1, 1 + inputs), 3))
    return np.array(rows)


def _gain(network: Network) -> Float[Array, " outputs"]:
    """Gains that bring computed outputs to physical units."""
    return network.gain[np.array(network.signals[: len(network.modelled)])]


def make_view(
    sensitivity: NetworkSensitivity,
    space: Space,
    reference: Float[np.ndarray, "time inputs"],
) -> View:
    """The view, its directions by the free run under a `reference` of the space."""
    network = sensitivity.network
    assert network.domain is not None
    slope, y = map(np.asarray, _slopes(sensitivity, jax.device_put(reference)))
    spread = np.where(np.isfinite(y).all(axis=0), y.std(axis=0), 0.0)
    spread = np.where(spread > 0, spread, 1.0)
    rows = (slope / spread[None, :, None]).reshape(-1, slope.shape[-1])
    rows = rows[np.isfinite(rows).all(axis=1)]
    _, size, right = np.linalg.svd(rows, full_matrices=False)
    kept = (size > WEAKEST_SHARE * size[0])[:MAX_DIRECTIONS]
    size, right = size[:MAX_DIRECTIONS][kept], right[:MAX_DIRECTIONS][kept]
    inputs = range(len(space.low))
    slow = next(f for *_, f in network.domain.features.entries if f is not None)
    table = [(s, 0, f) for f in (None, slow) for s in inputs]
    half = 0.5 * (space.high - space.low)
    leaves = (
        right.T * np.sqrt(len(rows)) / size[None],
        spread,
        np.tile(0.5 * (space.high + space.low), 2),
        np.tile(np.where(half > 0, half, 1.0), 2),
    )
    table = Variables.of(table)
    return View(sensitivity, network.domain, table, *jax.device_put(leaves))


@eqx.filter_jit
def _slopes(sensitivity: NetworkSensitivity, u: Float[Array, "time inputs"]):
    """Derivative by all coefficients, and the run; physical units."""
    gain = _gain(sensitivity.network)

    def run(p):
        y = rest_run(sensitivity.place(p), u, sensitivity.lead) * gain[None]
        return y, y

    return jax.jacfwd(run, has_aux=True)(sensitivity.parameters)


@eqx.filter_jit
def watch(view: View, u: Float[Array, "tests time inputs"]) -> Seen:
    """Outputs, features and index of tests."""
    return jax.vmap(view.view_from_rest)(u)


@eqx.filter_jit
def gains(
    view: View,
    lower: tuple[Float[Array, "_ _"], ...],
    u: Float[Array, "tests time inputs"],
    at: Int[Array, " rows"],
):
    """The gain of every test beyond information L L', by kind, and its rows."""

    def one(u):
        rows = view.slopes(u, at), view.errors(u, at)
        return tuple(map(information_gain, lower, rows)), rows

    return jax.lax.map(one, u, batch_size=16)


def information_gain(
    lower: Float[Array, "unknowns unknowns"], rows: Float[Array, "rows unknowns"]
) -> Float[Array, ""]:
    """log det(1 + R (L L')^-1 R'): what rows add to log det L L'."""
    white = jax.scipy.linalg.solve_triangular(lower, rows.T, lower=True)
    gram = white.T @ white + jnp.eye(rows.shape[0], dtype=rows.dtype)
    return jnp.linalg.slogdet(gram)[1]
