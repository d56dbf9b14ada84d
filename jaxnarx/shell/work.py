"""What the commands do."""

import math
import os
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxnarx.errors import DataError, DataFileError, SpecError
from jaxnarx.shell import commands
from jaxnarx.shell.progress import count, say

if TYPE_CHECKING:
    from jaxnarx.data import Channels, Dataset, LagSuggestion, Split
    from jaxnarx.evaluation import Report as Scores
    from jaxnarx.models import Network

RUN = ("model.safetensors", "report.json", "report.html")
"""Files of a run; one that is there already is not overwritten without --force."""


def run(command: commands.Command, *, typed: str) -> int:
    """Run one command; returns the exit code. `typed` is what the user wrote."""
    if isinstance(command, commands.Check):
        return _check(command)
    if isinstance(command, commands.Prepare):
        return _prepare(command)
    _configure()
    if isinstance(command, commands.Demo):
        return _demo(command, typed)
    if isinstance(command, commands.SimulateEngine):
        return _simulate_engine(command, typed)
    if isinstance(command, commands.Identify):
        return _identify(command, typed)
    if isinstance(command, commands.Simulate):
        return _simulate(command)
    return _report(command, typed)


def _configure() -> None:
    """float64 and a compilation cache: set here, never by the library."""
    import jax

    jax.config.update("jax_enable_x64", True)
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    cache = Path(home) / "jaxnarx" / "compiled"
    try:
        cache.mkdir(parents=True, exist_ok=True)
    except OSError:
        return
    jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)


def _next(*words: str, then: str = "") -> None:
    """The next sensible command, quoted for the shell."""
    say(f"\nNext: {shlex.join(words)}{then}")


@contextmanager
def _about(source: str) -> Iterator[None]:
    """What is wrong with the contents of a file is not wrong usage."""
    try:
        yield
    except SpecError as error:
        lead = "" if source in str(error) else f"{source}: "
        raise DataFileError(f"{lead}{error}", path=source) from error


def _read(path: str, root: str | None) -> "Split":
    from jaxnarx.data import read_split

    if not path.lower().endswith(".toml"):
        raise SpecError(
            f"{path} is not a TOML description. Write one that names channels, units, "
            "sample time and files; `jaxnarx check --help` shows the smallest."
        )
    with _about(path):
        return read_split(path, root=root)


def _check(command: commands.Check) -> int:
    import json

    from jaxnarx.data import check, suggest_lags

    split = _read(command.description, command.root)
    data = split.train if split.train is not None else split.all
    findings, lags = check(data), suggest_lags(data)
    status = 0 if findings.is_okay else 3
    if command.json:
        found = {"findings": findings.to_dict(), "lags": _lags(lags)}
        say(json.dumps(found, allow_nan=False, indent=1))
        return status
    which = "" if split.train is None else " for training"
    say(f"{_size(data)}{which}")
    say(f"{findings}\n\n{lags}")
    root = () if command.root is None else ("--root", command.root)
    if status:
        _next("jaxnarx", "check", command.description, *root, then=", errors corrected")
        return status
    words = ["jaxnarx", "identify", command.description, *root]
    words += ["--output", data.channels.output_names[0]]
    words += ["--input-lags", *map(str, lags.input_lags)]
    _next(*words, "--output-lags", *map(str, lags.output_lags))
    return status


def _prepare(command: commands.Prepare) -> int:
    from jaxnarx.shell.prepare import make_steps, write_prepared

    steps = make_steps(command)
    split = _read(command.description, command.root)
    _next_check(write_prepared(split, steps, command.out, force=command.force))
    return 0


def _simulate_engine(command: commands.SimulateEngine, typed: str) -> int:
    from jaxnarx.shell.simulate_engine import simulate_engine

    _next_check(simulate_engine(command, typed))
    return 0


def _next_check(file: Path) -> None:
    """Advise to look at a description that was just written."""
    # the variable would send the reader of the new files to the old ones
    elsewhere = os.environ.get("JAXNARX_DATA")
    root = ("--root", str(file.parent)) if elsewhere else ()
    _next("jaxnarx", "check", str(file), *root)


def _size(data: "Dataset") -> str:
    return (
        f"{count(len(data), 'record')}, {count(data.samples, 'sample')} at "
        f"{data.sample_time:g} s"
    )


def _lags(lags: "LagSuggestion") -> dict[str, Any]:
    pairs = [
        {
            "input": u,
            "output": y,
            "dead_time": lags.dead_time[u, y],
            "settling": lags.settling[u, y],
        }
        for u, y in lags.dead_time
    ]
    return {
        "input_lags": list(lags.input_lags),
        "output_lags": list(lags.output_lags),
        "unit": "samples",
        "sample_time": lags.sample_time,
        "pairs": pairs,
    }


