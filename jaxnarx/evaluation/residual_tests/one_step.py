"""One-step residuals of a network, its regressors, and how it was fitted."""

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy.special
from jaxtyping import Bool, Float, Int

from jaxnarx.arrays import quadratic
from jaxnarx.data import Batch, Channel, scaling_unit
from jaxnarx.evaluation.residual_tests.fits import (
    ResidualBasis,
    global_fit,
    local_fit,
    no_fit,
)
from jaxnarx.evaluation.residual_tests.residual import Residual, make_residual
from jaxnarx.models import Network, OutputModel, held_inputs, weights_at
from jaxnarx.regressors import evaluate, row_columns

FIT_EFFECT_ROWS, FEWEST_FIT_EFFECT_ROWS = 20_000, 4_000
"""Samples at which the effect of the fit is found, for few and for many parameters; of
more samples, so many evenly spaced ones. The variances then are good to 1 or 2 %."""
MAX_REGRESSOR_NUMBERS = 2_000_000
"""Numbers the regressors at these samples may have, unless that makes the rows fewer
than 20 times their parameters."""
BLOCK_NUMBERS = 2**22
"""Numbers of a table of terms that are held at a time."""
FOREIGN_FIT_PROBABILITY = 1e-3
"""How rarely coefficients from other data pass for those fitted to these. Growth that
estimates only new local models leaves the others nearly but not wholly fitted."""


@dataclasses.dataclass(frozen=True, eq=False)
class OneStep:
    """The residual and the regressors that the tests of one output need.

    `estimated` tells how the coefficients follow from these very samples: `"global"` by
    one least squares problem, `"local"` by one for each local model, `"no"` not at all.
    `design` is what the global problem would be on the rows `residual.at`; the columns
    belong to active local models in turn, `owner` tells which (from 0). `residual` and
    `measured` are in units of `unit`, a power of two, so that their powers are finite.
    """

    output: Channel
    place: int
    residual: Residual
    measured: Float[np.ndarray, "records time"]
    estimated: str
    design: ResidualBasis
    owner: Int[np.ndarray, " params"]
    unit: float


def one_step(
    network: Network, batch: Batch, run: Any, place: int, *, estimated: str | None
) -> OneStep:
    """Residuals of output number `place` in the one-step `run` on `batch`.

    Without `estimated` it is found out: least squares leave residuals to which the
    regressors are orthogonal, those of other samples do so only by chance. They are
    those of what was computed, whatever limits the reported outputs are held to.
    """
    batch = held_inputs(network, batch)
    model, signal = network.models[place], network.signals[place]
    known = np.zeros(batch.valid.shape[:2], bool)
    value = np.zeros(known.shape)
    signals = np.asarray(batch.signals)
    for n, (predicted, scored) in enumerate(zip(run.computed, run.scored, strict=True)):
        length = len(predicted)
        known[n, :length] = scored[:, place]
        value[n, :length] = signals[n, :length, signal] - predicted[:, place]
    measured = np.where(known, signals[..., signal], 0.0)
    unit = float(scaling_unit(measured.ravel()))
    value = value / unit
    every = np.flatnonzero(known)
    rows = _rows(sum(map(len, slots(model))))
    at = every[np.unique(np.linspace(0, len(every) - 1, rows).astype(int))]
    p, phi = columns(network, model, batch, at)
    own = _local_columns(model, p)
    blended = [phi_m[:, None] * p_m for p_m, phi_m in zip(own, phi, strict=True)]
    design = global_fit(np.concatenate(blended, axis=1))
    if estimated is None:
        estimated = _find_noise_kind(
            network, model, batch, place, every, value * unit, design, (own, phi)
        )
    fits = {"global": lambda: design, "local": lambda: local_fit(own, phi)}
    fit = fits.get(estimated, lambda: no_fit(len(at)))()
    return OneStep(
        network.output_channels[place],
        place,
        make_residual(np.where(known, value, 0.0), known, at=at, fit=fit),
        measured / unit,
        estimated,
        design if estimated != "local" else fit,
        np.repeat(np.arange(len(own)), [c.shape[1] for c in own]),
        unit,
    )


