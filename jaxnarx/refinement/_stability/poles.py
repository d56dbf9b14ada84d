"""Poles of the local models at the samples where they are valid.

A local model alone (its validity function set to one) is linearised by its own output's
past; what other outputs feed into it counts as an input.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxnarx.arrays import program
from jaxnarx.models import Network, fed_back_variables, scheduling_values
from jaxnarx.refinement._stability.points import (
    Points,
    choose_points,
    companion,
    jacobians,
    map_chunks,
    moduli,
)
from jaxnarx.regressors import evaluate
from jaxnarx.simulation import Masks, RunInputs

FEWEST_SAMPLES = 20
"""A local model that is valid nowhere by more than one half is looked at here: at the
samples where it is most valid."""
SHORTEST_HORIZON = 5
"""Samples in the shortest first horizon."""


@dataclasses.dataclass(frozen=True, eq=False)
class Poles:
    """Largest modulus of the poles over the samples a model is responsible for.

    `model` counts from 1; None is the blended network, all outputs together. `median`,
    `high` (95 %) and `largest` are moduli per sample, `unstable` the share of `samples`
    where the modulus reaches 1, `time_constant` [s] that of the median modulus,
    infinite from 1 on.
    """

    output: str
    model: int | None
    samples: int
    median: float
    high: float
    largest: float
    unstable: float
    time_constant: float


def time_constant(modulus: float) -> float:
    """Samples in which a pole of that modulus decays to 1/e; infinite from 1 on."""
    if modulus >= 1:
        return float("inf")
    return -1 / float(np.log(modulus)) if modulus > 0 else 0.0


@program
def _local(network: Network, v, x, history, *, output: int):
    """Slopes of every local model by its own output's lags, and its validity."""
    model, factor = network.models[output], network.models[output].local.factor
    own = [
        (row + 1, lag)
        for row, o, lag in fed_back_variables(network.variables, network.signals)
        if o == output
    ]
    row, lag = np.array(own, int).reshape(-1, 2).T
    models, lags = model.active.shape[0], history.shape[2]
    out = jnp.zeros((models, lags, v.shape[1]), v.dtype)
    for k in range(factor.shape[1]):
        # Product rule: the other factors of the terms whose k-th is that variable.
        others = evaluate(factor.at[:, k].set(0), v)
        hit = (factor[:, k][:, None] == jnp.asarray(row, factor.dtype)[None]).astype(
            v.dtype
        )
        slope = jnp.einsum("mt,te,tp->mep", model.local.dense(), hit, others)
        out = out.at[:, lag].add(slope)
    phi = model.validity(scheduling_values(model, x[output]), model.active)
    return jnp.concatenate([out, phi[:, None]], axis=1)


def local_moduli(
    network: Network, points: Points, output: int
) -> dict[int, Float[np.ndarray, " some"]]:
    """Largest pole modulus of each active local model where it is valid.

    `points` carry measured histories. Keys are the models' positions.
    """
    found = map_chunks(
        lambda *p: _local(network, *p, output=output), points, axis=2
    )  # (models, depth + 1, points)
    out = {}
    for m in np.flatnonzero(np.asarray(network.models[output].active)).tolist():
        phi = found[m, -1]
        at = np.flatnonzero(phi > 0.5)
        if len(at) < FEWEST_SAMPLES:
            at = np.argsort(-phi, kind="stable")[:FEWEST_SAMPLES]
        a = found[m, :-1, at]  # (points, depth)
        out[m] = moduli(companion(a[:, None, None]))
    return out


def _row(output: str, model: int | None, modulus: np.ndarray, sample_time) -> Poles:
    median = float(np.median(modulus))
    return Poles(
        output,
        model,
        len(modulus),
        median,
        float(np.quantile(modulus, 0.95, method="lower")),
        float(modulus.max()),
        float(np.mean(modulus >= 1)),
        time_constant(median) * sample_time,
    )


def pole_table(
    network: Network, measured: Points, visited: Points, sample_time: float
) -> tuple[Poles, ...]:
    """Every local model at measured histories, then the network along its free run."""
    rows = [
        _row(name, m + 1, modulus, sample_time)
        for o, name in enumerate(network.computed_names)
        for m, modulus in local_moduli(network, measured, o).items()
    ]
    whole = moduli(companion(jacobians(network, visited)))
    return (*rows, _row("network", None, whole, sample_time))


def _medians(
    network: Network, drive: RunInputs, masks: Masks
) -> Float[np.ndarray, " _"]:
    points = choose_points(network, drive, masks, count=1000)
    return np.array(
        [
            np.median(modulus)
            for o in range(len(network.models))
            for modulus in local_moduli(network, points, o).values()
        ]
    )


def slowest(network: Network, drive: RunInputs, masks: Masks) -> float:
    """Time constant [samples] of the slowest stable local model, at the median sample.

    Unstable local models are passed over; infinite when there is no other.
    """
    median = _medians(network, drive, masks)
    stable = median[median < 1]
    return time_constant(float(stable.max())) if len(stable) else float("inf")


def first_horizon(network: Network, drive: RunInputs, masks: Masks) -> int:
    """Horizon [samples] to begin a refinement with, from the slowest local pole.

    One time constant of the slowest stable local model: shorter windows do not show it,
    longer ones let errors grow that a one-step fit knows nothing of. An unstable local
    model shortens it to the time in which its errors grow e-fold. At least 5, at most
    the longest record that can be scored.
    """
    median = _medians(network, drive, masks)
    wild = median[median > 1]
    grows = 1 / np.log(np.minimum(wild, 1e6)).max() if len(wild) else np.inf
    wanted = min(slowest(network, drive, masks), float(grows))
    longest = int(masks.scored.any(axis=2).sum(axis=1).max())
    return int(min(max(wanted, SHORTEST_HORIZON), max(longest, 1)))


def largest_local_pole(network: Network) -> float:
    """Largest modulus of the poles of any local model, at the middle of the ranges.

    Each is linearised by its own output's past with all variables in the middle of
    their trained ranges: a quick look, without records. 0 without feedback.
    """
    middle = (np.asarray(network.low, float) + np.asarray(network.high, float)) / 2
    scaled = middle / np.asarray(network.gain, float)
    v = np.concatenate([[1.0], scaled[list(network.variables.signal)]])
    own = fed_back_variables(network.variables, network.signals)
    largest = 0.0
    for o, model in enumerate(network.models):
        lag = {row + 1: d for row, output, d in own if output == o}
        if not lag:
            continue
        a = np.zeros((len(model.active), 1, 1, 1 + max(lag.values())))
        dense = np.asarray(model.local.dense(), float)
        for n, row in enumerate(np.asarray(model.local.factor).tolist()):
            for k, variable in enumerate(row):
                if variable in lag:
                    others = np.prod(v[row[:k] + row[k + 1 :]])
                    a[:, 0, 0, lag[variable]] += dense[:, n] * others
        largest = max(
            largest, float(moduli(companion(a[np.asarray(model.active)])).max())
        )
    return largest
