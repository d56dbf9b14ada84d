"""The verb `export`: files of a model for another program, proven before they exist."""

import dataclasses
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxnarx.checks import choice
from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.guard import guarded
from jaxnarx.models import Network
from jaxnarx.targets import c99, proof, scripts
from jaxnarx.targets.form import SampleProgram
from jaxnarx.targets.interpret import Instance
from jaxnarx.targets.lower import lower
from jaxnarx.targets.proof import DOUBLE, SINGLE, Case

TARGETS = ("c", "python", "javascript")
"""What a model can be exported to."""
GOLDEN = 200
"""Samples of the self-test."""


@dataclasses.dataclass(frozen=True)
class Exported:
    """Files by name, and what the proof has found.

    `difference` is the largest difference to the model's free run over all records, in
    shares of the output's largest value, by what was run (`"c, double"`, `"python"`);
    `left_out` says what could not be run here and why. `operations` are those of one
    sample, `parameters` the numbers in tables, `kept` the numbers that are kept from
    sample to sample.
    """

    files: Mapping[str, str]
    difference: Mapping[str, float]
    left_out: tuple[str, ...]
    operations: int
    parameters: int
    kept: int


@guarded
def export(
    network: Network,
    data: Dataset | None = None,
    *,
    to: Sequence[str] = ("c",),
    name: str = "model",
    verify: bool = True,
) -> Exported:
    """The network as source files that do the same, sample by sample.

    Every target is written from one list of operations (`jaxnarx.targets.form`) and run
    over the records of `data` (without: over steps within the trained ranges) beside
    `simulate`; one that differs by more than 1e-10 of an output's largest value, in
    single precision 1e-3, raises `ExportError`. A run begins from measured history, or
    from the steady state at the first inputs.

    Args:
        network: The model, with any of the package's validity functions.
        data: Records for the proof; those that miss samples of their beginning are
            left out.
        to: `"c"` (C99, a header, a source and a self-test), `"python"`, `"javascript"`.
        name: What the files and their functions are called.
        verify: Whether it is proven.

    Returns:
        The files as texts, and the figures of the proof.

    Example:
        found = jnx.export(network, data, to=["c", "python"], name="NOx")
        print(found.difference, found.files["NOx.h"])
    """
    for one in to:
        choice(one, TARGETS, "to")
    program = lower(network, name)
    records = proof.excited(network) if data is None else data
    cases = proof.cases_of(network, program, records)
    if not cases:
        raise SpecError(
            "no record begins with the complete samples that a proof starts from; give "
            "others, or none",
            field="data",
        )
    files: dict[str, str] = {}
    if "c" in to:
        files |= c99.sources(program, _golden(program, cases[0]))
    if "python" in to:
        files[f"{program.name}.py"] = scripts.python(program)
    if "javascript" in to:
        files[f"{program.name}.mjs"] = scripts.javascript(program)
    difference, left_out = _proven(program, files, cases) if verify else ({}, ())
    lines = sum(line.length for line in program.delays)
    return Exported(
        files,
        difference,
        tuple(left_out),
        program.operations,
        sum(table.values.size for table in program.tables),
        lines + len(program.states),
    )


def _golden(program: SampleProgram, case: Case) -> dict[str, np.ndarray]:
    """A stretch of a record for the self-test, with what the program makes of it."""
    inputs = case.inputs[: program.history + GOLDEN]
    instance = Instance(program)
    instance.begin(inputs[0], case.measured[0])
    for u, y in zip(inputs[: program.history], case.measured, strict=False):
        instance.observe(u, y)
    rows = [instance.step(u)["outputs"] for u in inputs[program.history :]]
    return {"inputs": inputs, "measured": case.measured, "outputs": np.array(rows)}


def _proven(
    program: SampleProgram, files: Mapping[str, str], cases: Sequence[Case]
) -> tuple[dict[str, float], list[str]]:
    """Largest differences by target, and what could not be run."""
    found: dict[str, float] = {}
    left_out: list[str] = []
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for name, text in files.items():
            (folder / name).write_text(text, "utf-8")
        if f"{program.name}.c" in files:
            if proof.compiler() is None:
                left_out.append("c: there is no C compiler here")
            else:
                for kind, most in (("double", DOUBLE), ("single", SINGLE)):
                    run = proof.c_runner(
                        folder, program, folder, single=kind == "single"
                    )
                    found[f"c, {kind}"] = proof.worst(cases, run, most, f"C, {kind}")
        if f"{program.name}.py" in files:
            run = proof.python_runner(folder / f"{program.name}.py")
            found["python"] = proof.worst(cases, run, DOUBLE, "Python")
        if f"{program.name}.mjs" in files:
            if proof.node() is None:
                left_out.append("javascript: there is no node here")
            else:
                run = proof.javascript_runner(folder / f"{program.name}.mjs")
                found["javascript"] = proof.worst(cases, run, DOUBLE, "JavaScript")
    return found, left_out
