"""Inputs that are missing: NaN, inf, or a number that no sensor gives.

An input is missing at a sample where it is not finite, or `FARTHEST` (a million) times
as large as it ever was in training. Nothing is computed from such a value: the last one
that was not missing stands in its place, before the first one the middle of the trained
range. Filters, lags and the domain's features see the held value too, so that a run is
what it was once the input is back, and recovers within the model's memory. The sample
is `extrapolated` and its domain index is `FARTHEST`. The network's `nan` says what is
reported of it:

- `"hold"`: what follows from the held inputs;
- `"nan"`: nothing, the outputs are not a number; the states go on with held inputs.

Once an input has been missing for `invalid_after` samples in a row, or has not been
there since the beginning of the run, the samples are `invalid` until all inputs are
back. The default is the model's memory, at least `LEAST_HELD_SAMPLES` samples: by then
the outputs are at rest at the held inputs and know nothing of the engine.
"""

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import positive
from jaxnarx.data import Batch
from jaxnarx.models.domain import LARGEST_INDEX
from jaxnarx.models.network import Network
from jaxnarx.models.outside import HOLD

LEAST_HELD_SAMPLES = 10
"""Samples for which held inputs are trusted at least."""
ZERO_SIZE = 1e-12
"""Largest size of a channel that counts as zero throughout, in its unit."""
MEMORY_HISTORIES = 10
"""Memory of a network without a domain or filters, in samples of its history."""


@guard_arguments
def set_nan_policy(
    network: Network, nan: str = HOLD, *, invalid_after: float | int | None = None
) -> Network:
    """The network with what its outputs are where an input is not finite.

    Exports keep to it in every target, and so does `simulate(missing="hold")`.

    Args:
        network: The model.
        nan: `"hold"`, outputs by the last finite value of the input; or `"nan"`,
            outputs that are not a number at such samples. See
            `jaxnarx.models.missing`.
        invalid_after: Time [s] without a finite value from which outputs are flagged
            as invalid, rounded up to samples; default: the model's memory, at least
            ten samples.

    Returns:
        The network.

    Example:
        silent = jnx.models.set_nan_policy(network, "nan", invalid_after=2.0)
        print(silent.nan, silent.invalid_after)
    """
    count = None
    if invalid_after is not None:
        seconds = positive(invalid_after, "invalid_after")
        count = max(1, math.ceil(seconds / float(network.sample_time) - 1e-6))
    return dataclasses.replace(network, nan=nan, invalid_after=count)


def input_memory(network: Network) -> Any:
    """Samples for which the network remembers its inputs: as its domain knows, else the
    slowest of its filters, or ten times its history. A number, unless its sample time
    is traced."""
    if network.remembers is not None:
        return network.remembers
    tables = (network.variables, *(m.scheduling for m in network.models))
    own = network.domain
    slowest = max(t.slowest for t in tables) if own is None else own.slowest
    step = network.sample_time
    samples = slowest / (step if isinstance(step, Tracer) else float(step))
    if network.domain is not None and slowest > 0:
        return samples
    least = float(MEMORY_HISTORIES * max(network.history, 1))
    if isinstance(samples, Tracer):
        return jnp.maximum(samples, least)
    return max(samples, least)


def trusted_samples(network: Network) -> int:
    """Samples in a row with an input missing from which outputs are invalid."""
    if network.invalid_after is not None:
        return network.invalid_after
    return max(LEAST_HELD_SAMPLES, math.ceil(input_memory(network)))


def largest_sizes(network: Network) -> Float[Array | np.ndarray, " signals"]:
    """Size from which a value of every signal is none, physical units; on the host
    unless the network is traced."""
    xp = jnp if isinstance(network.low, Tracer) else np
    size = xp.maximum(xp.abs(xp.asarray(network.low)), xp.abs(xp.asarray(network.high)))
    return LARGEST_INDEX * xp.where(size > ZERO_SIZE, size, 1.0)


@dataclasses.dataclass(frozen=True, eq=False)
class Gaps:
    """Samples at which an input is missing, and those at which outputs are invalid."""

    missing: Bool[np.ndarray, "records time"]
    invalid: Bool[np.ndarray, "records time"]


def hold_missing(
    network: Network, batch: Batch, lengths: list[int]
) -> tuple[Batch, Gaps]:
    """Records with the inputs that the network uses held where they are missing, and
    where that is; host only. `lengths` are those of the records."""
    signals, valid = np.array(batch.signals), np.array(batch.valid)
    at = np.arange(valid.shape[1])[None]
    there = at < np.asarray(lengths)[:, None]
    sizes, missing = largest_sizes(network), np.zeros(valid.shape[:2], bool)
    for s in network.used:
        fine = valid[..., s] & (np.abs(signals[..., s]) < sizes[s])
        middle = 0.5 * (float(network.low[s]) + float(network.high[s]))
        signals[..., s] = _hold_last(signals[..., s], fine, middle)
        missing |= there & ~fine
        valid[..., s] = there
    count = np.cumsum(missing, axis=1)
    row = count - np.maximum.accumulate(np.where(missing, 0, count), axis=1)
    invalid = missing & ((row >= trusted_samples(network)) | (row == at + 1))
    batch = Batch(jax.device_put(signals), valid, batch.scored)
    return batch, Gaps(missing, invalid)


def _hold_last(
    x: Float[np.ndarray, "records time"],
    fine: Bool[np.ndarray, "records time"],
    first: float,
) -> Float[np.ndarray, "records time"]:
    """The last fine value, `first` before there is one."""
    last = np.where(fine, np.arange(x.shape[1])[None], -1)
    last = np.maximum.accumulate(last, axis=1)
    kept = np.take_along_axis(x, np.maximum(last, 0), axis=1)
    return np.where(last < 0, first, kept).astype(x.dtype)
