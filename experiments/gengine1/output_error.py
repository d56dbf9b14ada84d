"""Local models with common poles: least squares of the free run in closed form.

    A(q) y(t) = sum_m phi_m(z_t) sum_k theta[m, k] p_k(u_t) ,
    A(q) = prod_i (1 - exp(-T/tau_i) q^-1)

is a network whose local models share their feedback: the coefficients of y[t-1] and
y[t-2] are the same everywhere and the validities sum to one. With A given its free run
is linear in theta,

    y(t) = s(t) + sum_(m,k) theta[m, k] [phi_m p_k / A](t) ,

where s is what the measured start leaves behind. So the simulation error has its normal
equations, they add over records, and cross-validation over records costs one small
system a fold and no further pass over the data. A stable A makes a stable network. It
is the output-error model of Hammerstein type with several operating regions; O. Nelles,
Nonlinear System Identification, Springer 2001, sections 16.3 and 17.
"""

import dataclasses
import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
import scipy.signal
from jaxtyping import Array, Bool, Float, Int

import jaxnarx as jnx
from jaxnarx.data.batch import stack
from jaxnarx.models import (
    Gaussians,
    Network,
    assemble,
    local_models,
    output_model,
    scheduling_values,
)
from jaxnarx.regressors import Variables, evaluate, parse_variable
from jaxnarx.simulation import RunInputs, make_drive, make_masks


@dataclasses.dataclass(frozen=True)
class Boxes:
    """Boxes of the scheduling variables' range, which is the unit cube."""

    low: Float[np.ndarray, "models dims"]
    high: Float[np.ndarray, "models dims"]

    def halved(self, model: int, dim: int) -> "Boxes":
        """One box in two halves; the upper one comes last."""
        low, high = np.vstack([self.low, self.low[model]]), self.high.copy()
        low[-1, dim] = (low[model, dim] + high[model, dim]) / 2
        high = np.vstack([high, high[model]])
        high[model, dim] = low[-1, dim]
        return Boxes(low, high)

    def gaussians(self, share: Float[np.ndarray, " dims"]) -> Gaussians:
        """Middles as centres, a share of the extensions as widths."""
        width = share[None] * (self.high - self.low)
        return Gaussians(
            jnp.asarray((self.low + self.high) / 2), jnp.asarray(np.log(width))
        )


def whole(dims: int) -> Boxes:
    """One box."""
    return Boxes(np.zeros((1, dims)), np.ones((1, dims)))


def denominator(
    time_constants: Sequence[float], sample_time: float
) -> Float[np.ndarray, " _"]:
    """A(q) from its time constants [s], leading one included."""
    poles = np.exp(-sample_time / np.asarray(time_constants, float))
    return np.poly(poles)


def network(
    pool: jnx.Pool,
    data: jnx.Dataset,
    scheduling: Sequence[str],
    validity: Gaussians,
    a: Float[np.ndarray, " _"],
    theta: Float[np.ndarray, "models terms"] | None = None,
    *,
    sparse: bool = False,
) -> Network:
    """The network with feedback `a`; `theta` counts the terms without feedback.

    The pool's last variables must be the output at lags 1, 2, ... of `a`, each a term
    of its own, behind all others.
    """
    table = Variables.of([parse_variable(pool.channels, n) for n in scheduling])
    low, high = _range(data, table)
    models, own = validity.centre.shape[0], len(pool) - (len(a) - 1)
    theta = np.zeros((models, own)) if theta is None else theta
    every = np.concatenate([theta, np.tile(-a[1:], (models, 1))], axis=1)
    local = local_models(pool.factor, every, sparse=sparse)
    model = output_model(local, validity, table, low, high - low)
    return assemble(pool, data, np.ones(len(pool.channels.all)), [model])


def _range(data: jnx.Dataset, table: Variables):
    """Smallest and largest value of every scheduling variable's signal."""
    u = np.concatenate([r.u for r in data])[:, table.signal]
    return u.min(axis=0), u.max(axis=0)


@dataclasses.dataclass(frozen=True)
class Prepared:
    """What all structures over the same variables share: columns and masks."""

    drive: RunInputs
    start: Int[np.ndarray, " records"]
    scored: Bool[np.ndarray, "records time"]

    @classmethod
    def of(cls, network: Network, data: jnx.Dataset) -> "Prepared":
        """From any network with these variables and this scheduling."""
        batch = stack(data)
        masks = make_masks(network, batch)
        return cls(make_drive(network, batch), masks.start, masks.scored[..., 0])


