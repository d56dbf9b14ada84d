"""`jaxnarx calibrate`: maps of a control unit, optimised over a cycle."""

import dataclasses
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from jaxnarx.calibration import (
    Calibratable,
    Calibration,
    CalibrationSearch,
    CalibrationTask,
    CycleLimit,
    Measure,
    optimise,
    read_map,
    require_inputs,
    signals_of,
)
from jaxnarx.data import Channel, Channels, Dataset, read_files
from jaxnarx.errors import SpecError
from jaxnarx.exporters import map_lines, sanitise
from jaxnarx.formatting import count
from jaxnarx.models import Network, load
from jaxnarx.settings import TIME, from_dict
from jaxnarx.shell import output
from jaxnarx.shell.commands import Calibrate
from jaxnarx.shell.description import read_description, tell_notes
from jaxnarx.shell.figures.calibration import UNSEEN, map_picture, trajectories
from jaxnarx.shell.figures.svg import svg
from jaxnarx.shell.formats import json_text, table_csv
from jaxnarx.shell.messages import about, quote_command, say, warn
from jaxnarx.shell.next_command import tell_next
from jaxnarx.shell.plain_page import figure, heading, paragraph, plain_page, table
from jaxnarx.shell.report.html import figure_text
from jaxnarx.shell.task_file import read_task_file

MAPS_FILE, RESULT_FILE, PAGE_FILE = "maps.dcm", "calibration.json", "report.html"
CYCLE_FILE, STATE_FOLDER = "cycle.csv", "state"
SHOWN_POINTS = 3
"""Points of a map that are named as those which matter most."""


def calibrate_maps(command: Calibrate, typed: str) -> int:
    """Optimise, write, tell; the exit code is 1 where a limit is broken."""
    task = read_task(command.maps)
    network = load(command.model)
    cycle = _read_cycle(command, network, task)
    marks = [MAPS_FILE, RESULT_FILE, PAGE_FILE, CYCLE_FILE]
    with output.run_folder(command.out, "", force=command.force, marks=marks) as folder:
        with about(command.maps):
            found = optimise(
                network,
                cycle,
                task.maps,
                task.objective,
                task.limits,
                search=task.search,
                folder=folder / STATE_FOLDER,
                progress=_tell,
            )
        value = found.value
        texts = {
            MAPS_FILE: maps_dcm(value, typed),
            RESULT_FILE: _json(found),
            PAGE_FILE: calibration_page(value, found.detail),
            CYCLE_FILE: _cycle_csv(value),
        }
        with output.write_together(folder) as place:
            for name, text in texts.items():
                output.write_text(place / name, text)
        shutil.rmtree(folder / STATE_FOLDER, ignore_errors=True)
    say(str(value))
    say(found.detail)
    if not found.is_okay:
        warn(f"{found.status_name}: {found.detail}")
    say(f"wrote {', '.join(texts)} to {folder}")
    tell_next(
        quote_command("jaxnarx", "simulate", command.model, str(folder / CYCLE_FILE))
    )
    return 0 if found.is_okay else 1


def read_task(path: str) -> CalibrationTask:
    """Maps, objective, limits and search of a TOML file."""
    given = read_task_file(path, ("maps", "objective", "limits", "search"))
    with about(path):
        return CalibrationTask(
            {
                name: _read_map(name, one, Path(path).parent)
                for name, one in given.get("maps", {}).items()
            },
            [
                from_dict(Measure, one, f"objective[{n}]")
                for n, one in enumerate(given.get("objective", []))
            ],
            [
                _read_limit(one, f"limits[{n}]")
                for n, one in enumerate(given.get("limits", []))
            ],
            from_dict(CalibrationSearch, given.get("search", {}), "search"),
        )


def _read_map(name: str, given: Any, folder: Path) -> Calibratable:
    """A map, begun where a DCM file that is named has it."""
    where = f"maps.{name}"
    if not isinstance(given, dict) or "dcm" not in given:
        return from_dict(Calibratable, given, where)
    rest = {k: v for k, v in given.items() if k not in ("dcm", "block")}
    file, block = given["dcm"], given.get("block", name)
    if not (isinstance(file, str) and isinstance(block, str)):
        raise SpecError(f"{where}: dcm and block are a file and a name", field=where)
    return read_map(folder / file, block, from_dict(Calibratable, rest, where))


def _read_limit(given: dict[str, Any], where: str) -> CycleLimit:
    """A limit whose measure stands in the same table."""
    own = {f.name for f in dataclasses.fields(Measure)} & set(given)
    measure = from_dict(Measure, {k: given[k] for k in own}, where)
    rest = {k: v for k, v in given.items() if k not in own}
    unknown = set(rest) - {"at_most", "at_least", "of_start"}
    if unknown:
        raise SpecError(f"{where} has the unknown key {sorted(unknown)[0]!r}")
    return CycleLimit(measure, **rest)


