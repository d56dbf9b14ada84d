"""`jaxnarx control`: a predictive controller of a model, its closed loop and its C."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxnarx.control import (
    Command,
    ControlledRun,
    Controller,
    OutputLimit,
    close_loop,
    export_controller,
    mpc,
    tune_effort,
)
from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.exporters import ExportError, identifiers, write_files
from jaxnarx.models import Network, load
from jaxnarx.settings import from_dict
from jaxnarx.shell import output
from jaxnarx.shell.commands import Control
from jaxnarx.shell.description import read_records
from jaxnarx.shell.formats import json_text, table_csv
from jaxnarx.shell.messages import about, say, warn
from jaxnarx.shell.task_file import read_task_file
from jaxnarx.solution import Solution

RESULT_FILE, LOOP_FILE, FIGURE_FILE = "control.json", "loop.csv", "tracking.png"
KEYS = (
    *("targets", "commands", "limits", "horizon", "blocks", "rounds"),
    *("preview", "noise"),
)


@dataclasses.dataclass(frozen=True)
class ControlTask:
    """Arguments of `mpc` and of `close_loop` by name, as a file has them."""

    controller: Mapping[str, Any]
    loop: Mapping[str, Any]


def control_engine(command: Control, typed: str) -> int:
    """Make, try, write, tell; the exit code is 1 where the loop diverges, or the C does
    something else."""
    task = read_control_task(command.task)
    network = load(command.model)
    plants = {path: load(path) for path in command.plant} or {command.model: network}
    records = read_records(command.files, command.root, network)
    (name,) = identifiers([command.name])
    c_files = [f"{name}_control.{ending}" for ending in ("h", "c")]
    marks = [RESULT_FILE, LOOP_FILE, FIGURE_FILE, *c_files]
    with output.run_folder(command.out, "", force=command.force, marks=marks) as folder:
        with about(command.task):
            made = mpc(network, **task.controller, records=records)
        controller, told = made.value, [made.detail]
        with about(command.task, but=("plant",)):
            runs = _close_loops(controller, plants, records, task)
        if command.tune:
            tuned = tune_effort(controller, [*plants.values()], records, **task.loop)
            controller, told = tuned.value, [*told, tuned.detail]
            if tuned.stats["factor"] != 1.0:
                runs = _close_loops(controller, plants, records, task)
        run = next(iter(runs.values()))
        files, proof, fails = _write_c(controller, name)
        remarks = [text for text in (*told, run.detail, *fails) if text]
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
            "c": proof,
            **run.value.to_dict(),
            "plants": {path: one.value.to_dict() for path, one in runs.items()},
        }
        with output.write_together(folder) as place:
            write_files(place, files)
            output.write_text(place / RESULT_FILE, json_text(result))
            output.write_text(place / LOOP_FILE, loop_csv(run.value))
            _draw(run, float(network.sample_time), place / FIGURE_FILE)
    say(str(run.value))
    for remark in remarks:
        say(remark)
    if not run.is_okay:
        warn(f"{run.status_name}: {run.detail}")
    if not files:
        warn("the C of the controller is not written")
    say(f"wrote {', '.join([*files, *marks[:3]])} to {folder}")
    return 0 if run.is_okay and files else 1


def _close_loops(
    controller: Controller,
    plants: Mapping[str, Network],
    records: Dataset,
    task: ControlTask,
) -> dict[str, Solution[ControlledRun]]:
    """The closed loop of every plant; `SpecError` names the file of one that does not
    fit."""
    runs = {}
    for path, plant in plants.items():
        try:
            runs[path] = close_loop(controller, plant, records, **task.loop)
        except SpecError as error:
            if error.field != "plant":
                raise
            raise SpecError(f"{path}: {error}", field="plant") from error
    return runs


def _write_c(
    controller: Controller, name: str
) -> tuple[Mapping[str, Any], dict[str, float], list[str]]:
    """Files of C and their proof, or why there are none."""
    try:
        found = export_controller(controller, name=name)
    except ExportError as error:
        return {}, {}, [str(error)]
    return found.files, dict(found.difference), list(found.left_out)


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
