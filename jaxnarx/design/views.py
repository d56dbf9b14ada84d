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

import dataclasses
from collections.abc import Callable
from itertools import combinations_with_replacement
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxnarx.design.sensitivity import NetworkSensitivity, rest_run, run_sensitivity
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


class AlongCoefficients(eqx.Module):
    """A network moved along directions of its coefficients."""

    sensitivity: NetworkSensitivity
    directions: Float[Array, "params directions"]

    def __call__(self, w: Float[Array, " directions"]) -> Network:
        """The network so far along every direction."""
        sensitivity = self.sensitivity
        return sensitivity.place(sensitivity.parameters + self.directions @ w)


class View(eqx.Module):
    """A network with all that its tests are judged by; see the module.

    `along` moves the network by unknowns of unit variance, `directions` of them;
    `noise` is the standard deviation of a row, in physical units. `factors` are the
    terms of the error that the network does not express: none where that is not asked.
    """

    network: Network
    along: Callable[[Float[Array, " directions"]], Network]
    directions: int = eqx.field(static=True)
    noise: Float[Array, " outputs"]
    domain: Domain
    table: Variables = eqx.field(static=True)
    middle: Float[Array, " features"]
    half: Float[Array, " features"]
    factors: tuple[tuple[int, ...], ...] = eqx.field(static=True)

    @property
    def unknowns(self) -> tuple[int, ...]:
        """How many unknowns of every kind."""
        return self.directions, *((len(self.factors),) if self.factors else ())

    def view_from_rest(self, u: Float[Array, "time inputs"]) -> Seen:
        """The view of a test that begins at rest."""
        y = rest_run(self.network, u, 0) * _gain(self.network)[None]
        return Seen(y, self.features(u), self.index(u))

    def features(self, u: Float[Array, "time inputs"]) -> Float[Array, "features time"]:
        """The features of the domain."""
        at, time = jnp.arange(u.shape[0]), self.network.sample_time
        return record_columns(u, None, at, self.domain.features, time)

    def index(self, u: Float[Array, "time inputs"]) -> Float[Array, " time"]:
        """Index of the domain, one at its border."""
        return self.domain.index(u, self.network.sample_time)

    def slopes(
        self, u: Float[Array, "time inputs"], at: Int[Array, " rows"]
    ) -> Float[Array, "outputrows directions"]:
        """Rows of the coefficients at some samples, from a free run."""

        def run(w):
            return rest_run(self.along(w), u, 0)[at]

        zero = jnp.zeros(self.directions, self.noise.dtype)
        size = _gain(self.network) / self.noise
        rows = jax.jacfwd(run)(zero) * size[None, :, None]
        return rows.reshape(-1, rows.shape[-1])

    def rows(
        self, u: Float[Array, "time inputs"], at: Int[Array, " rows"]
    ) -> tuple[Float[Array, "_ _"], ...]:
        """Rows of all kinds of unknowns at some samples."""
        found = self.slopes(u, at)
        return (found, self.errors(u, at)) if self.factors else (found,)

    def errors(
        self, u: Float[Array, "time inputs"], at: Int[Array, " rows"]
    ) -> Float[Array, "rows terms"]:
        """Rows of the error at some samples."""
        time = self.network.sample_time
        z = record_columns(u, None, at, self.table, time) - self.middle[:, None]
        z = z / self.half[:, None]
        v = jnp.concatenate([jnp.ones_like(z[:1]), z])
        terms = jnp.prod(v[np.array(self.factors)], axis=1)
        return (
            terms * jnp.clip(self.index(u)[at], *ERROR_SIZE_RANGE)[None] / ROW_NOISE
        ).T


def _factors(inputs: int) -> tuple[tuple[int, ...], ...]:
    """Rows of the terms into one, inputs, slow inputs: squares of all, cubes of the
    inputs."""
    rows = list(combinations_with_replacement(range(1 + 2 * inputs), 2))
    rows = [(0, *row) for row in rows]
    if inputs <= CUBIC_INPUTS:
        rows += list(combinations_with_replacement(range(1, 1 + inputs), 3))
    return tuple(rows)


def _gain(network: Network) -> Float[Array, " outputs"]:
    """Gains that bring computed outputs to physical units."""
    return network.gain[np.array(network.signals[: len(network.modelled)])]


def network_view(
    network: Network,
    space: Space,
    reference: Float[np.ndarray, "time inputs"],
    lead: int,
) -> View:
    """The view of what a network does not know of itself: its coefficients, by the
    directions that its free run follows most under a `reference` of the space, and an
    error that it cannot express."""
    sensitivity = run_sensitivity(network, lead)
    slope, y = map(np.asarray, _slopes(sensitivity, jax.device_put(reference)))
    spread = np.where(np.isfinite(y).all(axis=0), y.std(axis=0), 0.0)
    spread = np.where(spread > 0, spread, 1.0)
    rows = (slope / spread[None, :, None]).reshape(-1, slope.shape[-1])
    rows = rows[np.isfinite(rows).all(axis=1)]
    _, size, right = np.linalg.svd(rows, full_matrices=False)
    kept = (size > WEAKEST_SHARE * size[0])[:MAX_DIRECTIONS]
    size, right = size[:MAX_DIRECTIONS][kept], right[:MAX_DIRECTIONS][kept]
    along = right.T * np.sqrt(len(rows)) / size[None]
    moved = AlongCoefficients(run_sensitivity(network, 0), jax.device_put(along))
    view = make_view(network, moved, along.shape[1], ROW_NOISE * spread, space)
    return dataclasses.replace(view, factors=_factors(len(space.low)))


def make_view(
    network: Network,
    along: Callable[[Float[Array, " directions"]], Network],
    directions: int,
    noise: Float[np.ndarray, " outputs"],
    space: Space,
) -> View:
    """The view of what is not known along some directions, and of nothing else."""
    assert network.domain is not None
    slow = next(f for *_, f in network.domain.features.entries if f is not None)
    table = Variables.of(
        [(s, 0, f) for f in (None, slow) for s in range(len(space.low))]
    )
    half = 0.5 * (space.high - space.low)
    middle = np.tile(0.5 * (space.high + space.low), 2)
    half = np.tile(np.where(half > 0, half, 1.0), 2)
    size, middle, half = jax.device_put((noise, middle, half))
    return View(
        network, along, directions, size, network.domain, table, middle, half, ()
    )


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
        rows = view.rows(u, at)
        return tuple(map(information_gain, lower, rows)), rows

    return jax.lax.map(one, u, batch_size=16)


def information_gain(
    lower: Float[Array, "unknowns unknowns"], rows: Float[Array, "rows unknowns"]
) -> Float[Array, ""]:
    """log det(1 + R (L L')^-1 R'): what rows add to log det L L'."""
    white = jax.scipy.linalg.solve_triangular(lower, rows.T, lower=True)
    gram = white.T @ white + jnp.eye(rows.shape[0], dtype=rows.dtype)
    return jnp.linalg.slogdet(gram)[1]
