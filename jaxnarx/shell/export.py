"""`jaxnarx export`: a model as files for another program."""

import dataclasses
from pathlib import Path

from jaxnarx.data import Dataset
from jaxnarx.exporters import (
    BOTH,
    ONLY_DOUBLE,
    ONLY_SINGLE,
    Exported,
    SampleProgram,
    export,
    write_files,
)
from jaxnarx.fleet import load_prior
from jaxnarx.models import Network, load, set_nan_policy
from jaxnarx.shell import output
from jaxnarx.shell.commands import Export
from jaxnarx.shell.description import read_records
from jaxnarx.shell.messages import about, say, size, warn

README_FILE = "README.md"
EXPENSIVE_INDEX_RATIO = 2.0
"""The index is said to be dear where a sample takes so many times the operations of
the model."""


def export_model(command: Export, typed: str) -> int:
    """Write the files, and what the proof has found; returns the exit code."""
    network = _set_policy(load(command.model), command)
    data = read_records(command.files, command.root, network) if command.files else None
    with about(command.model, but=("over", "name")):
        found = export(
            network,
            data,
            to=command.to,
            name=command.name,
            over=command.map or None,
            index=not command.without_index,
            level=command.level,
            precision=command.precision,
            since=_model_before(command.since),
            verify=not command.unproven,
        )
    files = {**found.files, README_FILE: readme(found, typed, data)}
    marks = list(files)
    with output.run_folder(command.out, "", force=command.force, marks=marks) as folder:
        with output.write_together(folder) as place:
            write_files(place, files)
    for what, difference in found.difference.items():
        say(f"{what}: differs from the model by {difference:.2g} of the largest value")
    for one in found.left_out:
        warn(f"not proven: {one}")
    if command.unproven:
        warn("not proven: --unproven")
    for one, why in found.failed.items():
        warn(f"not written: {one}: {why}")
    cost = found.program.cost
    if found.operations > EXPENSIVE_INDEX_RATIO * found.program.model_operations:
        cost += " (--without-index)"
    say(f"{cost}; {found.parameters} parameters in tables, {found.kept} numbers kept")
    say(f"wrote {', '.join(files)} to {folder}")
    return 1 if found.failed else 0


def _model_before(path: str | None) -> Network | None:
    """The model that is known already: a model file, or the mean of a fleet."""
    if path is None:
        return None
    return load_prior(path).network if Path(path).suffix == ".fleet" else load(path)


def _set_policy(network: Network, command: Export) -> Network:
    """The model with what the command says of inputs that are not finite."""
    if command.nan is None and command.invalid_after is None:
        return network
    policy = set_nan_policy(
        network, command.nan or network.nan, invalid_after=command.invalid_after
    )
    if command.invalid_after is None:
        policy = dataclasses.replace(policy, invalid_after=network.invalid_after)
    return policy


def readme(found: Exported, typed: str, data: Dataset | None) -> str:
    """A page on what was exported, what it takes, and how far it is from the model."""
    program = found.program
    ports = [
        f"| {what} {k} | {_cell(p.name)} | {_cell(p.unit)} | {p.low:.6g} | "
        f"{p.high:.6g} |"
        for what, some in (("input", program.inputs), ("output", program.computed))
        for k, p in enumerate(some)
    ]
    seen = "steps within the trained ranges" if data is None else size(data)
    rows = [f"| {k} | {v:.3g} |" for k, v in found.difference.items()]
    proof = [
        f"Run over {seen} beside the model; largest difference in shares of an "
        "output's largest value:",
        "",
        "| run | difference |",
        "|---|---|",
        *rows,
        *(f"| {one} | not proven |" for one in found.left_out),
        *(
            f"| {one} | not written: {_cell(why)} |"
            for one, why in found.failed.items()
        ),
    ]
    lines = [
        f"# {program.name}",
        "",
        f"`{_cell(typed)}`",
        "",
        f"A sample every {program.sample_time:g} s. A run starts at its first inputs, "
        "as if they had been so for ever: `steady`, in the steady state there (what "
        "most users want); `mean`, with outputs in the middle of their trained ranges; "
        "`zeros`, with outputs at zero; `given`, with measured outputs, and `observe` "
        f"for {program.history} samples of history behind it. `step` takes the inputs "
        "at t and returns the outputs at t, in physical units.",
        "",
        *(line for note in program.notes for line in (note, "")),
        *_units(found, program),
        "| place | name | unit | trained from | to |",
        "|---|---|---|---|---|",
        *ports,
        "",
        "## What it takes",
        "",
        f"- {program.cost}: additions, multiplications, comparisons and functions",
        f"- {found.parameters} parameters in tables: {8 * found.parameters} bytes, "
        f"{4 * found.parameters} in single precision",
        f"- {found.kept} numbers kept from sample to sample: {8 * found.kept} bytes, "
        f"{4 * found.kept} in single precision",
        "",
        "## Tables",
        "",
        *(
            f"- `{t.name}`, {' x '.join(map(str, t.values.shape))}: {t.about}"
            for t in program.tables
        ),
        "",
        "## Proof",
        "",
        *(proof if found.difference or found.left_out else ["None: left out."]),
        *_calibration(program, found),
    ]
    return "\n".join(lines) + "\n"