def _read_cycle(command: Calibrate, network: Network, task: CalibrationTask) -> Dataset:
    """The cycle's records, from a file or a description."""
    first = command.cycle
    if first.lower().endswith(".toml"):
        return read_description(first, command.root).all
    own = network.channels
    require_inputs(task.maps, own.input_names)
    kept = [c for c in own.inputs if c.name not in task.maps]
    known = {c.name for c in (*own.inputs, *own.outputs)} | {TIME}
    asked = [
        n for n in signals_of(task.maps, task.objective, task.limits) if n not in known
    ]
    wanted = Channels((*kept, *(Channel(n) for n in asked)), ())
    with about(first):
        data = read_files(
            [first], wanted, sample_time=float(network.sample_time), missing="mask"
        )
    tell_notes(data)
    return data


def _tell(event: dict[str, Any]) -> None:
    worst = event["worst"]
    held = "all limits kept" if worst <= 0 else f"limits broken by {100 * worst:.2g} %"
    say(
        f"  round {event['round']} of {event['of']} at most: objective "
        f"{event['objective']:.4f}, {held}, {count(event['runs'], 'run')}"
    )


def maps_dcm(value: Calibration, typed: str) -> str:
    """The maps as DCM 2.0."""
    lines = [f"* {sanitise(typed)}", "", "KONSERVIERUNG_FORMAT 2.0"]
    for m in value.maps:
        over = f" over {' and '.join(m.over)}" if m.over else ""
        axes = list(zip(m.axes, m.axis_units, strict=True))
        name = output.slug(m.name).replace("-", "_")
        lines += [
            "",
            *map_lines(name, "calibration", m.name + over, axes, m.unit, m.value),
        ]
    return "\n".join(lines) + "\n"


def _json(found: Any) -> str:
    told = {"status": found.status_name, "detail": found.detail} | found.value.to_dict()
    told |= {"history": found.stats.get("history", [])}
    return json_text(told)


def _cycle_csv(value: Calibration) -> str:
    """Inputs and outputs of the cycle with the maps of after, record by record."""
    names = [c.name for c in value.output_channels]
    header = ["time [s]", *value.input_names, *names]
    rows = [
        np.column_stack([np.arange(len(u)) * value.sample_time, u, y])
        for u, y in zip(value.inputs, value.outputs, strict=True)
    ]
    return table_csv(header, [c.tolist() for c in np.concatenate(rows).T])


def calibration_page(value: Calibration, detail: str) -> str:
    """The page: measures, maps, trajectories, and which points matter."""
    parts = [paragraph(detail + "."), _measures(value)]
    parts.append(heading("Maps"))
    for n, m in enumerate(value.maps):
        unseen = int((m.visits < UNSEEN).sum())
        if unseen:
            text = f"{count(unseen, 'point')} of {m.name} that the cycle never visits"
            parts.append(paragraph(f"Crossed: {text}; roughness alone sets them."))
        if m.axes:
            parts.append(figure(svg(map_picture(m), f"map{n}-", m.name)))
        else:
            text = f"{m.name}: {float(m.start):.5g} before, {float(m.value):.5g} after"
            parts.append(paragraph(f"{text} {m.unit}".strip() + "."))
    parts += [heading("Which points matter"), *_sensitive(value)]
    parts.append(heading("The cycle"))
    for n in range(len(value.inputs)):
        parts.append(figure(svg(trajectories(value, n), f"cycle{n}-", "Cycle")))
    return plain_page("Calibration", parts)


def _measures(value: Calibration) -> Markup:
    rows = [
        [r.name, figure_text(r.start, 5), figure_text(r.value, 5), "", "", ""]
        for r in value.objective
    ]
    rows += [
        [
            r.name,
            figure_text(r.start, 5),
            figure_text(r.value, 5),
            figure_text(r.limit or 0.0, 5),
            figure_text(r.margin or 0.0, 3) + ("" if r.kept else ", broken"),
            figure_text(r.multiplier, 3),
        ]
        for r in value.limits
    ]
    head = ["", "before", "after", "limit", "margin", "price"]
    return table(head, rows)


def _sensitive(value: Calibration) -> list[Markup]:
    """The points by which every measure changes most."""
    parts = [
        paragraph(
            "By how much a measure changes where one point of a map is one unit larger."
        )
    ]
    rows = []
    for m in value.maps:
        for name, slope in m.gradient.items():
            order = np.argsort(-np.abs(slope), axis=None)[:SHOWN_POINTS]
            said = []
            for n in order.tolist():
                at = np.unravel_index(n, slope.shape) if slope.shape else ()
                where = ", ".join(
                    f"{s} {axis[k]:.4g}"
                    for s, axis, k in zip(m.over, m.axes, at, strict=True)
                )
                said.append(f"{where or 'everywhere'}: {slope.flat[n]:+.3g}")
            rows.append([m.name, name, "; ".join(said)])
    return [*parts, table(["map", "measure", "points"], rows)]
