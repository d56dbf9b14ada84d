"""Scripts, data and policy of a page: all that it needs stands in it."""

import base64
import dataclasses
import hashlib
import json
import re
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
from markupsafe import Markup

from jaxnarx.errors import SpecError
from jaxnarx.evaluation import THIN_CELL, Report
from jaxnarx.exporters import SampleProgram, javascript, lower
from jaxnarx.models import Network
from jaxnarx.shell.report.page import records
from jaxnarx.shell.report.page.records import numbers

SCRIPT_FILES = (
    "codec",
    "dom",
    "run",
    "csv",
    "shown",
    "view",
    "map",
    "try",
    "surface",
    "main",
)
"""The page's own scripts, in the order in which they stand in it."""
MODULE_EXPORTS = ("Model", "HISTORY", "SAMPLE_TIME")
"""What the page uses of an exported module."""


@dataclasses.dataclass(frozen=True)
class Running:
    """The texts that a template puts into a page.

    `scripts` are contents of script elements and `data` that of a block of JSON, safe
    where they stand; `style` belongs to the plotting library. `policy` is the page's
    content security policy: these very scripts, and nothing from anywhere. `told` says
    in what detail the records are there, and is empty without any.
    """

    scripts: tuple[Markup, ...]
    data: Markup
    style: Markup
    policy: str
    told: str
    has_model: bool
    cost: str
    """Operations of the exported model in words."""


def make_page(report: Report) -> Running:
    """Make the texts of a report; without records there are no scripts."""
    program = _program(report.network)
    scripts = []
    told, data = "", "null"
    if report.records:
        kept = records.choose_records(report.records)
        told = kept.told
        data = json.dumps(_values(report, kept, program), allow_nan=False)
        scripts = [
            _library(),
            *([model_script(program)] if program else []),
            page_script(),
        ]
    sources = " ".join(f"'sha256-{_hash(text)}'" for text in scripts) or "'none'"
    policy = (
        f"default-src 'none'; script-src {sources}; style-src 'unsafe-inline'; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )
    return Running(
        tuple(map(Markup, scripts)),
        Markup(data.replace("<", "\\u003c")),
        Markup(_read_vendored("uPlot.min.css") if scripts else ""),
        policy,
        told,
        program is not None,
        "" if program is None else program.cost,
    )


def exported_cost(network: Any) -> str:
    """Operations of a sample of exported code, with the domain index and without; empty
    of what cannot be exported."""
    program = _program(network)
    return "" if program is None else program.cost


def model_script(program: SampleProgram) -> str:
    """The exported module as an inline script that makes the constant `MODEL`.

    Nothing in it ends the script element, whatever channels are called.
    """
    text = javascript(program).replace("\nexport ", "\n")
    exported = ", ".join(MODULE_EXPORTS)
    text = f"const MODEL = (() => {{\n{text}\nreturn {{ {exported} }};\n}})();"
    # Of the code itself only a comparison has this sign, and a blank or = behind it.
    text = re.sub(r"<(?=[^\s=])", r"\\u003c", text)
    return text.encode("ascii", "backslashreplace").decode("ascii")


@cache
def page_script() -> str:
    """The page's own scripts as one."""
    parts = map(read_script, SCRIPT_FILES)
    return "\n".join(["(() => {", '"use strict";', *parts, "})();"])


def read_script(name: str) -> str:
    """One of `SCRIPT_FILES`."""
    folder = resources.files("jaxnarx.shell.report.page")
    return (folder / f"{name}.js").read_text("utf-8")


@cache
def _library() -> str:
    """uPlot under its licence, without the address in its first line."""
    code = _read_vendored("uPlot.iife.min.js").partition("*/")[2].strip()
    licence = _read_vendored("LICENSE").strip()
    return f"/* uPlot 1.6.32\n\n{licence}\n*/\n{code}"


def _read_vendored(name: str) -> str:
    folder = resources.files("jaxnarx.shell.report.page") / "vendor" / "uplot"
    return (folder / name).read_text("utf-8")


def _hash(text: str) -> str:
    digest = hashlib.sha256(text.encode("utf-8")).digest()
    return base64.b64encode(digest).decode("ascii")


def _program(network: Any) -> SampleProgram | None:
    """None of what is no network, or has a validity function of its own."""
    if not isinstance(network, Network):
        return None
    try:
        return lower(network)
    except SpecError:
        return None


def _values(
    report: Report, kept: records.Budget, program: SampleProgram | None
) -> dict[str, Any]:
    first = report.records[0]
    return {
        "sample_time": _sample_time(report),
        "level": report.coverage[0].level if report.coverage else None,
        "outputs": [{"name": c.name, "unit": c.unit} for c in report.outputs],
        "signals": [_signal(report, name) for name in first.signals],
        "others": list(first.others),
        "records": kept.records,
        "maps": [_map(m) for m in report.maps],
        "program": None if program is None else describe_program(program),
        "middles": [] if program is None else _middles(report, program),
    }


def _sample_time(report: Report) -> float:
    """Seconds; of a report without its network that of a trace."""
    if isinstance(report.network, Network):
        return float(report.network.sample_time)
    times = [t.time for t in report.traces if len(t.time) > 1]
    return float(times[0][1] - times[0][0]) if times else 1.0


def _signal(report: Report, name: str) -> dict[str, Any]:
    """Name, unit and range: that of training, else that of the records."""
    network = report.network
    unit, low, high = "", None, None
    if isinstance(network, Network):
        channels = network.channels.measured.all
        at = next((s for s, c in enumerate(channels) if c.name == name), None)
        if at is not None:
            unit = channels[at].unit
            low, high = float(network.low[at]), float(network.high[at])
    if low is None or high is None or not low < high:
        values = np.concatenate([r.signals[name] for r in report.records])
        values = values[np.isfinite(values)]
        low, high = (values.min(), values.max()) if len(values) else (0.0, 1.0)
    return {"name": name, "unit": unit, "low": float(low), "high": float(high)}


def _map(value: Any) -> dict[str, Any]:
    return {
        "output": value.output,
        "unit": value.unit,
        "variables": list(value.variables),
        "edges": numbers(value.edges),
        "rms": numbers(value.rms),
        "bias": numbers(value.bias),
        "spread": numbers(value.spread),
        "samples": value.samples.tolist(),
        "places": value.places.tolist(),
        "thin": THIN_CELL,
    }


def describe_program(program: SampleProgram) -> dict[str, Any]:
    """Describe a program to the page, beside its script."""
    ports = {
        "inputs": program.inputs,
        "reported": program.reported,
        "ports": program.computed,
    }
    found: dict[str, Any] = {
        name: [
            {"name": p.name, "unit": p.unit}
            | {"low": numbers(p.low), "high": numbers(p.high)}
            for p in some
        ]
        for name, some in ports.items()
    }
    flags = list(program.flags)
    halves = {
        port.name: flag
        for port in program.reported
        for flag in flags
        if flag.startswith("half") and flag.endswith(port.name)
    }
    return found | {"flags": flags, "halves": halves}


def _middles(report: Report, program: SampleProgram) -> list[float]:
    """The median of every input over the main part."""
    own = [r for r in report.records if r.part == report.main]
    found = []
    for port in program.inputs:
        values = np.concatenate([r.signals[port.name] for r in own])
        values = values[np.isfinite(values)]
        middle = 0.5 * (port.low + port.high)
        found.append(float(np.median(values)) if len(values) else middle)
    return found
