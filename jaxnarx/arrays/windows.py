"""Lag windows: which samples a regressor sees, and where it may be used."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int


def lag_signals(
    signals: Float[Array, "time signals"],
    at: Int[Array, " rows"],
    rows: tuple[tuple[int, int], ...],
) -> Float[Array, "vars rows"]:
    """Lagged variables `signals[at - lag, signal]` for each (signal, lag) of `rows`.

    Several records may lie behind one another in `signals`; `usable` tells where a
    window would cross a border. Indices before the first sample are clipped to it and
    must be masked by the caller.
    """
    if not rows:
        return jnp.zeros((0, at.shape[0]), signals.dtype)
    columns = signals.T
    # Row by row: one gather by two index tables would take seven times the memory.
    return jnp.stack([columns[s][jnp.maximum(at - d, 0)] for s, d in rows])


def usable(
    valid: Bool[np.ndarray, "records time signals"],
    rows: tuple[tuple[int, int], ...],
    history: int,
) -> Bool[np.ndarray, "records time"]:
    """Samples with `history` earlier ones in their record and only valid lags.

    `valid` is False for missing samples and padding alike.
    """
    records, time, _ = valid.shape
    good = np.zeros((records, time), bool)
    good[:, history:] = True
    for s, d in set(rows):
        good[:, d:] &= valid[:, : max(time - d, 0), s]
    return good
