"""A model, or an inverse in front of a model, on new files."""

import math

import jax.numpy as jnp
import numpy as np

from jaxnarx.confidence import domain, intervals
from jaxnarx.data import Channels, Dataset, match_channels, read_files
from jaxnarx.errors import DataError, SpecError
from jaxnarx.inverse import Tracking, cascade
from jaxnarx.metrics import nrmse
from jaxnarx.models import Network
from jaxnarx.shell import output
from jaxnarx.shell.commands import Simulate
from jaxnarx.shell.description import read_description, tell_notes
from jaxnarx.shell.formats import plain_names, write_columns
from jaxnarx.shell.messages import about, count, quote_command, say, size, warn
from jaxnarx.shell.model_file import load_model
from jaxnarx.shell.next_command import tell_next
from jaxnarx.shell.prepare import (
    prepare_like_training,
    raw_channels,
    stored_preparation,
)
from jaxnarx.simulation import Trajectories, predict, simulate


def simulate_files(command: Simulate) -> int:
    """Run freely, or so many steps ahead; returns the exit code."""
    steps = command.steps
    if not command.files:
        raise SpecError("give data files or one TOML description")
    if steps is not None and steps < 1:
        raise SpecError(f"--steps must be at least 1, got {steps}")
    if steps is not None and command.level is not None:
        raise SpecError("--level is for free runs; leave out --steps")
    network = load_model(
        command.model, no_limits=command.no_limits, outside=command.outside
    )
    data = _new_data(command, network)
    if steps is not None and steps + network.history > max(map(len, data)):
        raise SpecError(
            f"--steps {steps} is beyond the longest record, of "
            f"{count(max(map(len, data)), 'sample')}"
        )
    files = output.file_names(data.names, f".{command.format}")
    with output.run_folder(command.out, "", force=command.force, marks=files) as folder:
        with about(command.files[0]):
            if steps is None:
                solution = simulate(network, data)
            else:
                solution = predict(network, data, steps)
        kind = "simulated" if steps is None else "predicted"
        known = None if network.domain is None else domain(network, data).value
        bounds = None
        if command.level is not None:
            level, run = command.level, solution.value
            bounds = intervals(network, data, level=level, run=run).value
        with output.write_together(folder) as place:
            for n, file in enumerate(files):
                index = None if known is None else known.index[n]
                columns = output.trajectory_columns(
                    solution.value, data, n, kind, index, bounds
                )
                if command.plain_names:
                    names = plain_names(list(columns))
                    columns = dict(zip(names, columns.values(), strict=True))
                write_columns(place / file, columns, float(data.sample_time))
    for file in files:
        say(f"wrote {folder / file}")
    _tell_scores(solution.value, data, kind)
    _tell_held(solution.value)
    if known is not None and known.outside > 0:
        say(
            f"{100 * known.outside:.3g} % of the samples are outside of the model's "
            f"domain (index above 1); farthest: {known.excursions[0]}"
        )
    if solution.detail:
        warn(f"{solution.status_name}: {solution.detail}")
    words = ("jaxnarx", "report", command.model, "engine.toml")
    tell_next(quote_command(*words, remark="  (to score it)"))
    return 0


def follow(command: Simulate, through: str) -> int:
    """The cascade of an inverse and a model over files of references."""
    others = {
        "--steps": command.steps,
        "--prepare": command.prepare,
        "--level": command.level,
        "--plain-names": command.plain_names,
    }
    if command.format != "csv":
        raise SpecError("--through writes CSV; leave out --format")
    for option, given in others.items():
        if given:
            raise SpecError(f"{option} and --through do not go together")
    models = command.model, through
    inverse, forward = (
        load_model(path, no_limits=command.no_limits, outside=command.outside)
        for path in models
    )
    data = _records(command, forward.channels, float(forward.sample_time), inverse)
    files = output.file_names(data.names)
    with output.run_folder(command.out, "", force=command.force, marks=files) as folder:
        with about(command.model):
            solution = cascade(inverse, forward, data)
        with output.write_together(folder) as place:
            for n, file in enumerate(files):
                text = output.tracking_csv(solution.value, data.sample_time, n)
                output.write_text(place / file, text)
    for file in files:
        say(f"wrote {folder / file}")
    _tell_held(solution.value)
    for name, error in zip(
        solution.value.target_names, solution.value.nrmse(), strict=True
    ):
        if math.isfinite(error):
            say(f"{name} follows its reference with an NRMSE of {error:.4f}")
    if solution.detail:
        warn(f"{solution.status_name}: {solution.detail}")
    return 0


