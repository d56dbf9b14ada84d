"""Partitions that are given: grids, borders, centres, and those of a network."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxnarx.errors import SpecError
from jaxnarx.models import (
    AbstractValidity,
    Gaussians,
    LogSigmoids,
    OutputModel,
    count_models,
)
from jaxnarx.partition._lolimot import validity_of_boxes
from jaxnarx.partition.local_fit import local_fit
from jaxnarx.partition.local_terms import own_terms
from jaxnarx.partition.training_rows import TrainingRows
from jaxnarx.settings import Given, Grid

BORDER_SHARPNESS = 5.0
"""Steepness of log-sigmoids times the distance between borders: at the middle of a
region its model weighs 0.85."""

_fit = jax.jit(local_fit)


def grid_output(
    training: TrainingRows, output: int, method: Grid
) -> tuple[OutputModel, list[int]]:
    """The model of one output, and which local models lack samples."""
    validity = validity_of_grid(training, method)
    return fit_regions(
        training, output, validity, count_models(validity, len(training.z)), method
    )


def fit_regions(
    training: TrainingRows,
    output: int,
    validity: AbstractValidity,
    count: int,
    method: Grid | Given,
) -> tuple[OutputModel, list[int]]:
    """Local models of the first `count` regions, and which of them lack samples.

    A local model whose validity sums to less than its number of parameters keeps the
    coefficients of the global model.
    """
    room = count_models(validity, len(training.z))
    phi = validity(training.z, jnp.arange(room) < count)[:count]
    weight = training.weight(output)
    mass = np.asarray(jnp.sum(jnp.where(weight[None] > 0, phi, 0.0), axis=1))
    p, y = training.columns(output)
    ridge = jnp.asarray(method.ridge, p.dtype)
    everywhere = _fit(p, y, weight, prior=jnp.zeros(len(p), p.dtype), ridge=0.0 * ridge)
    whole = training.coefficients(output, everywhere)
    if method.local is not None:
        need = min(method.local.max_terms, len(p))
        theta = own_terms(training, output, phi, method.local)
    else:
        need = len(p)
        fits = [_fit(p, y, w * weight, prior=everywhere, ridge=ridge) for w in phi]
        theta = training.coefficients(output, jnp.stack(fits))
    poor = np.flatnonzero(mass < need).tolist()
    theta = np.where((mass < need)[:, None], whole[None], theta)
    theta = np.pad(theta, ((0, room - count), (0, 0)))
    sparse = method.local is not None
    return training.model(output, theta, validity, count, sparse=sparse), poor


def validity_of_grid(training: TrainingRows, method: Grid) -> AbstractValidity:
    """Validity functions of a grid in scaled scheduling variables."""
    if method.validity == "log-sigmoids":
        return _log_sigmoids(training, method)
    if method.centres:
        return _gaussians(training, method)
    low, high = _boxes(_borders(training, method))
    dtype = training.z.dtype
    low, high = jnp.asarray(low, dtype), jnp.asarray(high, dtype)
    return validity_of_boxes(method.validity, low, high, method.k_sigma)


def _borders(training: TrainingRows, method: Grid) -> list[Float[np.ndarray, " _"]]:
    """Inner borders along every variable, scaled."""
    if method.models:
        return [np.linspace(0, 1, n + 1)[1:-1] for n in method.models]
    out = []
    rows = zip(
        method.borders, training.names, training.offset, training.span, strict=True
    )
    for row, name, offset, span in rows:
        scaled = (np.asarray(row, float) - offset) / span
        if np.any((scaled <= 0) | (scaled >= 1)):
            raise SpecError(
                f"a border of {name} lies outside its range in the data, {offset:g} to "
                f"{offset + span:g}: {list(row)}",
                field="borders",
            )
        out.append(scaled)
    return out


def _boxes(borders: list[Float[np.ndarray, " _"]]):
    ends = [np.concatenate([[0.0], b, [1.0]]) for b in borders]
    low = np.array(list(itertools.product(*(e[:-1] for e in ends))))
    return low, np.array(list(itertools.product(*(e[1:] for e in ends))))


def _centres(training: TrainingRows, method: Grid) -> Float[np.ndarray, "models dims"]:
    return (np.asarray(method.centres, float) - training.offset) / training.span


def _gaussians(training: TrainingRows, method: Grid) -> Gaussians:
    centre = _centres(training, method)
    if method.widths:
        width = np.asarray(method.widths, float) / training.span
    else:
        apart = np.linalg.norm(centre[:, None] - centre[None], axis=2)
        np.fill_diagonal(apart, np.inf)
        nearest = apart.min(axis=1) if len(centre) > 1 else np.ones(1)
        width = np.broadcast_to(method.k_sigma * nearest[:, None], centre.shape)
    dtype = training.z.dtype
    return Gaussians(jnp.asarray(centre, dtype), jnp.asarray(np.log(width), dtype))


def _log_sigmoids(training: TrainingRows, method: Grid) -> LogSigmoids:
    if method.centres:
        centre = np.sort(_centres(training, method)[:, 0])
        border: Array | np.ndarray = (centre[1:] + centre[:-1]) / 2
    else:
        (border,) = _borders(training, method)
    apart = float(np.mean(np.diff(border))) if len(border) > 1 else 0.5
    steepness = BORDER_SHARPNESS / apart
    if method.steepness is not None:
        steepness = float(method.steepness * training.span[0])
    dtype = training.z.dtype
    return LogSigmoids(
        jnp.asarray(border, dtype), jnp.log(jnp.asarray(steepness, dtype))
    )
