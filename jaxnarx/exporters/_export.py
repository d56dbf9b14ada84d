"""The verb `export`: files of a model for another program, proven before they exist."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import choice
from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.exporters import c99, octave, proof, runners
from jaxnarx.exporters._acados import acados_files, prove_acados
from jaxnarx.exporters._casadi import casadi_files, prove_casadi
from jaxnarx.exporters._javascript import javascript_files
from jaxnarx.exporters._lower import lower
from jaxnarx.exporters.a2l import a2l_files, prove_a2l
from jaxnarx.exporters.causes import cause
from jaxnarx.exporters.dcm import dcm_files, prove_dcm
from jaxnarx.exporters.fmu import fmu, prove_fmu2, prove_fmu3
from jaxnarx.exporters.form import BOTH, ONLY_DOUBLE, PRECISIONS, SampleProgram
from jaxnarx.exporters.interpret import Instance
from jaxnarx.exporters.maps import choose_axes
from jaxnarx.exporters.matlab import matlab_files
from jaxnarx.exporters.proof import Case, ExportError, SinglePrecisionError
from jaxnarx.exporters.python import python_files
from jaxnarx.exporters.target import Files, Golden, Target, as_bytes
from jaxnarx.extensions import Registry
from jaxnarx.files import TemporaryFolder
from jaxnarx.formatting import page
from jaxnarx.models import HOLD, Network

_OWN_TARGETS: dict[str, Target] = {
    "c": Target("C99: header, source, self-test", c99.sources, runners.prove_c),
    "fmu2": Target("FMI 2.0, co-simulation: binary and source", fmu(2), prove_fmu2),
    "fmu3": Target("FMI 3.0, co-simulation: binary and source", fmu(3), prove_fmu3),
    "python": Target(
        "one page of Python without dependencies",
        python_files,
        runners.prove_python,
    ),
    "javascript": Target(
        "a JavaScript module", javascript_files, runners.prove_javascript
    ),
    "matlab": Target(
        "a MATLAB function and its test", matlab_files, octave.prove_matlab
    ),
    "casadi": Target(
        "functions of CasADi, for optimal control", casadi_files, prove_casadi
    ),
    "acados": Target(
        "C of the state form, as acados links it", acados_files, prove_acados
    ),
    "dcm": Target("DCM 2.0: parameters and maps at rest", dcm_files, prove_dcm),
    "a2l": Target("A2L: names of the C files for a tool", a2l_files, prove_a2l),
}
TARGETS = Registry("target", _OWN_TARGETS)
"""Formats of export."""
GOLDEN_SAMPLES = 200
"""Samples of the self-test."""


@dataclasses.dataclass(frozen=True)
class Exported:
    """Files by name, and what the proof has found.

    `difference` is the largest difference to the model's free run over all records, in
    shares of the output's largest value, by what was run (`"c, double"`, `"python"`);
    `left_out` says what could not be run here and why, `failed` what was run and is not
    among the files, because it does not do what the model does, and why.
    """

    program: SampleProgram
    files: Mapping[str, str | bytes]
    difference: Mapping[str, float]
    left_out: tuple[str, ...]
    failed: Mapping[str, str] = dataclasses.field(default_factory=dict)

    @property
    def operations(self) -> int:
        """The operations of one sample."""
        return self.program.operations

    @property
    def parameters(self) -> int:
        """Numbers in tables."""
        return sum(table.values.size for table in self.program.tables)

    @property
    def kept(self) -> int:
        """Numbers that are kept from sample to sample."""
        lines = sum(line.length for line in self.program.delays)
        return lines + len(self.program.states)

    def __str__(self) -> str:
        """Files with their sizes, what the proof has found, and the cost."""
        lines = [f"Exported: {len(self.files)} files"]
        for name, content in self.files.items():
            lines.append(f"  {name}: {len(content)} bytes")
        proofs = self.difference.items()
        lines += [f"{run}: differs from the model by {d:.2g}" for run, d in proofs]
        lines += [f"not run: {one}" for one in self.left_out]
        lines += [f"not written: {one}: {why}" for one, why in self.failed.items()]
        lines.append(
            f"{self.program.cost}, {self.parameters} numbers in tables, {self.kept} "
            "kept from sample to sample"
        )
        return "\n".join(lines)

    _repr_html_ = page

    @property
    def texts(self) -> dict[str, str]:
        """Files that are text."""
        return {k: v for k, v in self.files.items() if isinstance(v, str)}


@guard_arguments
def export(
    network: Network,
    data: Dataset | None = None,
    *,
    to: Sequence[str] = ("c",),
    name: str = "model",
    over: Sequence[str] | None = None,
    index: bool = True,
    level: float | None = None,
    precision: str = BOTH,
    since: Network | None = None,
    verify: bool = True,
) -> Exported:
    """Export the network as source files that compute the same, sample by sample.

    Every target is written from one list of operations (`jaxnarx.exporters.form`) and
    run over the records of `data` (without: over steps within the trained ranges)
    beside `simulate`; one that differs by more than 1e-10 of an output's largest
    value, in single precision 1e-3, is left out (`Exported.failed`), and `ExportError`
    is raised where none is left. A run begins from measured history, or from the steady
    state at the first inputs. Inputs that are not finite are held, and outputs are as
    the network's `nan` says (`jaxnarx.models.set_nan_policy`); the proof runs over such
    inputs too.

    Args:
        network: The model, with any of the package's validity functions.
        data: Records for the proof; those that miss samples of their beginning are
            left out.
        to: `"c"` (C99, a header, a source and a self-test), `"fmu2"`, `"fmu3"` (FMI for
            co-simulation), `"python"`, `"javascript"`, `"matlab"`, `"casadi"`
            (functions of CasADi, which acados takes too), `"acados"` (C of the next
            state, its Jacobian and Hessian), `"dcm"` (parameters, and maps at rest),
            `"a2l"` (names of the C files for calibration tools), or what is registered
            in `jaxnarx.exporters.TARGETS`.
        name: Name of the files and their functions.
        over: The two inputs that maps at rest go over; default: of each output those
            that schedule it, then those that move it most.
        index: Whether a network that knows its domain tells its index at every sample.
        level: Probability of prediction intervals, whose half widths are told at every
            sample of a network that knows its errors; default without.
        precision: Number types of C that are written and proven: `"double"`,
            `"single"` or `"both"`. With both, a model that single precision cannot
            follow is written for double, and `failed` says why.
        since: The model that a control unit holds already, of the same structure, such
            as the mean of a fleet: `"dcm"` then has only the tables that differ.
        verify: Whether it is proven.

    Returns:
        The files, texts or bytes, and the figures of the proof. Targets that do not
        pass it are not among the files; `failed` names them with the cause.

    Example:
        found = jnx.export(network, data, to=["c", "python"], name="NOx")
        print(found.difference, found.files["NOx.h"])
    """
    for one in to:
        TARGETS.find(one, "to")
    choice(precision, PRECISIONS, "precision")
    program = lower(network, name, index=index, level=level)
    changed = None
    if since is not None:
        changed = _changed_tables(program, lower(since, name, index=index, level=level))
    program = dataclasses.replace(program, precision=precision, changed=changed)
    records = proof.make_steps(network) if data is None else data
    cases = proof.make_cases(network, program, records)
    if not cases:
        raise SpecError(
            "no record begins with the complete samples that a proof starts from; give "
            "others, or none",
            field="data",
        )
    gapped = proof.dropouts(network, records)
    cases += proof.make_cases(network, program, gapped, missing=HOLD)
    axes = {"axes": choose_axes(network, program, over)}
    golden = make_golden(program, cases[0]) | axes
    found = _write_and_prove(program, golden, to, cases, verify)
    if found.failed:
        found = _explain_failures(found, network, records)
    if not found.files:
        told = "; ".join(found.failed.values())
        raise ExportError(f"{told}. Nothing was written.")
    return found


def _changed_tables(program: SampleProgram, before: SampleProgram) -> frozenset[str]:
    """Names of the tables that differ; SpecError where there are others."""
    old = {t.name: t.values for t in before.tables}
    new = {t.name: t.values for t in program.tables}
    if {n: v.shape for n, v in old.items()} != {n: v.shape for n, v in new.items()}:
        raise SpecError(
            "the model before has other tables; what has changed can only be told of "
            "models of one structure",
            field="since",
        )
    return frozenset(n for n, v in new.items() if not np.array_equal(v, old[n]))


def make_golden(program: SampleProgram, case: Case) -> dict[str, np.ndarray]:
    """A stretch of a record for the self-test, with what the program makes of it."""
    inputs = case.inputs[: program.history + GOLDEN_SAMPLES]
    instance = Instance(program)
    instance.begin(inputs[0], case.measured[0])
    for u, y in zip(inputs[: program.history], case.measured, strict=False):
        instance.observe(u, y)
    rows = [instance.step(u)["outputs"] for u in inputs[program.history :]]
    return {"inputs": inputs, "measured": case.measured, "outputs": np.array(rows)}


def _write_and_prove(
    program: SampleProgram,
    golden: Golden,
    to: Sequence[str],
    cases: Sequence[Case],
    verify: bool,
) -> Exported:
    """Targets that are written and pass their proof, and the errors of the others.

    A program that fails in single precision alone is written for double.
    """
    made, found, left_out, failed = Files(), {}, [], {}
    with TemporaryFolder() as place:
        for one in to:
            try:
                files = TARGETS[one].write(program, golden)
                write_files(Path(place), files)
                proof = ({}, [])
                if verify:
                    proof = TARGETS[one].prove(program, Path(place), cases)
            except SinglePrecisionError as error:
                if program.precision != BOTH:
                    failed[f"{one}, single"] = str(error)
                    continue
                double = dataclasses.replace(program, precision=ONLY_DOUBLE)
                again = _write_and_prove(double, golden, to, cases, verify)
                failed = {f"{one}, single": str(error)} | dict(again.failed)
                return dataclasses.replace(again, failed=failed)
            except ExportError as error:
                failed[one] = str(error)
                continue
            made |= files
            found |= proof[0]
            left_out += proof[1]
    return Exported(program, made, found, tuple(left_out), failed)


def _explain_failures(found: Exported, network: Network, data: Dataset) -> Exported:
    """Add the cause of what failed in single precision, as far as it is known."""
    failed = {
        name: f"{text}. {cause(network, data)}" if name.endswith("single") else text
        for name, text in found.failed.items()
    }
    return dataclasses.replace(found, failed=failed)


def write_files(folder: Path, files: Mapping[str, str | bytes]) -> None:
    """The files of an export, in a folder."""
    for name, content in files.items():
        (folder / name).write_bytes(as_bytes(content))
