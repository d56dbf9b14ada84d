"""The proof of an export: what it does beside what the model does, record by record."""

import dataclasses
from collections.abc import Callable, Sequence

import jax
import numpy as np
from jaxtyping import Float

from jaxnarx.data import Dataset, Record
from jaxnarx.errors import JaxnarxError
from jaxnarx.exporters.form import SampleProgram
from jaxnarx.models import Network
from jaxnarx.simulation import (
    begin_hidden,
    make_drive,
    make_masks,
    match_records,
    simulate,
    stack_fitting,
)

DOUBLE_TOLERANCE, SINGLE_TOLERANCE = 1e-10, 1e-3
"""Largest difference to the model in shares of an output's largest value; beyond it an
export does not come into being."""

DROPPED_SAMPLES, SHARE_DROPPED = 240, 0.08
"""Samples of the proof with missing inputs, and the share of them that is missing."""

Runner = Callable[
    [Float[np.ndarray, "time inputs"], Float[np.ndarray, "begin computed"]],
    Float[np.ndarray, "time reported"],
]
"""A function that runs a program over inputs, and the measured outputs of the history
and one sample more."""


class ExportError(JaxnarxError):
    """An export that does not do what the model does, or cannot be compiled."""


class SinglePrecisionError(ExportError):
    """Code that does what the model does in double precision, but not in single."""


def make_steps(network: Network, samples: int = 400, seed: int = 0) -> Dataset:
    """A record of steps within the trained ranges, for models without records."""
    rng = np.random.default_rng(seed)
    channels = network.channels
    count = len(channels.measured.all)
    low, high = (np.asarray(a, float)[:count] for a in (network.low, network.high))
    hold = max(8, samples // 25)
    levels = rng.uniform(low, high, (samples // hold + 1, count))
    signals = np.repeat(levels, hold, axis=0)[:samples]
    split = len(channels.inputs)
    return Dataset.from_arrays(
        signals[:, :split],
        signals[:, split:],
        inputs=channels.inputs,
        outputs=channels.outputs,
        sample_time=float(network.sample_time),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """A record as targets see it, and the outputs that the model reports behind its
    history.

    `measured` are the outputs, and estimates of hidden channels, up to the sample where
    the free run begins; `window` samples behind that are not compared.
    """

    inputs: Float[np.ndarray, "time inputs"]
    measured: Float[np.ndarray, "begin computed"]
    expected: Float[np.ndarray, "rest reported"]
    window: int

    def truncate(self, samples: int) -> "Case":
        """The first samples of it; a free run does not know what comes."""
        history = len(self.inputs) - len(self.expected)
        count = max(samples, history + self.window + 1)
        inputs, expected = self.inputs[:count], self.expected[: count - history]
        return dataclasses.replace(self, inputs=inputs, expected=expected)

    def difference(self, run: Runner) -> float:
        """Largest difference, in shares of the largest value of its output."""
        found, expected = run(self.inputs, self.measured), self.expected
        found, expected = found[self.window :], expected[self.window :]
        size = np.max(np.abs(np.nan_to_num(expected)), axis=0, keepdims=True)
        off = np.abs(found - expected) / np.where(size > 0, size, 1.0)
        both = np.isnan(found) & np.isnan(expected)
        off = np.where(both, 0.0, off)
        return float(np.max(np.where(np.isnan(off), np.inf, off), initial=0.0))


def make_cases(
    network: Network,
    program: SampleProgram,
    data: Dataset,
    missing: str | None = None,
) -> list[Case]:
    """A case for every record whose free run begins right behind the history: one that
    misses samples there proves nothing here.

    With `missing="hold"` inputs are NaN, inf and -inf in turn where they are missing.
    """
    matched = match_records(network, data)
    batch, _ = stack_fitting(network, matched, missing)
    masks = make_masks(network, batch, network.window)
    drive = make_drive(network, batch)
    drive = begin_hidden(network, drive, jax.device_put(masks.start))
    gain = np.asarray(network.gain, float)[list(network.signals)]
    scaled = np.asarray(drive.measured, float)
    run = simulate(network, data, missing=missing).value
    names = matched.channels.names
    columns = [names.index(port.name) for port in program.inputs]
    first = program.history
    return [
        Case(
            _measured_arrays(record, missing)[:, columns],
            scaled[n, : first + 1] * gain,
            np.asarray(run[n], float)[first:],
            network.window,
        )
        for n, record in enumerate(matched)
        if int(masks.start[n]) == first and len(record) > first + network.window
    ]


def _measured_arrays(
    record: Record, missing: str | None
) -> Float[np.ndarray, "time signals"]:
    """Inputs and outputs, with numbers that are none where a sample is missing."""
    signals = record.signals.astype(float)
    if missing is not None:
        gone = ~record.valid
        signals[gone] = np.resize([np.nan, np.inf, -np.inf], np.count_nonzero(gone))
    return signals


def dropouts(network: Network, data: Dataset, seed: int = 0) -> Dataset:
    """The beginning of the first record with some inputs missing, the very first and a
    long gap among them."""
    matched = match_records(network, data)
    rng, record = np.random.default_rng(seed), matched.records[0]
    record = record.part(0, DROPPED_SAMPLES + network.before)
    inputs = [s for s in network.used if s not in network.signals]
    valid = record.valid.copy()
    gone = rng.uniform(size=(len(record), len(inputs))) < SHARE_DROPPED
    gone[0] = True
    gone[len(record) // 2 :][: DROPPED_SAMPLES // 8, :1] = True
    gone[-(DROPPED_SAMPLES // 8) :] = False
    valid[:, inputs] &= ~gone
    return dataclasses.replace(
        matched, records=(dataclasses.replace(record, valid=valid),)
    )


def worst(cases: Sequence[Case], run: Runner, most: float, what: str) -> float:
    """Return the largest difference of all cases; ExportError where it is more than
    `most`."""
    found = max(case.difference(run) for case in cases)
    if not found <= most:
        raise ExportError(
            f"the export as {what} differs from the model by {found:.3g} of an "
            f"output's largest value, more than {most:g}"
        )
    return found
