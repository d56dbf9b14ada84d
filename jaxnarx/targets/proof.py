"""The proof of an export: what it does beside what the model does, record by record."""

import ctypes
import dataclasses
import importlib.util
import json
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Float

from jaxnarx.data import Dataset
from jaxnarx.data.batch import stack
from jaxnarx.errors import JaxnarxError
from jaxnarx.models import Network
from jaxnarx.simulation import begun, fitting, make_drive, make_masks, simulate
from jaxnarx.targets.form import SampleProgram

DOUBLE, SINGLE = 1e-10, 1e-3
"""Largest difference to the model in shares of an output's largest value; beyond it an
export does not come into being."""

Runner = Callable[
    [Float[np.ndarray, "time inputs"], Float[np.ndarray, "begin computed"]],
    Float[np.ndarray, "time reported"],
]
"""From inputs, and the measured outputs of the history and one sample more."""


class ExportError(JaxnarxError):
    """An export that does not do what the model does, or cannot be compiled."""


def excited(network: Network, samples: int = 400, seed: int = 0) -> Dataset:
    """A record of steps within the trained ranges, for models without records."""
    rng = np.random.default_rng(seed)
    channels = network.channels
    count = len(channels.measured.all)
    low, high = (np.asarray(a, float)[:count] for a in (network.low, network.high))
    hold = max(8, samples // 25)
    levels = rng.uniform(low, high, (samples // hold + 1, count))
    signals = np.repeat(levels, hold, axis=0)[:samples]
    split = len(channels.inputs)
    return Dataset.from_arrays(
        signals[:, :split],
        signals[:, split:],
        inputs=channels.inputs,
        outputs=channels.outputs,
        sample_time=float(network.sample_time),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """A record as targets see it, and what the model reports behind its history.

    `measured` are the outputs, and estimates of hidden channels, up to the sample where
    the free run begins; `window` samples behind that are not compared.
    """

    inputs: Float[np.ndarray, "time inputs"]
    measured: Float[np.ndarray, "begin computed"]
    expected: Float[np.ndarray, "rest reported"]
    window: int

    def difference(self, run: Runner) -> float:
        """Largest difference, in shares of the largest value of its output."""
        found, expected = run(self.inputs, self.measured), self.expected
        found, expected = found[self.window :], expected[self.window :]
        size = np.max(np.abs(np.nan_to_num(expected)), axis=0, keepdims=True)
        off = np.abs(found - expected) / np.where(size > 0, size, 1.0)
        both = np.isnan(found) & np.isnan(expected)
        off = np.where(both, 0.0, off)
        return float(np.max(np.where(np.isnan(off), np.inf, off), initial=0.0))


def cases_of(network: Network, program: SampleProgram, data: Dataset) -> list[Case]:
    """A case for every record whose free run begins right behind the history: one that
    misses samples there proves nothing here."""
    matched = fitting(network, data)
    batch = stack(matched)
    masks = make_masks(network, batch, network.window)
    drive = make_drive(network, batch)
    drive = begun(network, drive, jax.device_put(masks.start))
    gain = np.asarray(network.gain, float)[list(network.signals)]
    scaled = np.asarray(drive.measured, float)
    run = simulate(network, data).value
    names = matched.channels.names
    columns = [names.index(port.name) for port in program.inputs]
    first = program.history
    return [
        Case(
            np.concatenate([record.u, record.y], axis=1)[:, columns].astype(float),
            scaled[n, : first + 1] * gain,
            np.asarray(run[n], float)[first:],
            network.window,
        )
        for n, record in enumerate(matched)
        if int(masks.start[n]) == first and len(record) > first + network.window
    ]


def python_runner(path: Path) -> Runner:
    """A module written by `scripts.python`."""
    spec = importlib.util.spec_from_file_location("exported_model", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)

    def run(inputs, measured):
        model = module.Model()
        model.begin(inputs[0].tolist(), measured[0].tolist())
        history = module.HISTORY
        for u, y in zip(inputs[:history], measured, strict=False):
            model.observe(u.tolist(), y.tolist())
        return np.array([model.step(u.tolist()) for u in inputs[history:]])

    return run


def node() -> str | None:
    """The program that runs JavaScript, where there is one."""
    return shutil.which("node")


def javascript_runner(path: Path) -> Runner:
    """A module written by `scripts.javascript`, run by node."""
    program = node()
    assert program is not None

    def run(inputs, measured):
        with tempfile.TemporaryDirectory() as folder:
            module, main = Path(folder, "model.mjs"), Path(folder, "main.mjs")
            module.write_text(path.read_text("utf-8"), "utf-8")
            case = {"u": inputs.tolist(), "y": measured.tolist()}
            Path(folder, "case.json").write_text(json.dumps(case))
            main.write_text(_NODE)
            done = subprocess.run(
                [program, str(main)], capture_output=True, text=True, cwd=folder
            )
        if done.returncode:
            raise ExportError(f"{path}: node ends with {done.stderr.strip()[-300:]}")
        rows = json.loads(done.stdout)
        return np.array([[np.nan if v is None else v for v in row] for row in rows])

    return run


_NODE = """import { readFileSync } from 'node:fs';
import { Model, HISTORY } from './model.mjs';
const given = JSON.parse(readFileSync('case.json', 'utf8'));
const model = new Model();
model.begin(given.u[0], given.y[0]);
for (let t = 0; t < HISTORY; t++) model.observe(given.u[t], given.y[t]);
console.log(JSON.stringify(given.u.slice(HISTORY).map((u) => model.step(u))));
"""

WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")


def compiler() -> str | None:
    """A C compiler, where there is one."""
    return next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)


def c_runner(
    folder: Path,
    program: SampleProgram,
    build: Path,
    *,
    single: bool,
    cc: str | None = None,
) -> Runner:
    """The C files of `folder`, compiled in `build`; warnings are errors."""
    name, upper = program.name, program.name.upper()
    harness = build / "harness.c"
    harness.write_text(_HARNESS.replace("NAME", name).replace("UPPER", upper))
    library = build / f"{name}_{'single' if single else 'double'}.so"
    chosen = cc or compiler()
    assert chosen is not None
    command = [chosen, *WARNINGS, "-O2", "-fPIC", "-shared", f"-I{folder}"]
    command += [f"-D{upper}_SINGLE"] if single else []
    command += [str(folder / f"{name}.c"), str(harness), "-lm", "-o", str(library)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise ExportError(f"{name}.c does not compile: {done.stderr.strip()[:500]}")
    call = ctypes.CDLL(str(library)).run

    def run(inputs, measured):
        u, y = (np.ascontiguousarray(x, float) for x in (inputs, measured))
        out = np.zeros((len(u) - program.history, len(program.reported)))
        pointers = (x.ctypes.data_as(ctypes.c_void_p) for x in (u, y, out))
        call(ctypes.c_int(len(u)), *pointers)
        return out

    return run


_HARNESS = """#include "NAME.h"
void run(int n, const double *u, const double *y, double *out);
void run(int n, const double *u, const double *y, double *out)
{
    NAME_state s;
    NAME_out now;
    NAME_real a[UPPER_INPUTS], b[UPPER_COMPUTED];
    int t, k;
    for (t = 0; t < n; t++) {
        for (k = 0; k < UPPER_INPUTS; k++) {
            a[k] = (NAME_real)u[t * UPPER_INPUTS + k];
        }
        for (k = 0; k < UPPER_COMPUTED && t <= UPPER_HISTORY; k++) {
            b[k] = (NAME_real)y[t * UPPER_COMPUTED + k];
        }
        if (t == 0) {
            NAME_begin(&s, a, b);
        }
        if (t < UPPER_HISTORY) {
            NAME_observe(&s, a, b);
            continue;
        }
        NAME_step(&s, a, &now);
        for (k = 0; k < UPPER_REPORTED; k++) {
            out[(t - UPPER_HISTORY) * UPPER_REPORTED + k] = (double)now.reported[k];
        }
    }
}
"""


def worst(cases: Sequence[Case], run: Runner, most: float, what: str) -> float:
    """The largest difference of all cases; ExportError where it is more than `most`."""
    found = max(case.difference(run) for case in cases)
    if not found <= most:
        raise ExportError(
            f"the export as {what} differs from the model by {found:.3g} of an "
            f"output's largest value, more than {most:g}; nothing was written"
        )
    return found
