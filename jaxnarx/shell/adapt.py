"""`jaxnarx adapt`: a model whose coefficients follow its engine over new records."""

import dataclasses
from typing import Any

import numpy as np

from jaxnarx.errors import SpecError
from jaxnarx.exporters import FMI_VERSIONS, write_files
from jaxnarx.formatting import count
from jaxnarx.linear import adapt, export_adaptation
from jaxnarx.models import Network, load, load_about, save
from jaxnarx.settings import Recursive
from jaxnarx.shell import output
from jaxnarx.shell.commands import Adapt
from jaxnarx.shell.description import read_records
from jaxnarx.shell.figures.adaptation import adaptation_picture
from jaxnarx.shell.figures.svg import svg
from jaxnarx.shell.formats import table_csv
from jaxnarx.shell.messages import about, quote_command, say, size, warn
from jaxnarx.shell.next_command import tell_next
from jaxnarx.shell.plain_page import figure, paragraph, plain_page
from jaxnarx.solution import Solution

MODEL_FILE, WINDOWS_FILE = "model.safetensors", "adaptation.csv"
PAGE_FILE = "report.html"
NOTHING_LEARNT = "stalled", "unidentifiable"
"""Statuses of a model that is what it was."""


def adapt_model(command: Adapt) -> int:
    """Write the model that has followed the records; returns the exit code."""
    if command.fmu not in (None, *FMI_VERSIONS.values()):
        raise SpecError(f"--fmu must be 2 or 3, got {command.fmu}")
    network = load(command.model)
    data = read_records(command.files, command.root, network)
    say(size(data))
    method = _method(command)
    files = {}
    with about(command.model):
        found = adapt(network, data, method)
        if command.c is not None or command.fmu is not None:
            to = ["c"] if command.fmu is None else [f"fmu{command.fmu}"]
            name = command.c or "model"
            files = dict(
                export_adaptation(network, data, method, name=name, to=to).files
            )
    told = {**load_about(command.model), "adapted to": ", ".join(command.files)}
    marks = [MODEL_FILE, WINDOWS_FILE, PAGE_FILE, *files]
    with output.run_folder(command.out, "", force=command.force, marks=marks) as folder:
        with output.write_together(folder) as place:
            save(found.value, place / MODEL_FILE, about=told)
            output.write_text(place / WINDOWS_FILE, windows_csv(found))
            output.write_text(place / PAGE_FILE, adaptation_page(network, found))
            write_files(place, files)
    for line in tell_windows(network, found):
        say(line)
    if found.detail:
        warn(f"{found.status_name}: {found.detail}")
    say(f"wrote {', '.join(marks)} to {folder}")
    words = ("jaxnarx", "report", str(folder / MODEL_FILE), "engine.toml")
    tell_next(quote_command(*words, remark="  (to score it on other records)"))
    return 1 if found.status_name in NOTHING_LEARNT else 0


def _method(command: Adapt) -> Recursive:
    """The settings that were typed."""
    names = {f.name for f in dataclasses.fields(Recursive)}
    typed = {n: v for n, v in vars(command).items() if n in names and v is not None}
    return Recursive(**typed)


def tell_windows(network: Network, found: Solution[Network]) -> list[str]:
    """A line for every output, of the last window; then what was passed over."""
    stats, lines = found.stats, []
    for o, (channel, scale) in enumerate(
        zip(network.output_channels, _trained_widths(network), strict=True)
    ):
        seen = np.flatnonzero(np.isfinite(stats["rmse"][:, o]))
        if not len(seen):
            lines.append(f"{channel.name}: nothing was learnt")
            continue
        now, before, drift = (
            float(stats[k][seen[-1], o]) for k in ("rmse", "rmse_start", "drift")
        )
        unit = f" {channel.unit}" if channel.unit else ""
        lines.append(
            f"{channel.name}: error {now:.4g}{unit} over the last window, {before:.4g} "
            f"by the model as it began; they differ by {drift:.4g}, "
            f"{100 * drift / scale:.2g} % of the trained range"
        )
    outside = int(stats["outside"])
    if outside:
        lines.append(
            f"{count(outside, 'sample')} outside of the model's domain: not learnt from"
        )
    return lines


def adaptation_page(network: Network, found: Solution[Network]) -> str:
    """What was learnt, in sentences and a picture."""
    lines = tell_windows(network, found)
    if found.detail:
        lines.append(f"{found.status_name}: {found.detail}")
    picture = svg(adaptation_picture(found), "adaptation", "Error by window")
    return plain_page("Adaptation", [*map(paragraph, lines), figure(picture)])


def _trained_widths(network: Network) -> np.ndarray:
    own = np.array(network.signals)[: len(network.modelled)]
    wide = np.asarray(network.high, float)[own] - np.asarray(network.low, float)[own]
    return np.where(wide > 0, wide, 1.0)


def windows_csv(found: Solution[Network]) -> str:
    """The end of every window, counted through all records, and its errors."""
    stats = found.stats
    step = stats["window"] * float(found.value.sample_time)
    columns: dict[str, Any] = {
        "time [s]": [step * (n + 1) for n in range(len(stats["undone"]))]
    }
    for o, channel in enumerate(found.value.output_channels):
        unit = f" [{channel.unit}]" if channel.unit else ""
        for kind in ("rmse", "rmse_start", "drift"):
            columns[f"{channel.name} {kind}{unit}"] = stats[kind][:, o].tolist()
        undone = stats["undone"][:, o].astype(int).tolist()
        columns[f"{channel.name} undone"] = undone
    return table_csv(list(columns), list(columns.values()))