def _tell_scores(value: Trajectories, data: Dataset, kind: str) -> None:
    """The error of every output over all samples where it is measured, if there are."""
    for o, name in enumerate(value.output_names):
        at = data.channels.output_names.index(name)
        inputs = len(data.channels.inputs)
        masks = [
            s[:, o] & r.valid[:, inputs + at]
            for s, r in zip(value.scored, data, strict=True)
        ]
        y = [r.y[m, at] for r, m in zip(data, masks, strict=True)]
        found = [x[m, o] for x, m in zip(value.outputs, masks, strict=True)]
        y, yhat = (jnp.asarray(np.concatenate(x))[:, None] for x in (y, found))
        error = float(nrmse(y, yhat, jnp.ones(y.shape, bool))[0])
        if len(y) > 1 and math.isfinite(error):
            samples = count(len(y), "measured sample")
            say(f"{name}: {kind} with an NRMSE of {error:.4f} over {samples}")


def _tell_held(value: Trajectories | Tracking) -> None:
    """Tell how many samples of every output are not what was computed."""
    held = np.concatenate(value.held)
    for name, many in zip(value.output_names, held.sum(axis=0).tolist(), strict=True):
        if many:
            say(
                f"{name}: {count(many, 'sample')} of {len(held)} held at the edge of "
                "the trained range; --no-limits gives what was computed"
            )


def _new_data(command: Simulate, network: Network) -> Dataset:
    """The records, with the model's channels in its order; prepared if asked to be."""
    known = stored_preparation(command.model)
    if not command.prepare:
        if known is not None:
            say(
                "The model was identified from prepared records; files must be "
                "prepared likewise (--prepare does it to raw ones):\n"
                f"{known.describe()}"
            )
        wanted = network.channels.measured
        return _records(command, wanted, float(network.sample_time))
    if known is None:
        raise SpecError(
            f"{command.model} was not identified from prepared records; leave out "
            "--prepare"
        )
    wanted = raw_channels(known, network.channels)
    raw = _records(command, wanted, known.sample_time)
    with about(command.files[0]):
        return prepare_like_training(known, raw, network.channels)


def _records(
    command: Simulate,
    channels: Channels,
    sample_time: float,
    inverse: Network | None = None,
) -> Dataset:
    """The records of a description or of files, with these channels in their order.

    An `inverse` computes some of the inputs; its references are needed throughout.
    """
    first = command.files[0]
    if any(f.lower().endswith(".toml") for f in command.files):
        if len(command.files) > 1:
            raise SpecError("give one description, or data files, not both")
        split = read_description(first, command.root)
        if command.prepare and split.preparation is not None:
            raise SpecError(f"{first} describes prepared records; leave out --prepare")
        with about(first):
            data, extra = match_channels(split.all, channels)
        say(size(data) + (f"; ignored: {', '.join(extra)}" if extra else ""))
        return data
    data = read_files(command.files, channels, sample_time=sample_time, missing="mask")
    tell_notes(data)
    _require_measured(data, command, inverse)
    whose = "raw" if command.prepare else "model's"
    say(
        f"{size(data)}, the {whose} sample time; read "
        f"{', '.join(data.channels.names)}, ignored any other column"
    )
    return data


def _require_measured(
    data: Dataset, command: Simulate, inverse: Network | None
) -> None:
    """Inputs must be there always, outputs only where a free run starts."""
    names = data.channels.names
    needed = names if command.steps is not None else data.channels.input_names
    why = (
        "a free run needs every input" if command.steps is None else "--steps needs it"
    )
    if inverse is not None:
        needed = [n for n in data.channels.input_names if n not in inverse.output_names]
        why = "the inverse needs it"
    at = [names.index(n) for n in needed]
    for path, record in zip(command.files, data, strict=True):
        missing = ~record.valid[:, at]
        if missing.any():
            s = int(np.argmax(missing.any(axis=0)))
            row = int(np.argmax(missing[:, s]))
            raise DataError(
                f"{path}: {needed[s]} has "
                f"{count(int(missing[:, s].sum()), 'empty or invalid cell')}, first in "
                f"row {record.start_row + row} (t = {row * data.sample_time:g} s); "
                f"{why} in every row. Fill the gap, or cut the file there.",
                channel=needed[s],
                row=row,
            )