def _rows(parameters: int) -> int:
    """At how many samples the fit is looked at."""
    few = max(FEWEST_FIT_EFFECT_ROWS, 20 * parameters)
    return min(
        max(few, MAX_REGRESSOR_NUMBERS // max(parameters, 1)), max(FIT_EFFECT_ROWS, few)
    )


def columns(
    network: Network, model: OutputModel, batch: Batch, at: Int[np.ndarray, " rows"]
) -> tuple[Float[np.ndarray, "terms rows"], Float[np.ndarray, "models rows"]]:
    """Distinct terms (scaled) and validities of the active models at flat places."""
    time = float(network.sample_time)
    gain = np.asarray(network.gain)
    v = row_columns(batch, at, network.variables, time, gain=gain, ones=1)
    p = np.asarray(evaluate(np.asarray(model.local.factor), v), float)
    x = row_columns(batch, at, model.scheduling, time)
    return p, weights_at(model, x.T)


def slots(model: OutputModel) -> list[Int[np.ndarray, " used"]]:
    """The rows in the table of terms of every active local model's terms."""
    index, used = np.asarray(model.local.index), np.asarray(model.local.used)
    return [index[m, used[m]] for m in np.flatnonzero(np.asarray(model.active))]


def _local_columns(model: OutputModel, p: np.ndarray) -> list[np.ndarray]:
    return [p[chosen].T for chosen in slots(model)]


def _blocks(
    network: Network, model: OutputModel, batch: Batch, every: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    terms = model.local.factor.shape[0] + len(model.active) + len(network.variables)
    size = max(BLOCK_NUMBERS // max(terms, 1), 1)
    for start in range(0, len(every), size):
        at = every[start : start + size]
        yield at, *columns(network, model, batch, at)


def _find_noise_kind(
    network: Network,
    model: OutputModel,
    batch: Batch,
    place: int,
    every: Int[np.ndarray, " known"],
    value: Float[np.ndarray, "records time"],
    design: ResidualBasis,
    parts: tuple[list[np.ndarray], Float[np.ndarray, "models rows"]],
) -> str:
    """`"global"`, `"local"` or `"no"`, from the normal equations of all samples."""
    own, active = slots(model), np.asarray(model.active)
    gain = float(np.asarray(network.gain)[network.signals[place]])
    theta = np.asarray(model.local.dense(), float)[active]
    joint = np.zeros((theta.shape[1], theta.shape[0]))
    alone, squares = np.zeros_like(joint), np.zeros((2, len(theta)))
    for at, p, phi in _blocks(network, model, batch, every):
        e = value.reshape(-1)[at] / gain
        local = (np.sum(phi * (theta @ p), axis=0) + e)[None] - theta @ p
        joint += p @ (phi * e[None]).T
        alone += p @ (phi * local).T
        squares += np.stack(
            [np.full(len(theta), e @ e), np.sum(phi * local**2, axis=1)]
        )
    count = len(every)
    scale = count / max(len(design.basis), 1)
    moments = [joint[chosen, m] for m, chosen in enumerate(own)]
    freedom = max(sum(map(len, own)), 1)
    most = 2 * scipy.special.gammaincinv(0.5 * freedom, FOREIGN_FIT_PROBABILITY)
    blended = [w[:, None] * c for c, w in zip(*parts, strict=True)]
    together = (np.concatenate(blended, axis=1), np.concatenate(moments))
    if _explained_share(*together, squares[0, 0], scale) * count < most:
        return "global"
    shares = [
        _explained_share(
            np.sqrt(w)[:, None] * c, alone[chosen, m], squares[1, m], scale
        )
        for m, (c, w, chosen) in enumerate(zip(*parts, own, strict=True))
    ]
    return "local" if sum(shares) * count < most else "no"


def _explained_share(
    columns: Float[np.ndarray, "rows params"],
    moment: Float[np.ndarray, " params"],
    squares: float,
    scale: float,
) -> float:
    """r'Hr/r'r: what share of the residuals the regressors explain.

    r'Hr = (X'r)'(X'X)^-1 (X'r) with the moment X'r of all samples, `scale` times as
    many as rows of X. By chance the share is chi2(P)/N. Normal equations serve a yes or
    no; directions below 1e-10 of the scaled columns are left out.
    """
    norm = np.linalg.norm(columns, axis=0)
    norm = np.where(norm > 0, norm, 1.0)
    scaled = columns / norm[None]
    explained, _ = quadratic(scaled.T @ scaled, moment / norm, least=1e-10)
    return explained / scale / squares if squares > 0 else 0.0


def usable_inputs(
    batch: Batch, signal: int
) -> tuple[Float[np.ndarray, "records time"], Bool[np.ndarray, "records time"]]:
    """A signal over the power of two at its size, zero where missing; where known."""
    known = np.asarray(batch.valid[..., signal])
    values = np.asarray(np.asarray(batch.signals)[..., signal], float)
    values = np.where(known, values, 0.0)
    return values / scaling_unit(values.ravel()), known