def _demo(command: commands.Demo, typed: str) -> int:
    import jax

    from jaxnarx.engines import pfi_siso_records
    from jaxnarx.methods import ForwardOLS, Lolimot, SimulationError
    from jaxnarx.shell.identify import Plan, identify
    from jaxnarx.shell.output import run_folder

    if command.events < 200:
        raise SpecError("--events must be at least 200", field="events")
    plan = Plan(
        outputs=("speed",),
        input_lags=(2, 3, 4, 6, 8, 12, 16, 24),
        output_lags=(1, 2),
        degree=1,
        select=ForwardOLS(max_terms=10),
        grow=Lolimot(scheduling=("duty[t-3]", "speed[t-1]"), max_models=command.models),
        refine=SimulationError(),
        command=typed,
    )
    with run_folder(command.out, "demo", force=command.force, marks=RUN) as folder:
        say(
            f"Simulating the port-injected engine: 3 records of {command.events} events"
        )
        data = pfi_siso_records(jax.random.key(command.seed), (command.events,) * 3)
        parts = {"train": data[0], "validate": data[1], "test": data[2]}
        _, runs = identify(plan, parts, folder)
    if not runs:
        _warn("the model does not stay within its bounds; give it more --events")
    say(f"\nOpen {folder / 'report.html'}")
    _next("jaxnarx", "check", "engine.toml", then="  (a description of your records)")
    return 0


def _identify(command: commands.Identify, typed: str) -> int:
    from jaxnarx.shell.identify import identify, make_plan, prepared_by
    from jaxnarx.shell.output import run_folder

    _require_finite("require_fit", command.require_fit)
    plan = make_plan(command, typed)
    split = _read(command.description, command.root)
    plan = prepared_by(split.preparation, plan.on(split.all.channels))
    name = f"{Path(command.description).stem}-{'-'.join(plan.outputs[:3])}"
    with run_folder(command.out, name, force=command.force, marks=RUN) as folder:
        parts = _parts(split, command.hold_out)
        result, runs = identify(plan, parts, folder)
    say(f"\nOpen {folder / 'report.html'}")
    model = str(folder / "model.safetensors")
    if runs:
        _next("jaxnarx", "simulate", model, "new_run.csv")
    else:
        _warn(
            "the model does not stay within its bounds when it runs freely. Try fewer "
            "terms, a lower degree, other lags or more data."
        )
        _next("jaxnarx", "check", command.description)
    return _verdict(result, command.require_fit)


def _parts(split: "Split", share: float) -> "dict[str, Dataset]":
    from jaxnarx.data import hold_out

    train = split.train if split.train is not None else split.all
    validate = split.validate
    say(f"{_size(train)} for training")
    if validate is None:
        train, validate = hold_out(train, share=share)
        say("Held out for validation: " + ", ".join(validate.names))
    parts = {"train": train, "validate": validate}
    return parts if split.test is None else parts | {"test": split.test}


def _require_finite(option: str, value: float | None) -> None:
    if value is not None and not math.isfinite(value):
        raise SpecError(f"--{option.replace('_', '-')} must be a number, got {value}")


def _warn(text: str) -> None:
    print(f"jaxnarx: {text}", file=sys.stderr)


def _verdict(report: "Scores", required: float | None) -> int:
    if required is None:
        return 0
    status = 0
    for channel in report.outputs:
        fit = report.pooled(channel.name).fit
        if fit is None or not fit >= required:
            got = "no figure (it diverges)" if fit is None else f"{fit:.1f} %"
            _warn(
                f"the free-run fit of {channel.name} on {report.main} is {got}, below "
                f"the required {required:g} %"
            )
            status = 1
    return status


def _simulate(command: commands.Simulate) -> int:
    from jaxnarx.models import load
    from jaxnarx.shell import output
    from jaxnarx.simulation import predict, simulate

    steps = command.steps
    if not command.files:
        raise SpecError("give data files or one TOML description")
    if steps is not None and steps < 1:
        raise SpecError(f"--steps must be at least 1, got {steps}")
    network = load(command.model)
    data = _new_data(command, network)
    if steps is not None and steps + network.history > max(map(len, data)):
        raise SpecError(
            f"--steps {steps} is beyond the longest record, of "
            f"{count(max(map(len, data)), 'sample')}"
        )
    files = output.file_names(data.names)
    with output.run_folder(command.out, "", force=command.force, marks=files) as folder:
        with _about(command.files[0]):
            if steps is None:
                solution = simulate(network, data)
            else:
                solution = predict(network, data, steps)
        kind = "simulated" if steps is None else "predicted"
        with output.written_together(folder) as place:
            for n, file in enumerate(files):
                text = output.trajectory_csv(solution.value, data, n, kind)
                output.write_text(place / file, text)
    for file in files:
        say(f"wrote {folder / file}")
    if solution.detail:
        _warn(f"{solution.status_name}: {solution.detail}")
    _next("jaxnarx", "report", command.model, "engine.toml", then="  (to score it)")
    return 0


