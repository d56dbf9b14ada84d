"""`jaxnarx control`: a predictive controller of a model, its closed loop and its C."""

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxnarx.control import (
    Command,
    ControlledRun,
    OutputLimit,
    close_loop,
    export_controller,
    mpc,
    tune_effort,
)
from jaxnarx.errors import SpecError
from jaxnarx.exporters import write_files
from jaxnarx.models import load
from jaxnarx.settings import from_dict
from jaxnarx.shell import output
from jaxnarx.shell.commands import Control
from jaxnarx.shell.description import read_records
from jaxnarx.shell.formats import table_csv
from jaxnarx.shell.messages import about, say, warn
from jaxnarx.shell.task_file import read_task_file

RESULT_FILE, LOOP_FILE, FIGURE_FILE = "control.json", "loop.csv", "tracking.png"
KEYS = (
    *("targets", "commands", "limits", "horizon", "blocks", "rounds"),
    *("preview", "noise"),
)


@dataclasses.dataclass(frozen=True)
class ControlTask:
    """What a file says: arguments of `mpc` by name, and of `close_loop`."""

    controller: Mapping[str, Any]
    loop: Mapping[str, Any]


def control_engine(command: Control, typed: str) -> int:
    """Make, try, write, tell; the exit code is 1 where the loop diverges."""
    task = read_control_task(command.task)
    network = load(command.model)
    plants = [load(path) for path in command.plant] or [network]
    records = read_records(command.files, command.root, network)
    marks = [RESULT_FILE, LOOP_FILE, FIGURE_FILE]
    with output.run_folder(command.out, "", force=command.force, marks=marks) as folder:
        with about(command.task):
            made = mpc(network, **task.controller, records=records)
        controller, told = made.value, [made.detail]
        if command.tune:
            tuned = tune_effort(controller, plants, records, **task.loop)
            controller, told = tuned.value, [*told, tuned.detail]
        run = close_loop(controller, plants[0], records, **task.loop)
        written = export_controller(controller, name=command.name)
        remarks = [text for text in (*told, run.detail, *written.left_out) if text]
        result = {
            "command": typed,
            "status": run.status_name,
            "remarks": remarks,
            "efforts": dict(
                zip(
                    controller.command_names,
                    np.asarray(controller.effort).tolist(),
                    strict=True,
                )
            ),
            "c": dict(written.difference),
            **run.value.to_dict(),
        }
        with output.write_together(folder) as place:
            write_files(place, written.files)
            output.write_text(place / RESULT_FILE, json.dumps(result, indent=1) + "\n")
            output.write_text(place / LOOP_FILE, loop_csv(run.value))
            _draw(run, float(network.sample_time), place / FIGURE_FILE)
    say(str(run.value))
    for remark in remarks:
        say(remark)
    if not run.is_okay:
        warn(f"{run.status_name}: {run.detail}")
    names = ", ".join([*written.files, *marks])
    say(f"wrote {names} to {folder}")
    return 0 if run.is_okay else 1


def read_control_task(path: str) -> ControlTask:
    """Commands, targets, limits and what the loop is like, of a TOML file."""
    given = read_task_file(path, KEYS)
    with about(path):
        known = ("horizon", "blocks", "rounds")
        controller = {k: given[k] for k in known if k in given}
        controller["commands"] = _read_tables(Command, given, "commands")
        controller["limits"] = _read_tables(OutputLimit, given, "limits")
        controller["targets"] = given.get("targets", [])
    return ControlTask(controller, {k: given[k] for k in KEYS[-2:] if k in given})


def _read_tables(kind: type, given: Mapping[str, Any], key: str) -> dict[str, Any]:
    own = given.get(key, {})
    if not isinstance(own, dict):
        raise SpecError(f"{key} must be tables by name: [{key}.NAME]", field=key)
    return {name: from_dict(kind, one, f"{key}.{name}") for name, one in own.items()}


def loop_csv(run: ControlledRun) -> str:
    """Commands, outputs of the plant and references of the loop, record by record."""
    header = ["record", "time [s]", *run.command_names]
    header += [c.name for c in run.output_channels]
    header += [f"{name} reference" for name in run.target_names]
    rows = []
    parts = zip(run.commands, run.outputs, run.references, strict=True)
    for n, (u, y, wanted) in enumerate(parts):
        time = np.arange(len(u)) * run.sample_time
        rows.append(np.column_stack([np.full(len(u), n + 1), time, u, y, wanted]))
    return table_csv(header, [c.tolist() for c in np.concatenate(rows).T])


def _draw(run: Any, sample_time: float, path: Path) -> None:
    from jaxnarx.shell.figures.style import save
    from jaxnarx.shell.figures.tracking import draw_tracking

    save(draw_tracking({"controller": run}, sample_time), path)
