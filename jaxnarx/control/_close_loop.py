"""The verb `close_loop`: a controller and a plant, sample by sample."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import program
from jaxnarx.calibration import AbstractPlant, as_plant
from jaxnarx.checks import not_negative, require_known
from jaxnarx.control.controller import Controller
from jaxnarx.control.result import ControlledRun
from jaxnarx.data import Dataset, Record
from jaxnarx.errors import DataError, SpecError
from jaxnarx.formatting import count
from jaxnarx.solution import RESULTS, Solution

Arrays = Array | np.ndarray


class _Rows(NamedTuple):
    """Rows of a record: references, given inputs of the controller, inputs of the
    plant, noise of the sensors."""

    reference: Float[Arrays, "time targets"]
    given: Float[Arrays, "time given"]
    plant: Float[Arrays, "time plant_inputs"]
    noise: Float[Arrays, "time outputs"]


@guard_arguments
def close_loop(
    controller: Controller,
    plant: Any,
    references: Dataset,
    *,
    start: Mapping[str, float | int] | None = None,
    preview: bool = True,
    noise: Mapping[str, float | int] | None = None,
    seed: int = 0,
    every: int = 1,
) -> Solution[ControlledRun]:
    """Run a plant under a controller over records of references.

    Args:
        controller: From `jnx.control.mpc`.
        plant: A network, a virtual engine, or a plant of one's own that makes steps.
        references: Records with a channel for every target, what it shall be, and for
            every other input of controller and plant, what it is; at the controller's
            sample time. No channel may have a gap.
        start: Commands of the rest before the first sample; default: the channels of
            that name in the records, else the middle of the bounds.
        preview: Whether the controller knows references and given inputs over its
            horizon; else it holds those of the present.
        noise: Standard deviations of the sensors by output, in its unit.
        seed: Of the noise.
        every: Events of a virtual engine in one sample.

    Returns:
        `value` is the `ControlledRun`. `stats`: `nrmse` of every target. Status `ok`;
        `diverged` where the plant's outputs are not finite. `detail` names limits that
        were broken, and counts programs without a solution.

    Raises:
        SpecError: the plant lacks an output of the network, or a command.
        DataError: the records lack a channel, or have a gap.

    Example:
        free = {"a": jnx.control.Command(rate=2.0)}
        controller = jnx.control.mpc(network, free, ["y"], horizon=8).value
        print(jnx.control.close_loop(controller, network, data).value)
    """
    body = as_plant(plant, every)
    names = controller.network.output_names
    _require_plant(controller, body)
    own = float(controller.network.sample_time)
    if abs(references.sample_time - own) > 1e-6 * own:
        raise DataError(
            f"the references have a sample every {references.sample_time:g} s, the "
            f"controller one every {own:g} s; resample them"
        )
    spread, begun = ({} if given is None else given for given in (noise, start))
    for name in spread:
        require_known(name, names, "noise", f"noise names {name!r}, no output")
        not_negative(spread[name], "noise")
    for name in begun:
        told = f"start names {name!r}, no command"
        require_known(name, controller.command_names, "start", told)
    places = (
        tuple(body.outputs.index(n) for n in names),
        tuple(body.inputs.index(n) for n in controller.command_names),
    )
    random = np.random.default_rng([seed, 11])
    longest = max(len(r) for r in references)
    tracks = []
    for record in references:
        rows, first = _rows(controller, body, references, record, begun)
        own_noise = np.array([float(spread.get(n, 0.0)) for n in names])
        drawn = random.normal(size=(len(record), len(names))) * own_noise[None]
        padded = _Rows(*(_pad(a, longest) for a in (*rows, drawn)))
        given = jax.device_put((padded, first))
        found = run_loop(controller, body, *given, preview, *places)
        tracks.append([np.asarray(a)[: len(record)] for a in found])
    value = _summarise(controller, references, tracks)
    stats = {"nrmse": value.nrmse()}
    if not all(np.isfinite(y).all() for y in value.outputs):
        return Solution(value, RESULTS.diverged, stats, "the plant's outputs diverge")
    return Solution(value, RESULTS.ok, stats, _describe(value))


@program
def run_loop(
    controller: Controller,
    plant: AbstractPlant,
    rows: _Rows,
    first: Float[Array, " commands"],
    preview: bool,
    outputs: tuple[int, ...],
    inputs: tuple[int, ...],
) -> tuple[Array, ...]:
    """Commands, outputs, measurements, disturbances, and whether each program was
    solved and the network's run begun anew, of one record; pure. `outputs` and `inputs`
    are the places of the network's outputs and of the commands in the plant."""
    time, ahead = rows.reference.shape[0], jnp.arange(controller.horizon)
    columns, set_ = np.array(outputs), np.array(inputs)

    def whole(t, commands):
        return jnp.asarray(rows.plant)[t].at[set_].set(commands)

    def look(a, t, shift):
        """Rows from sample t + shift on, or that of sample t alone."""
        at = jnp.minimum(t + shift + ahead, time - 1) if preview else t + 0 * ahead
        return a[at]

    def sample(carry, t):
        state, now, last = carry
        seen = plant.step(state, whole(t, last))[1][columns]
        measured = seen + rows.noise[t]
        wanted = look(rows.reference, t, controller.first)
        now, decision = controller.step(now, measured, wanted, look(rows.given, t, 0))
        state, y = plant.step(state, whole(t, decision.commands))
        y = y[columns]
        told = decision.commands, y, measured, decision.disturbance
        flags = decision.solved, decision.restarted
        return (state, now, decision.commands), (*told, *flags)

    at_rest = whole(0, first)
    state, y = plant.begin(at_rest)
    row = jnp.zeros(len(controller.commands) + len(controller.given), first.dtype)
    row = row.at[np.array(controller.commands, int)].set(first)
    row = row.at[np.array(controller.given, int)].set(rows.given[0])
    begun = state, controller.begin(row, y[columns]), first
    return jax.lax.scan(sample, begun, jnp.arange(time))[1]