def _calibration(program: SampleProgram, found: Exported) -> list[str]:
    """A section on the files for calibration, where there are some."""
    name, lines = program.name, []
    if f"{name}.dcm" in found.files and program.changed is not None:
        told = ", ".join(f"`{name}_{n}`" for n in sorted(program.changed)) or "none"
        lines += [
            f"- `{name}.dcm` (DCM 2.0, ISO 8859-1): only the tables that differ from "
            f"those of the model before, {told}. Proven by reading the file back.",
        ]
    elif f"{name}.dcm" in found.files:
        lines += [
            f"- `{name}.dcm` (DCM 2.0, ISO 8859-1): blocks have the names and numbers "
            "of the C arrays, with the digits that read back exactly. Blocks "
            f"`{name}_rest_...` are maps at rest: the free run from the middle of the "
            "trained outputs until it stands still, with inputs that are on no axis in "
            "the middle of their trained ranges. Proven by reading the file back; maps "
            "follow from the program that the other files are proven by.",
            f"- `jaxnarx import-dcm MODEL {name}.dcm` takes changed numbers back.",
        ]
    if f"{name}.a2l" in found.files:
        lines += [
            f"- `{name}.a2l` (A2L 1.71) links to the symbols of `{name}.c` in single "
            "precision. Its head says which variables the program has to hold, and how "
            "addresses come into it. Proven by a2ltool, which reads and checks it.",
        ]
    return ["", "## Calibration", "", *lines] if lines else []


def _units(found: Exported, program: SampleProgram) -> list[str]:
    """A section on what one has to know of a file of FMI or C before it is used."""
    lines = []
    precision = {
        ONLY_DOUBLE: "Numbers are double",
        ONLY_SINGLE: "Numbers are float",
        BOTH: f"`-D{program.name.upper()}_SINGLE` makes it single precision",
    }
    if f"{program.name}.c" in found.files:
        lines += [
            "The C has neither heap nor recursion, and is clean under cppcheck with "
            "its MISRA C:2012 rules but for 2.5 and 8.7: macros and functions of the "
            f"header are an interface. {precision[program.precision]}; `start` knows "
            "the steady state, the mean, given outputs and zeros.",
            "",
        ]
    if any(name.endswith(".fmu") for name in found.files):
        lines += [
            "The parameter `start` of an FMU says what a run starts from: the steady "
            "state at the first inputs (0), outputs in the middle of their trained "
            "ranges (1), the history that the parameters `given...` hold (2), or "
            "outputs at zero (3). It steps by whole samples and holds its inputs; a "
            "step that does not fit is refused. Behind `doStep(t, T)` its outputs are "
            "y(t), by the inputs set at t; in event mode of FMI 3.0 they are y(t) at "
            "t. What else it does is in its documentation/index.html; `sources` are "
            "for other platforms.",
            "",
        ]
    return lines


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("`", "'")