@dataclasses.dataclass(frozen=True)
class Equations:
    """Normal equations of every record: C'C, C'e, e'e and the number of samples."""

    gram: Float[np.ndarray, "records n n"]
    right: Float[np.ndarray, "records n"]
    square: Float[np.ndarray, " records"]
    samples: Int[np.ndarray, " records"]

    def solve(
        self,
        rows: Bool[np.ndarray, " records"],
        ridge: float,
        chosen: Int[np.ndarray, " _"] | None = None,
    ) -> Float[np.ndarray, " n"]:
        """Ridge regression on these records with columns of unit mean square."""
        gram, right = self._scaled(rows)
        at = np.arange(len(right)) if chosen is None else chosen
        size = self._size(rows)
        system = gram[np.ix_(at, at)] + ridge * np.eye(len(at))
        theta = np.zeros(len(right))
        theta[at] = scipy.linalg.solve(system, right[at], assume_a="pos") / size[at]
        return theta

    def loss(self, rows, theta: Float[np.ndarray, " n"]) -> float:
        """Sum of squared errors on these records."""
        square = np.einsum("rij,i,j->r", self.gram[rows], theta, theta)
        error = self.square[rows] - 2 * self.right[rows] @ theta + square
        return float(error.sum())

    def forward(
        self, rows: Bool[np.ndarray, " records"], ridge: float, size: int, first
    ) -> Int[np.ndarray, " _"]:
        """Columns by error reduction, those of `first` before all others.

        Forward orthogonal least squares on the normal equations (Chen, Billings, Luo
        1989) with the ridge inside. Columns without power are passed over.
        """
        gram, right = self._scaled(rows)
        gram = gram + ridge * np.eye(len(right))
        free = np.diagonal(gram) > 0.5
        order: list[int] = []
        while len(order) < min(size, int(free.sum()) + len(order)):
            power = np.diagonal(gram)
            usable = free & (power > 1e-7)
            gain = np.where(usable, right**2 / np.where(usable, power, 1.0), -1.0)
            j = first[len(order)] if len(order) < len(first) else int(gain.argmax())
            order.append(j)
            free[j] = False
            share = gram[:, j] / gram[j, j]
            right = right - share * right[j]
            gram = gram - np.outer(share, gram[j])
        return np.array(order)

    def _size(self, rows) -> Float[np.ndarray, " n"]:
        """Root mean square of every column; one where it is zero."""
        power = np.einsum("rii->i", self.gram[rows]) / self.samples[rows].sum()
        return np.sqrt(np.where(power > 1e-12, power, 1.0))

    def _scaled(self, rows):
        size, count = self._size(rows), self.samples[rows].sum()
        gram = self.gram[rows].sum(axis=0) / count
        right = self.right[rows].sum(axis=0) / count
        return gram / np.outer(size, size), right / size


@functools.partial(jax.jit, static_argnames="degree")
def _columns(
    validity: Gaussians,
    factor: Int[Array, "terms degree"],
    v: Float[Array, "vars time"],
    z: Float[Array, "dims time"],
    degree: int,
) -> Float[Array, "columns time"]:
    """phi_m p_k, models first."""
    phi = validity(z, jnp.ones(validity.centre.shape[0], bool))
    return (phi[:, None] * evaluate(factor[:, :degree], v)[None]).reshape(
        -1, v.shape[1]
    )


def equations(
    network: Network, prepared: Prepared, a: Float[np.ndarray, " _"], *, thin: int
) -> Equations:
    """Normal equations of the free run by theta, every `thin`-th sample counted."""
    (model,) = network.models
    own = network.models[0].local.factor[: -(len(a) - 1)]
    parts = []
    for n, start in enumerate(prepared.start):
        z = scheduling_values(model, prepared.drive.x[0][n])
        columns = np.asarray(
            _columns(model.validity, own, prepared.drive.v[n], z, own.shape[1])
        )
        y = np.asarray(prepared.drive.measured[n, :, 0])
        parts.append(_record(columns, y, int(start), a, prepared.scored[n], thin))
    return Equations(*map(np.array, zip(*parts, strict=True)))


def _record(columns, y, start: int, a, scored, thin: int):
    """One record: what is left of the start is taken off, the columns are filtered."""
    at = np.flatnonzero(scored[start:])[::thin]
    state = scipy.signal.lfiltic([1.0], a, y[start - len(a) + 1 : start][::-1])
    rest, _ = scipy.signal.lfilter([1.0], a, np.zeros(len(y) - start), zi=state)
    error = (y[start:] - rest)[at]
    moved = np.asarray(scipy.signal.lfilter([1.0], a, columns[:, start:], axis=1))
    moved = moved[:, at]
    return moved @ moved.T, moved @ error, error @ error, len(at)


def cross_validated(
    found: Equations,
    dealings: Sequence[Int[np.ndarray, " records"]],
    ridge: float,
    sizes: Sequence[int] = (),
    first: Sequence[int] = (),
) -> Float[np.ndarray, " _"]:
    """Root mean square error of records left out, over all dealings into groups.

    One figure a size, the columns chosen anew without the records left out; without
    sizes one figure, with all columns.
    """
    total = np.zeros(max(len(sizes), 1))
    for groups in dealings:
        for group in np.unique(groups):
            rows = groups != group
            order = None
            if sizes:
                order = found.forward(rows, ridge, max(sizes), first)
            for n, size in enumerate(sizes or (None,)):
                chosen = None if order is None else order[:size]
                theta = found.solve(rows, ridge, chosen)
                total[n] += found.loss(~rows, theta)
    return np.sqrt(np.maximum(total, 0.0) / (len(dealings) * found.samples.sum()))
