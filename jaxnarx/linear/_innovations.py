"""One-step errors of a linear model on any data, with its own model of the noise."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.data import Dataset, match_channels, stack_records
from jaxnarx.errors import DataError, SpecError
from jaxnarx.linear.model import LinearModel
from jaxnarx.linear.recursion import (
    best_states,
    residuals,
    signals,
    steady,
    window_start,
)


@dataclasses.dataclass(frozen=True, eq=False)
class Innovations:
    """Errors and predictions of every record, in the output's unit.

    `predicted` is the measurement less `error`: the best one-step prediction from all
    measurements before. `scored` marks the samples with a complete valid window; the
    others have error zero.
    """

    error: tuple[Float[np.ndarray, " _"], ...]
    predicted: tuple[Float[np.ndarray, " _"], ...]
    scored: tuple[Bool[np.ndarray, " _"], ...]
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.error)

    @property
    def pooled(self) -> Float[np.ndarray, " samples"]:
        """Scored errors of all records behind one another."""
        pairs = zip(self.error, self.scored, strict=True)
        return np.concatenate([e[s] for e, s in pairs])


@guard_arguments
def innovations(model: LinearModel, data: Dataset) -> Innovations:
    """One-step prediction errors e(t) of (2.3) for every sample.

    The initial states of B/F of every record are those of least squares on the record;
    e and C/D e before it are zero. The errors of an output-error model are those of its
    free run. Channels are matched by name. `DataError` where no record has a complete
    window, `SpecError` at another sample time.
    """
    data, _ = match_channels(data, model.channels)
    expected = float(model.sample_time)
    if abs(data.sample_time - expected) > 1e-6 * expected:
        raise SpecError(
            f"the model was identified at a sample time of {expected:g} s, the data "
            f"have {data.sample_time:g} s; resample the data",
            field="sample_time",
        )
    s, inputs = model.structure, len(model.channels.inputs)
    found = signals(s, stack_records(data), inputs, model.output)
    if not np.any(found.known):
        raise DataError(
            f"no record has a valid window of {window_start(s) + 1} samples, which the "
            "model needs"
        )
    theta = np.asarray(model.parameters)
    x0 = best_states(s, theta, steady(s, theta, found), found)
    e = np.asarray(residuals(s, model.parameters, jnp.asarray(x0), found))
    known = np.asarray(found.known)
    error = tuple(e[n, : len(r)] for n, r in enumerate(data))
    y = [r.y[:, model.output] for r in data]
    return Innovations(
        error,
        tuple(a - b for a, b in zip(y, error, strict=True)),
        tuple(known[n, : len(r)] for n, r in enumerate(data)),
        tuple(data.names),
    )
