"""MATLAB files run here, by Octave."""

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxnarx.exporters.form import SampleProgram
from jaxnarx.exporters.interpret import LONGEST_SETTLING
from jaxnarx.exporters.matlab import SETTLING_SAMPLES, samples_to_rest
from jaxnarx.exporters.proof import DOUBLE_TOLERANCE, Case, ExportError, Runner, worst
from jaxnarx.exporters.target import Proof

RUN_SAMPLES = 1000
"""Samples of the first record that Octave runs: it interprets every operation."""


def octave() -> str | None:
    """The program that runs MATLAB files, where there is one."""
    return shutil.which("octave-cli") or shutil.which("octave")


def run_octave(folder: Path, code: str) -> str:
    """Run a line of code in a folder and return what it prints; ExportError where it
    fails."""
    program = octave()
    assert program is not None
    words = [program, "--no-gui", "--no-init-file", "--quiet", "--eval", code]
    done = subprocess.run(words, capture_output=True, text=True, cwd=folder)
    if done.returncode:
        raise ExportError(f"Octave ends with {done.stderr.strip()[-300:]}")
    return done.stdout


def octave_runner(folder: Path, program: SampleProgram) -> Runner:
    """The function of `folder`, called sample by sample."""

    def run(inputs, measured):
        for name, values in (("u", inputs), ("y", measured)):
            kind = np.select(
                [np.isnan(values), values == np.inf, values == -np.inf], [1, 2, 3]
            )
            np.savetxt(folder / f"{name}_kind.txt", kind, fmt="%d")
            np.savetxt(folder / f"{name}.txt", np.where(kind, 0.0, values), fmt="%.17g")
        text = run_octave(
            folder, _RUN_PAGE.format(name=program.name, history=program.history)
        )
        return _rows(text, len(program.reported))

    return run


def _rows(text: str, columns: int) -> Float[np.ndarray, "time reported"]:
    return np.array(text.split(), float).reshape(-1, columns)


_RUN_PAGE = """
u = load('-ascii', 'u.txt'); k = load('-ascii', 'u_kind.txt');
u(k == 1) = NaN; u(k == 2) = Inf; u(k == 3) = -Inf;
y = load('-ascii', 'y.txt'); k = load('-ascii', 'y_kind.txt');
y(k == 1) = NaN; y(k == 2) = Inf; y(k == 3) = -Inf;
{name}(u(1, :), 'given', y(1, :));
for t = 1:{history}, {name}(u(t, :), 'observe', y(t, :)); end
for t = {history} + 1:size(u, 1), printf('%.17g\\n', {name}(u(t, :))); end
"""


def prove_matlab(program: SampleProgram, folder: Path, cases: Sequence[Case]) -> Proof:
    """The function of `folder` beside the model over the beginning of the first record,
    and its own test, which knows the starts."""
    if octave() is None:
        return {}, ["matlab: there is no Octave here"]
    run_octave(folder, f"{program.name}_test")
    first, *_, last = (case.truncate(RUN_SAMPLES) for case in (*cases[:1], *cases[-1:]))
    run = octave_runner(folder, program)
    found = worst([first, last], run, DOUBLE_TOLERANCE, "MATLAB function")
    left_out = []
    if (count := samples_to_rest(program, first.inputs[0])) > SETTLING_SAMPLES:
        took = (
            f"{count} samples"
            if count < LONGEST_SETTLING
            else f"more than {LONGEST_SETTLING} samples"
        )
        left_out.append(
            f"matlab: the start 'steady', which takes {took} at the first inputs; the "
            f"test tries it up to {SETTLING_SAMPLES}"
        )
    return {f"matlab by Octave, {len(first.inputs)} samples": found}, left_out
