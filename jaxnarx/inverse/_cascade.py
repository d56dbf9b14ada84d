"""The verb `cascade`: a plant's model under the commands of an inverse."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.data import Dataset
from jaxnarx.inverse.loop import Loop, connect, run
from jaxnarx.inverse.task import CascadeTask, make_task
from jaxnarx.metrics import nrmse
from jaxnarx.models import Network, report_outputs
from jaxnarx.settings import ActuatorLimits
from jaxnarx.simulation import has_diverged
from jaxnarx.solution import RESULTS, STATUS_NAMES, Solution

LIMIT_TOLERANCE = 1e-9
"""Share of a range, or of a largest change, within which a limit counts as reached."""


@dataclasses.dataclass(frozen=True, eq=False)
class Tracking:
    """Commands and outputs of a cascade, one array per record, in physical units.

    Samples before the start repeat what was recorded. `at_range` and `at_rate` mark
    commands held by a limit, `limited` outputs held by the forward network's feedback
    bound, `held` those at the edge of its trained range where it has limits; `scored`
    the samples at which `outputs` of the targets are compared with `references`.
    `outputs` holds all that the forward network computes, `targets` the places of the
    targets among them.
    """

    commands: tuple[Float[np.ndarray, "_ commands"], ...]
    outputs: tuple[Float[np.ndarray, "_ outputs"], ...]
    references: tuple[Float[np.ndarray, "_ targets"], ...]
    at_range: tuple[Bool[np.ndarray, "_ commands"], ...]
    at_rate: tuple[Bool[np.ndarray, "_ commands"], ...]
    limited: tuple[Bool[np.ndarray, "_ outputs"], ...]
    held: tuple[Bool[np.ndarray, "_ outputs"], ...]
    scored: tuple[Bool[np.ndarray, "_ targets"], ...]
    targets: tuple[int, ...]
    command_names: tuple[str, ...]
    output_names: tuple[str, ...]
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.commands)

    @property
    def target_names(self) -> tuple[str, ...]:
        """Names of the targets."""
        return tuple(self.output_names[o] for o in self.targets)

    def nrmse(self) -> Float[np.ndarray, " targets"]:
        """Tracking error of every target over all records: its root mean square over
        the standard deviation of the reference. No scored sample gives `inf`."""
        tracked = np.concatenate([y[:, list(self.targets)] for y in self.outputs])
        return np.asarray(
            nrmse(np.concatenate(self.references), tracked, np.concatenate(self.scored))
        )


@guard_arguments
def cascade(
    inverse: Network,
    forward: Network,
    references: Dataset,
    limits: ActuatorLimits | None = None,
) -> Solution[Tracking]:
    """Run reference, inverse, actuator limits and forward network over every record.

    `references` has the channels of the forward network: the columns of the targets
    are what they shall be (recorded outputs are reachable references), other inputs
    and measured outputs are what they were; recorded commands serve as the past of the
    first sample alone. The inverse's targets are the channels it sees ahead; near the
    end of a record their last value is held. Outputs that the inverse uses as states
    are those of the forward network where it computes them.

    `limits` bound the commands; without, the range of the inverse's training, widened
    as its feedback is. The inverse is given the limited commands back (anti-windup).
    Where the forward network has limits (`jnx.models.hold_to_range`), commands stay
    within its trained range, and outputs are reported as `simulate` does.

    `stats` holds `nrmse` of every target, the share of samples `at_range` and
    `at_rate` per record and command, how many samples of each record and output were
    `held`, and `record_status`. Statuses as in `simulate`:
    `diverged` when the forward network's bound acts on more than 5 % of a record or on
    50 samples in a row, `too_short` where a record has no valid start.
    """
    loop = connect(inverse, forward, limits)
    task = make_task(loop, references)
    z = run_all(loop, task)
    value = _tracking(loop, task, np.asarray(z))
    return _solution(loop, task, value)


def run_all(loop: Loop, task: CascadeTask):
    """Scaled states of all records from their starts."""
    batch = task.batch
    return run(loop, batch.signals, batch.valid, jnp.asarray(task.anchor()))


def _tracking(
    loop: Loop, task: CascadeTask, z: Float[np.ndarray, "records time states"]
) -> Tracking:
    forward, move = loop.forward, np.asarray(loop.move)
    low, high = np.asarray(loop.low), np.asarray(loop.high)
    count, shown = len(low), len(forward.models)
    lower, upper = np.asarray(forward.lower), np.asarray(forward.upper)
    near = LIMIT_TOLERANCE * (high - low)
    columns: tuple[list, ...] = ([], [], [], [], [], [], [], [])
    at = list(loop.command_signals)
    inputs = len(forward.channels.inputs)
    for n, record in enumerate(task.data):
        length = len(record)
        first = min(int(task.start[n]), length)
        u = z[n, :length, :count] * np.asarray(loop.command_gain)
        y = z[n, :length, count : count + shown]
        limited = (y <= lower) | (y >= upper)
        y, held = report_outputs(forward, y * np.asarray(loop.output_gain))
        u[:first] = record.u[:first, at]
        y[:first] = record.y[:first, np.array(forward.signals) - inputs]
        moved = np.abs(np.diff(u, axis=0, prepend=u[:1]))
        at_range = (u <= low + near) | (u >= high - near)
        at_rate = np.isfinite(move) & (moved >= np.where(move < np.inf, move, 0) - near)
        for mask in (limited, held, at_range, at_rate):
            mask[:first] = False
        parts = (
            *(u, y, task.reference[n, :length]),
            *(at_range, at_rate, limited, held, task.scored[n, :length]),
        )
        for column, part in zip(columns, parts, strict=True):
            column.append(part)
    return Tracking(
        *(tuple(column) for column in columns),
        targets=loop.wiring.targets,
        command_names=tuple(loop.inverse.output_names),
        output_names=tuple(forward.output_names),
        names=tuple(task.data.names),
    )


def _solution(loop: Loop, task: CascadeTask, value: Tracking) -> Solution[Tracking]:
    bad = np.array(
        [
            np.any(has_diverged(held[first:].T))
            for held, first in zip(value.limited, task.start, strict=True)
        ]
    )
    short = np.array([s >= len(r) for s, r in zip(task.start, task.data, strict=True)])
    codes = np.where(short, STATUS_NAMES.index("too_short"), 0)
    codes = np.where(bad, STATUS_NAMES.index("diverged"), codes)
    stats: dict[str, Any] = {
        "record_status": codes,
        "nrmse": value.nrmse(),
        "at_range": np.array([m.mean(axis=0) for m in value.at_range]),
        "at_rate": np.array([m.mean(axis=0) for m in value.at_rate]),
        "held": np.array([m.sum(axis=0) for m in value.held]),
    }
    if bad.any():
        n = int(np.argmax(bad))
        held = value.limited[n]
        step = int(np.argmax(held.any(axis=1)))
        channel = value.output_names[int(np.argmax(held[step]))]
        row = step + task.data.records[n].start_row
        stats |= {"record": n, "row": row, "first_bad_step": step, "channel": channel}
        stats["time"] = step * task.data.sample_time
        detail = (
            f"{channel} leaves its bounds in record {value.names[n]!r} first at sample "
            f"{step}; {int(bad.sum())} of {len(bad)} records"
        )
        return Solution(value, RESULTS.diverged, stats, detail)
    if short.any():
        detail = (
            f"record {value.names[int(np.argmax(short))]!r} has no {loop.history} "
            "valid samples in a row to start from"
        )
        return Solution(value, RESULTS.too_short, stats, detail)
    return Solution(value, RESULTS.ok, stats)
