"""Donors that are unlike the others: found, named, and left out of the population.

A donor is broken where what its own coefficients leave of an output is much more, or
much less, than of other donors, or where its coefficients lie far from theirs: by their
Mahalanobis distance under the population,

    d^2 = (u - mu)' (G^-1 + Sigma)^-1 (u - mu) ,

u the least-squares estimate and G its information, over the number of directions that
the donor tells of. Both are judged on a logarithmic scale by median and median absolute
deviation, so that the broken ones do not set the measure. Population and search take
turns.
"""

import dataclasses
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.arrays import program
from jaxnarx.fleet.information import Information
from jaxnarx.fleet.population import (
    DonorChunk,
    Population,
    begin_population,
    expect,
    fit_population,
    root_of,
)

FAR_DEVIATIONS = 6.0
"""Robust standard deviations from which a donor is broken."""
ROUGH_DEVIATIONS = 10.0
"""The same for single coefficients before there is a population."""
MAD_SHARE = 1.4826
"""Standard deviation over median absolute deviation of normal numbers."""
LEAST_SPREAD = 0.15
"""Spread of a logarithm that donors have at least."""
ROUNDS = 4
"""Turns of population and search at most."""
FEWEST_DONORS = 8
"""Donors below which none is called unlike the others."""
RANK_SHARE = 1e-8
"""Share of the largest eigenvalue from which a direction is told of."""


@dataclasses.dataclass(frozen=True, eq=False)
class Screened:
    """A population, its donors' figures, and what is wrong with those not used."""

    population: Population
    estimate: Float[np.ndarray, "donors params"]
    distance: Float[np.ndarray, " donors"]
    freedom: Float[np.ndarray, " donors"]
    used: Bool[np.ndarray, " donors"]
    remark: dict[int, str]


def find_broken(
    sums_of: Callable[[np.ndarray], Sequence[DonorChunk]],
    there: Bool[np.ndarray, " donors"],
    output_names: list[str],
    colour: Float[np.ndarray, " outputs"],
) -> Screened:
    """Population and broken donors, from the sums of all with given weights.

    `there` are those that have samples; the others are not used either way. `colour` is
    that of the residuals, see `Population`.
    """
    count = len(there)
    chunks = sums_of(there.astype(float))
    start = begin_population(*_joined(chunks, there), colour)
    wide = dataclasses.replace(start, covariance=jnp.eye(len(start.mean)))
    root = root_of(np.asarray(wide.covariance))
    rough = [expect(*chunk, wide, root) for chunk in chunks]
    estimate = np.concatenate([np.asarray(f.mean) for f in rough])[:count]
    left = np.concatenate([np.asarray(f.left) for f in rough])[:count]
    far = np.abs(deviations(estimate, there, 1e-3)).max(axis=1)
    remark = _judge_left(left, there, output_names)
    for n in np.flatnonzero((far > ROUGH_DEVIATIONS) & there).tolist():
        remark.setdefault(n, "its coefficients are far from those of all others")
    if there.sum() < FEWEST_DONORS:
        remark = {}
    used = _without(there, remark)
    population = start
    distance, freedom = np.zeros(count), np.zeros(count)
    for _ in range(ROUNDS):
        chunks = sums_of(used.astype(float))
        population, estimate, left = fit_population(chunks, population)
        estimate, left = estimate[:count], left[:count]
        distance, freedom = _distances(chunks, population, count)
        if there.sum() < FEWEST_DONORS:
            break
        remark = _judge_left(left, used, output_names, there)
        ratio = np.log(np.maximum(distance**2, 1e-12) / np.maximum(freedom, 1.0))
        score = deviations(ratio[:, None], used, LEAST_SPREAD)[:, 0]
        for n in np.flatnonzero((score > FAR_DEVIATIONS) & there).tolist():
            text = f"{distance[n]:.0f} deviations from the others, expected about "
            remark.setdefault(n, text + f"{np.sqrt(freedom[n]):.0f}")
        now = _without(there, remark)
        if np.array_equal(now, used):
            break
        used = now
    return Screened(population, estimate, distance, freedom, used, remark)


def _without(there: np.ndarray, remark: dict[int, str]) -> np.ndarray:
    used = there.copy()
    used[list(remark)] = False
    return used if used.any() else there


def _joined(
    chunks: Sequence[DonorChunk], there: np.ndarray
) -> tuple[Information, np.ndarray]:
    """Sums of all donors that have samples, without their products."""
    count = len(there)
    square, samples = (
        np.concatenate([np.asarray(c[0][k]) for c in chunks])[:count][there]
        for k in (0, 3)
    )
    at = np.concatenate([c[1] for c in chunks])[:count][there]
    first = chunks[0][0]
    return Information(square, first.right, first.gram, samples), at


def deviations(
    values: Float[np.ndarray, "donors columns"],
    among: Bool[np.ndarray, " donors"],
    least: float,
) -> Float[np.ndarray, "donors columns"]:
    """Distances from the median in robust standard deviations."""
    middle = np.median(values[among], axis=0)
    spread = MAD_SHARE * np.median(np.abs(values[among] - middle), axis=0)
    return (values - middle) / np.maximum(spread, least)


def _judge_left(
    left: Float[np.ndarray, "donors outputs"],
    among: Bool[np.ndarray, " donors"],
    output_names: list[str],
    there: Bool[np.ndarray, " donors"] | None = None,
) -> dict[int, str]:
    """Donors of which too much, or too little, of an output is left."""
    there = among if there is None else there
    size = np.log(np.maximum(left, 1e-300))
    score = deviations(size, among, LEAST_SPREAD)
    middle = np.exp(np.median(size[among], axis=0))
    found = {}
    for n, o in np.argwhere(np.abs(score) > FAR_DEVIATIONS).tolist():
        if there[n] and n not in found:
            ratio = np.sqrt(left[n, o] / middle[o])
            found[n] = (
                f"the error of {output_names[o]} by its own coefficients is "
                f"{ratio:.3g} times that of other donors"
            )
    return found


@program
def squared_distances(
    information: Information,
    at: Float[Array, "engines params"],
    population: Population,
) -> tuple[Float[Array, " engines"], Float[Array, " engines"]]:
    """d^2 of engines, and the number of directions that they tell of."""

    def one(right, gram, at):
        precision = population.precision
        gram = jnp.einsum("opq,o->pq", gram, precision)
        right = gram @ (at - population.mean) - precision @ right
        value, vector = jnp.linalg.eigh(gram)
        kept = value > RANK_SHARE * jnp.maximum(value[-1], 1.0)
        size = jnp.sqrt(jnp.where(kept, value, 1.0))
        c = jnp.where(kept, (vector.T @ right) / size, 0.0)
        rows = jnp.where(kept, size, 0.0)[:, None] * vector.T
        inner = jnp.eye(len(c), dtype=c.dtype) + rows @ population.covariance @ rows.T
        return c @ jnp.linalg.solve(inner, c), kept.sum().astype(c.dtype)

    return jax.vmap(one)(information.right, information.gram, at)


def _distances(
    chunks: Sequence[DonorChunk], population: Population, count: int
) -> tuple[np.ndarray, np.ndarray]:
    found = [squared_distances(sums, at, population) for sums, at, _ in chunks]
    square, freedom = (
        np.concatenate([np.asarray(f[k]) for f in found])[:count] for k in (0, 1)
    )
    return np.sqrt(np.maximum(square, 0.0)), freedom
