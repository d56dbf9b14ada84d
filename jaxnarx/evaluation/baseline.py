"""A linear model of the same lags, to compare a network with."""

import dataclasses

import numpy as np
from jaxtyping import Float

from jaxnarx.arrays import usable
from jaxnarx.data import Batch, Dataset, stack_records
from jaxnarx.evaluation.rows import ScoredSamples
from jaxnarx.models import Network
from jaxnarx.regressors import Variables, row_columns
from jaxnarx.simulation import has_diverged, match_records, tables

BASELINE_NAME = "linear, same lags"


def linear_runs(
    network: Network, train: Dataset, data: Dataset, free: list[list[ScoredSamples]]
) -> list[list[ScoredSamples]]:
    """Free runs on `data` of ARX models fitted to `train`, by output and record.

    One for each output, of the network's lagged inputs and of that output's own past,
    by least squares of the one-step error. `free` are the network's own free runs,
    whose samples are scored and whose bounds hold. A linear free run is a filter,
    A(q) y = B(q) u + c, so that this costs no compiled program.
    """
    train, data = match_records(network, train), match_records(network, data)
    sources, targets = stack_records(train), stack_records(data)
    return [
        _runs(network, signal, sources, targets, bounds, one)
        for signal, bounds, one in zip(
            network.signals, _bounds(network), free, strict=True
        )
    ]


def _bounds(network: Network) -> list[tuple[float, float]]:
    gain = np.asarray(network.gain)[np.array(network.signals)]
    low, high = np.asarray(network.lower) * gain, np.asarray(network.upper) * gain
    return list(zip(low.tolist(), high.tolist(), strict=True))


def _runs(
    network: Network,
    signal: int,
    train: Batch,
    data: Batch,
    bounds: tuple[float, float],
    free: list[ScoredSamples],
) -> list[ScoredSamples]:
    step = float(network.sample_time)
    entries = network.variables.entries
    lags = [lag for s, lag, f in entries if s == signal and f is None]
    known = [e for e in entries if e[0] not in network.signals]
    table = Variables.of([*known, *((signal, lag, None) for lag in lags)])
    y = np.asarray(train.signals)[..., signal]
    good = usable(train.valid, tables(network), network.history)
    at = np.flatnonzero(good & train.valid[..., signal])
    x = row_columns(train, at, table, step, ones=1).T
    scale = np.maximum(np.abs(x).max(axis=0, initial=0.0), np.finfo(x.dtype).tiny)
    theta = np.linalg.lstsq(x / scale, y.ravel()[at], rcond=None)[0] / scale
    forcing, past = theta[: 1 + len(known)], theta[1 + len(known) :]
    recursion = np.zeros(max(lags, default=0) + 1)
    recursion[0] = 1.0
    recursion[lags] -= past
    places = np.arange(data.valid[..., 0].size)
    drive = row_columns(data, places, Variables.of(known), step, ones=1)
    drive = (forcing @ drive).reshape(data.valid.shape[:2])
    return [
        _run(one, drive[n, : len(one.measured)], recursion, bounds)
        for n, one in enumerate(free)
    ]


def _run(
    one: ScoredSamples,
    drive: Float[np.ndarray, " time"],
    recursion: Float[np.ndarray, " lags"],
    bounds: tuple[float, float],
) -> ScoredSamples:
    """One record: from the samples the network's own run started from."""
    from scipy.signal import lfilter, lfiltic  # takes longer to load than it runs

    y = one.measured[:, 0].copy()
    start = int(np.argmax(one.scored)) if one.scored.any() else len(y)
    with np.errstate(over="ignore", invalid="ignore"):
        before = y[:start][::-1]
        state = lfiltic([1.0], recursion, before)
        y[start:] = lfilter([1.0], recursion, drive[start:], zi=state)[0]
    held = ~((y > bounds[0]) & (y < bounds[1]))[:, None]
    held[:start] = False
    return dataclasses.replace(
        one,
        predicted=y[:, None],
        limited=held,
        held=np.zeros_like(held),
        diverged=bool(has_diverged(held[start:, 0])),
    )