def _require_plant(controller: Controller, plant: AbstractPlant) -> None:
    for name in controller.network.output_names:
        if name not in plant.outputs:
            raise SpecError(
                f"the plant has no output {name!r}; it has {', '.join(plant.outputs)}",
                field="plant",
            )
    for name in controller.command_names:
        if name not in plant.inputs:
            raise SpecError(
                f"the plant has no input {name!r}; it has {', '.join(plant.inputs)}",
                field="plant",
            )
    if abs(plant.sample_time - float(controller.network.sample_time)) > 1e-6:
        raise SpecError(
            f"the plant makes a sample every {plant.sample_time:g} s, the controller "
            f"every {float(controller.network.sample_time):g} s; set `every`",
            field="every",
        )


def _pad(a: np.ndarray, length: int) -> np.ndarray:
    return np.pad(a, ((0, length - len(a)), (0, 0)), mode="edge")


def _column(data: Dataset, record: Record, name: str, told: str) -> np.ndarray:
    """A channel of a record, without gaps."""
    known = data.channels.names
    if name not in known:
        raise DataError(f"the references lack {name}, {told}")
    at = known.index(name)
    values, there = record.signals[:, at], record.valid[:, at]
    if not (there.all() and np.isfinite(values).all()):
        row = int(np.argmin(there & np.isfinite(values)))
        raise DataError(
            f"{name} of the references has no number in row {row} of record "
            f"{record.name!r}"
        )
    return values


def _rows(
    controller: Controller,
    plant: AbstractPlant,
    data: Dataset,
    record: Record,
    start: Mapping[str, float | int],
) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """References, given inputs, inputs of the plant (zeros for commands), and the
    commands to begin with."""
    commands = controller.command_names

    def table(names: list[str], told: str) -> np.ndarray:
        columns = [_column(data, record, n, told) for n in names]
        return np.stack(columns, axis=1) if columns else np.zeros((len(record), 0))

    reference = table(controller.target_names, "which is a target")
    given = table(controller.given_names, "an input that the controller does not set")
    plant_inputs = np.zeros((len(record), len(plant.inputs)))
    for at, name in enumerate(plant.inputs):
        if name not in commands:
            plant_inputs[:, at] = _column(data, record, name, "an input of the plant")
    first = []
    middle = (np.asarray(controller.low) + np.asarray(controller.high)) / 2
    for name, rest in zip(commands, middle, strict=True):
        if name in start:
            first.append(float(start[name]))
        elif name in data.channels.names:
            first.append(float(_column(data, record, name, "a command")[0]))
        else:
            first.append(float(rest))
    return (reference, given, plant_inputs), np.array(first)


def _summarise(
    controller: Controller, references: Dataset, tracks: list[list[np.ndarray]]
) -> ControlledRun:
    network = controller.network
    known = {c.name: c for c in network.channels.all}
    outputs = len(network.modelled)
    floor, ceiling = np.full(outputs, -np.inf), np.full(outputs, np.inf)
    floor[list(controller.bounded)] = np.asarray(controller.floor)
    ceiling[list(controller.bounded)] = np.asarray(controller.ceiling)
    commands, y, measured, disturbances, *flags = zip(*tracks, strict=True)
    wanted = []
    for record in references:
        columns = [references.channels.names.index(n) for n in controller.target_names]
        wanted.append(record.signals[:, columns])
    return ControlledRun(
        command_channels=tuple(known[n] for n in controller.command_names),
        output_channels=tuple(known[n] for n in network.output_names),
        targets=controller.targets,
        names=tuple(references.names),
        sample_time=float(references.sample_time),
        commands=commands,
        outputs=y,
        measured=measured,
        references=tuple(wanted),
        disturbances=disturbances,
        solved=flags[0],
        restarted=flags[1],
        low=np.asarray(controller.low),
        high=np.asarray(controller.high),
        move=np.asarray(controller.move),
        floor=floor,
        ceiling=ceiling,
    )


def _describe(value: ControlledRun) -> str:
    """Broken limits, and programs without a solution."""
    told = []
    over = value.excess()
    for o, channel in enumerate(value.output_channels):
        share = np.mean(over[:, o] > 0)
        if share > 0:
            most = f"{over[:, o].max():.3g} {channel.unit}".strip()
            told.append(
                f"{channel.name} is beyond its limit in {100 * share:.2g} % of "
                f"samples, by {most} at most"
            )
    failed = sum(int((~s).sum()) for s in value.solved)
    if failed:
        told.append(f"in {failed} samples the plan of before went on: no solution")
    if value.restarts:
        told.append(
            "the network's run came to its bounds and began anew from what was "
            f"measured, {count(value.restarts, 'time')}: look at its free run"
        )
    return "; ".join(told)
