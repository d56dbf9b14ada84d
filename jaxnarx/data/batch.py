"""A dataset as arrays of one shape, for everything that is traced."""

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.arrays import bucket
from jaxnarx.data.dataset import Dataset
from jaxnarx.errors import SpecError


class Batch(eqx.Module):
    """Records padded to one length. Signals are inputs, then outputs, physical units.

    Padding repeats a record's last sample: a free run goes on quietly and unscored.
    `valid` is False for missing samples and for padding alike, `scored` where errors do
    not count though samples are measured (`Record.scored`); None: they count.
    """

    signals: Float[Array, "records time signals"]
    valid: Bool[np.ndarray, "records time signals"]
    scored: Bool[np.ndarray, "records time"] | None = None

    @property
    def flat(self) -> Float[Array, "samples signals"]:
        """All records behind one another, padding included."""
        return self.signals.reshape(-1, self.signals.shape[-1])


def check_precision(dtype: np.dtype) -> None:
    """Refuse float64 data while jax would silently round it to float32."""
    if dtype == np.float64 and not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
        raise SpecError(
            "the data are float64 but jax rounds to float32; run "
            "jax.config.update('jax_enable_x64', True) first, or convert the data to "
            "float32 on purpose",
            field="jax_enable_x64",
        )


def stack_records(data: Dataset) -> Batch:
    """Pad the records to one length and stack them. Needs at least one record.

    The length is that of the longest, rounded up so that few programs serve all.
    """
    if not len(data):
        raise SpecError("the dataset has no records", field="data")
    dtype = data.records[0].u.dtype
    check_precision(dtype)
    longest = bucket(max(len(r) for r in data))
    width, inputs = len(data.channels.all), len(data.channels.inputs)
    signals = np.zeros((len(data), longest, width), dtype)
    valid = np.zeros((len(data), longest, width), bool)
    scored = np.ones((len(data), longest), bool)
    for n, record in enumerate(data):
        signals[n, : len(record), :inputs] = record.u
        signals[n, : len(record), inputs:] = record.y
        valid[n, : len(record)] = record.valid
        if record.scored is not None:
            scored[n, : len(record)] = record.scored
        signals[n, len(record) :] = signals[n, len(record) - 1 : len(record)]
    # device_put takes the memory over where it can; jnp.asarray would copy it.
    return Batch(jax.device_put(signals), valid, scored)
