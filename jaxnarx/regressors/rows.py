"""Regression rows: every usable sample of every record behind one another."""

import dataclasses

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays import bucket, usable
from jaxnarx.data import Batch, Dataset, gains, stack_records
from jaxnarx.errors import DataError
from jaxnarx.regressors.centring import Centring, find_centring
from jaxnarx.regressors.columns import row_columns
from jaxnarx.regressors.variables import Variables

SAMPLES_PER_ROW = 2
"""Samples for every usable row up to which a program serves all samples."""


class Rows(eqx.Module):
    """Scaled lagged variables and targets of one-step prediction.

    `v` carries a leading row of ones; `weight` is zero where a target or a lag is
    missing; `at` is the sample's place in `batch.flat`. The last row is repeated with
    weight zero for all outputs up to a size that programs are made for: that of all
    samples, so that what is left out changes no program, unless most are.
    """

    v: Float[Array, "vars rows"]
    y: Float[Array, "outputs rows"]
    weight: Float[Array, "outputs rows"]
    at: Int[np.ndarray, " rows"]
    batch: Batch
    gain: Float[np.ndarray, " signals"]

    @property
    def count(self) -> int:
        """Rows that are not padding; host only."""
        return int(np.count_nonzero(np.any(np.asarray(self.weight) > 0, axis=0)))

    def select_lanes(self, lanes: slice) -> "Rows":
        """The same rows for some of the outputs."""
        return dataclasses.replace(self, y=self.y[lanes], weight=self.weight[lanes])

    def find_centring(self, variables: Variables) -> Centring | None:
        """Offsets of what is far from zero, None where nothing is; host only."""
        return find_centring(self.batch, variables, self.v, self.y, self.weight)


def regression_rows(
    data: Dataset,
    variables: Variables,
    outputs: tuple[int, ...],
    *,
    history: int,
    need: int = 1,
    weights: list[Float[np.ndarray, " _"]] | None = None,
    gain: Float[np.ndarray, " signals"] | None = None,
    exact: bool = False,
) -> Rows:
    """Rows of all records after `history` samples; windows never cross a border.

    `need` is the number of usable rows the caller cannot do without: fewer raise
    `DataError`. `weights` holds one non-negative weight per sample and record. With
    `exact` no row is padding, for those who compile nothing.
    """
    batch, at, weight, gain = row_places(
        data,
        variables,
        outputs,
        history=history,
        need=need,
        weights=weights,
        gain=gain,
        exact=exact,
    )
    targets = _targets(data, outputs)
    v = row_columns(batch, at, variables, data.sample_time, gain=gain, ones=1)
    flat = np.asarray(batch.signals).reshape(-1, len(data.channels.all))
    y = flat[at[:, None], targets[None]] / gain[targets][None]
    # device_put takes the memory over where it can; jnp.asarray would copy it.
    v, y, weight = jax.device_put((v, y.T, weight))
    return Rows(v, y, weight, at, batch, gain)


def row_places(
    data: Dataset,
    variables: Variables,
    outputs: tuple[int, ...],
    *,
    history: int,
    need: int = 1,
    weights: list[Float[np.ndarray, " _"]] | None = None,
    gain: Float[np.ndarray, " signals"] | None = None,
    exact: bool = False,
) -> tuple[
    Batch,
    Int[np.ndarray, " rows"],
    Float[np.ndarray, "outputs rows"],
    Float[np.ndarray, " signals"],
]:
    """The places of the rows of `regression_rows`: records, samples, weights, and
    gains."""
    batch = stack_records(data)
    targets = _targets(data, outputs)
    good = usable(batch.valid, variables.rows, history)
    if batch.scored is not None:
        good &= batch.scored
    counted = good[:, :, None] & batch.valid[:, :, targets]
    if weights is not None:
        positive = flat_weights(weights, data, good.shape[1]) > 0
        counted &= positive.reshape(good.shape)[:, :, None]
    require_samples(data, counted, history=history, need=need)
    at = np.flatnonzero(np.any(counted, axis=2).reshape(-1))
    rows = len(at)
    size = data.samples if data.samples <= SAMPLES_PER_ROW * rows else rows
    at = np.pad(at, (0, 0 if exact else bucket(size) - rows), mode="edge")
    gain = gains(data) if gain is None else gain
    weight = batch.valid.reshape(-1, batch.valid.shape[-1])[at][:, targets].T
    weight = weight.astype(gain.dtype)
    weight[:, rows:] = 0.0
    if weights is not None:
        weight = weight * flat_weights(weights, data, good.shape[1])[at][None]
    return batch, at, weight, gain


def _targets(data: Dataset, outputs: tuple[int, ...]) -> Int[np.ndarray, " outputs"]:
    """Signals of some outputs."""
    return len(data.channels.inputs) + np.array(outputs)


def flat_weights(weights, data: Dataset, longest: int) -> Float[np.ndarray, " samples"]:
    """Weights of all records behind one another, padded to the longest with zeros."""
    if [len(w) for w in weights] != [len(r) for r in data]:
        raise DataError(
            "weights must be one array per record with one number per sample; "
            f"records have {[len(r) for r in data]} samples, weights "
            f"{[len(w) for w in weights]}"
        )
    flat = np.zeros((len(data), longest), data.records[0].u.dtype)
    for n, w in enumerate(weights):
        flat[n, : len(w)] = w
    if not np.all(np.isfinite(flat)) or np.any(flat < 0):
        raise DataError("weights must be finite and not negative")
    return flat.reshape(-1)


def require_samples(
    data: Dataset,
    counted: Bool[np.ndarray, "records time outputs"],
    *,
    history: int,
    need: int,
) -> None:
    """Raise `DataError` unless every output has at least `need` usable samples."""
    have = int(counted.sum(axis=(0, 1)).min())
    if have >= need:
        return
    shortest = min(data, key=len)
    raise DataError(
        f"need at least {need} usable rows after lag {history}, the records give "
        f"{have} (shortest: {shortest.name!r} with {len(shortest)} rows); use smaller "
        "lags, fewer terms or longer records"
    )
