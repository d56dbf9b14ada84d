"""Columns of lagged variables, filtered ones among them: the one place they are formed.

A filtered variable is a lagged variable of a longer signal table: behind the signals
stand the filtered ones, each computed record by record before anything is shifted.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays import lag_signals, usable
from jaxnarx.data import Batch
from jaxnarx.errors import DataError
from jaxnarx.regressors.filtering import FilterTable, filter_input, filter_table
from jaxnarx.regressors.filters import AbstractFilter, require_sampled
from jaxnarx.regressors.variables import Variables


def record_columns(
    signals: Float[Array, "time signals"],
    valid: Bool[Array, "time signals"] | Bool[np.ndarray, "time signals"] | None,
    at: Int[Array, " rows"],
    variables: Variables,
    sample_time: Float[Array, ""],
) -> Float[Array, "vars rows"]:
    """Lagged variables of one record at samples `at`, in the unit of `signals`.

    Filters begin at rest at the first valid sample (`valid` None: the first), see
    `filtering.filter_input`. Before the first sample the window is clipped to it.
    """
    pairs = variables.filtered
    if not pairs:
        return lag_signals(signals, at, variables.rows)
    source = np.array([s for s, _ in pairs])
    table = filter_table([f for _, f in pairs])

    def one(row):
        signal, table = row
        mask = None if valid is None else jnp.asarray(valid)[:, signal]
        return filter_input(table, signals[:, signal], mask, sample_time)

    bank = jax.lax.map(one, (jnp.asarray(source), table))
    signals = jnp.concatenate([signals, bank.T], axis=1)
    return lag_signals(
        signals, at, _extend_rows(variables, signals.shape[1] - len(pairs))
    )


def _extend_rows(variables: Variables, signals: int) -> tuple[tuple[int, int], ...]:
    """Rows into the signal table with the filtered signals behind it."""
    place = {pair: signals + n for n, pair in enumerate(variables.filtered)}
    return tuple((s if f is None else place[s, f], d) for s, d, f in variables.entries)


@eqx.filter_jit
def _filtered_records(
    table: FilterTable,
    u: Float[Array, "records time"],
    valid: Bool[Array, "records time"],
    sample_time: Float[Array, ""],
) -> Float[Array, "records time"]:
    one = jax.vmap(filter_input, in_axes=(None, 0, 0, None))
    return one(table, u, valid, sample_time)


def even_places(
    batch: Batch,
    rows: tuple[tuple[int, int], ...],
    history: int,
    points: int,
    what: str,
) -> Int[np.ndarray, " places"]:
    """Up to `points` places of `batch.flat` to linearise at, evenly spread.

    Samples with full history and valid lags `rows`, (signal, lag); without any,
    `DataError` says that `what` needs them.
    """
    good = np.flatnonzero(usable(batch.valid, rows, history))
    if not len(good):
        raise DataError(
            f"no sample has {history} valid ones before it; {what} samples to be "
            "linearised at"
        )
    return good[np.unique(np.linspace(0, len(good) - 1, points).astype(int))]


def row_columns(
    batch: Batch,
    at: Int[np.ndarray, " rows"],
    variables: Variables,
    sample_time: float,
    *,
    gain: Float[np.ndarray, " signals"] | None = None,
    ones: int = 0,
) -> Float[np.ndarray, "vars rows"]:
    """Lagged variables at places `at` of `batch.flat`, below `ones` rows of ones.

    They are divided by the `gain` of their signals where one is given, else in physical
    units. Every column is written into its place of one array: memory beside the result
    is that of a few columns.
    """
    signals = np.asarray(batch.signals)
    flat = signals.reshape(-1, signals.shape[-1])
    out = _aligned_empty((ones + len(variables), len(at)), flat.dtype)
    out[:ones] = 1
    for (signal, filter_), users in _group_by_source(variables).items():
        given = signals[..., signal], batch.valid[..., signal], filter_
        column = np.array(_source(*given, sample_time), order="C")
        if gain is not None:
            column /= gain[signal]
        for row, lag in users:
            np.take(column.reshape(-1), at - lag, mode="clip", out=out[ones + row])
    return out


def batch_columns(
    signals: Float[np.ndarray, "records time signals"],
    valid: Bool[np.ndarray, "records time signals"],
    variables: Variables,
    sample_time: float,
    *,
    ones: int = 0,
) -> Float[np.ndarray, "records vars time"]:
    """`record_columns` of every record, below `ones` rows of ones, on the host.

    Nothing is compiled for it but a program for each order of filters.
    """
    records, time, _ = signals.shape
    out = _aligned_empty((records, ones + len(variables), time), signals.dtype)
    out[:, :ones] = 1
    for (signal, filter_), users in _group_by_source(variables).items():
        given = signals[..., signal], valid[..., signal], filter_
        column = np.ascontiguousarray(_source(*given, sample_time))
        for row, lag in users:
            late = min(lag, time)
            out[:, ones + row, late:] = column[:, : time - late]
            out[:, ones + row, :late] = column[:, :1]
    return out


def _source(
    column: Float[np.ndarray, "records time"],
    valid: Bool[np.ndarray, "records time"],
    filter_: AbstractFilter | None,
    sample_time: float,
) -> Float[np.ndarray, "records time"]:
    """A signal of all records, filtered where it is."""
    if filter_ is None:
        return column
    require_sampled((filter_,), sample_time)
    given = column, valid, column.dtype.type(sample_time)
    table = filter_table((filter_,))[0]
    return np.asarray(_filtered_records(table, *jax.device_put(given)))


def _group_by_source(variables: Variables) -> dict:
    """(row, lag) of the variables by signal and filter."""
    out: dict = {}
    for row, (signal, lag, filter_) in enumerate(variables.entries):
        out.setdefault((signal, filter_), []).append((row, lag))
    return out


def _aligned_empty(shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    """An empty array that jax on a CPU can take over without a copy."""
    size = int(np.prod(shape)) * dtype.itemsize
    space = np.empty(size + 64, np.uint8)
    start = -space.ctypes.data % 64
    return space[start : start + size].view(dtype).reshape(shape)