def _new_data(command: commands.Simulate, network: "Network") -> "Dataset":
    """The records, with the model's channels in its order; prepared if asked to be."""
    from jaxnarx.shell.prepare import as_trained, raw_channels, stored

    known = stored(command.model)
    if not command.prepare:
        if known is not None:
            say(
                "The model was identified from prepared records; files must be "
                "prepared likewise (--prepare does it to raw ones):\n"
                f"{known.describe()}"
            )
        return _records(command, network.channels, float(network.sample_time))
    if known is None:
        raise SpecError(
            f"{command.model} was not identified from prepared records; leave out "
            "--prepare"
        )
    wanted = raw_channels(known, network.channels)
    raw = _records(command, wanted, known.sample_time)
    with _about(command.files[0]):
        return as_trained(known, raw, network.channels)


def _records(
    command: commands.Simulate, channels: "Channels", sample_time: float
) -> "Dataset":
    """The records of a description or of files, with these channels in their order."""
    from jaxnarx.data import match_channels, read_files

    first = command.files[0]
    if any(f.lower().endswith(".toml") for f in command.files):
        if len(command.files) > 1:
            raise SpecError("give one description, or data files, not both")
        split = _read(first, command.root)
        if command.prepare and split.preparation is not None:
            raise SpecError(f"{first} describes prepared records; leave out --prepare")
        with _about(first):
            data, extra = match_channels(split.all, channels)
        say(_size(data) + (f"; ignored: {', '.join(extra)}" if extra else ""))
        return data
    data = read_files(command.files, channels, sample_time=sample_time, missing="mask")
    _require_measured(data, command)
    whose = "raw" if command.prepare else "model's"
    say(
        f"{_size(data)}, the {whose} sample time; read "
        f"{', '.join(data.channels.names)}, ignored any other column"
    )
    return data


def _require_measured(data: "Dataset", command: commands.Simulate) -> None:
    """Inputs must be there always, outputs only where a free run starts."""
    inputs = len(data.channels.inputs)
    needed = inputs if command.steps is None else len(data.channels.names)
    for path, record in zip(command.files, data, strict=True):
        missing = ~record.valid[:, :needed]
        if missing.any():
            s = int(np.argmax(missing.any(axis=0)))
            row = int(np.argmax(missing[:, s]))
            name, gaps = data.channels.names[s], int(missing[:, s].sum())
            why = "a free run needs every input" if s < inputs else "--steps needs it"
            raise DataError(
                f"{path}: {name} has {count(gaps, 'empty or invalid cell')}, first in "
                f"row {record.start_row + row} (t = {row * data.sample_time:g} s); "
                f"{why} in every row. Fill the gap, or cut the file there.",
                channel=name,
                row=row,
            )


def _report(command: commands.Report, typed: str) -> int:
    from contextlib import ExitStack

    from jaxnarx.evaluation import report
    from jaxnarx.models import load
    from jaxnarx.shell.identify import require_rows
    from jaxnarx.shell.output import run_folder, write_report, written_together

    _require_finite("require_fit", command.require_fit)
    network = load(command.model)
    split = _read(command.description, command.root)
    named = {"train": split.train, "validate": split.validate, "test": split.test}
    parts = {k: v for k, v in named.items() if v is not None} or {"data": split.all}
    require_rows(parts, network.history)
    with ExitStack() as stack:
        folder = None
        if command.out is not None:
            folder = stack.enter_context(
                run_folder(command.out, "", force=command.force, marks=RUN[1:])
            )
        with _about(command.description):
            result = report(network, parts, provenance={"command": typed})
        say(str(result))
        if folder is not None:
            with written_together(folder) as place:
                write_report(result, place)
    if folder is not None:
        say(f"\nOpen {folder / 'report.html'}")
        _next("jaxnarx", "simulate", command.model, "new_run.csv")
    else:
        words = ["jaxnarx", "report", command.model, command.description]
        words += [] if command.root is None else ["--root", command.root]
        _next(*words, "--out", "FOLDER", then="  (writes the page with figures)")
    return _verdict(result, command.require_fit)
