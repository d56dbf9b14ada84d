"""Exported files run here: Python in this process, JavaScript by node, C compiled."""

import ctypes
import importlib.util
import json
import re
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxnarx.exporters import form
from jaxnarx.exporters.c_adapt import AdaptiveProgram
from jaxnarx.exporters.compilers import compiler, compilers, load_library
from jaxnarx.exporters.form import SampleProgram
from jaxnarx.exporters.proof import (
    DOUBLE_TOLERANCE,
    SINGLE_TOLERANCE,
    Case,
    ExportError,
    Runner,
    SinglePrecisionError,
    worst,
)
from jaxnarx.exporters.target import Proof
from jaxnarx.files import TemporaryFolder

AdaptationRunner = Callable[
    [Float[np.ndarray, "time inputs"], Float[np.ndarray, "time computed"]],
    tuple[Float[np.ndarray, " coefficients"], Float[np.ndarray, "time reported"]],
]
"""A function that learns from inputs and measured outputs, and gives the coefficients
at the end, output by output, and what was reported."""
ControllerRun = Callable[
    [np.ndarray, np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, ...]
]
"""A function that gives decisions, field by field with a row a sample, for inputs to
begin with, measured outputs of that and every other sample, and references and given
inputs over each one's horizon."""


def import_page(path: Path) -> Any:
    """A module of Python that was written."""
    spec = importlib.util.spec_from_file_location("exported_model", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def python_runner(path: Path) -> Runner:
    """A module that `python_files` has written."""
    module = import_page(path)

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
    """A module that `javascript_files` has written, run by node."""
    program = node()
    assert program is not None

    def run(inputs, measured):
        with TemporaryFolder() as folder:
            module, main = Path(folder, "model.mjs"), Path(folder, "main.mjs")
            module.write_text(path.read_text("utf-8"), "utf-8")
            for name, values in (("u", inputs), ("y", measured)):
                # JSON has no NaN
                Path(folder, name).write_bytes(values.astype("<f8").tobytes())
            main.write_text(_NODE_PAGE)
            done = subprocess.run(
                [program, str(main)], capture_output=True, text=True, cwd=folder
            )
        if done.returncode:
            raise ExportError(f"{path}: node ends with {done.stderr.strip()[-300:]}")
        rows = json.loads(done.stdout)
        return np.array([[np.nan if v is None else v for v in row] for row in rows])

    return run


_NODE_PAGE = """import { readFileSync } from 'node:fs';
import { Model, HISTORY, INPUTS, OUTPUTS } from './model.mjs';
function rows(file, width) {
  const all = new Float64Array(new Uint8Array(readFileSync(file)).buffer);
  return Array.from({ length: all.length / width },
    (_, t) => Array.from(all.subarray(t * width, (t + 1) * width)));
}
const u = rows('u', INPUTS.length), y = rows('y', OUTPUTS.length);
const model = new Model();
model.begin(u[0], y[0]);
for (let t = 0; t < HISTORY; t++) model.observe(u[t], y[t]);
console.log(JSON.stringify(u.slice(HISTORY).map((now) => model.step(now))));
"""


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
    harness.write_text(_HARNESS_PAGE.replace("NAME", name).replace("UPPER", upper))
    chosen = cc or compiler()
    assert chosen is not None
    kind = "single" if single else "double"
    library = build / f"{name}_{kind}_{Path(chosen).name}.so"
    options = ["-O2", *([f"-D{upper}_SINGLE"] if single else [])]
    sources = [folder / f"{name}.c", harness]
    call = load_library(sources, library, options, chosen).run

    def run(inputs, measured):
        u, y = (np.ascontiguousarray(x, float) for x in (inputs, measured))
        out = np.zeros((len(u) - program.history, len(program.reported)))
        pointers = (x.ctypes.data_as(ctypes.c_void_p) for x in (u, y, out))
        call(ctypes.c_int(len(u)), *pointers)
        return out

    return run


_HARNESS_PAGE = """#include "NAME.h"
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


def prove_python(program: SampleProgram, folder: Path, cases: Sequence[Case]) -> Proof:
    """The module of `folder` beside the model."""
    run = python_runner(folder / f"{program.name}.py")
    return {"python": worst(cases, run, DOUBLE_TOLERANCE, "Python")}, []


def prove_javascript(
    program: SampleProgram, folder: Path, cases: Sequence[Case]
) -> Proof:
    """The same, by node."""
    if node() is None:
        return {}, ["javascript: there is no node here"]
    run = javascript_runner(folder / f"{program.name}.mjs")
    return {"javascript": worst(cases, run, DOUBLE_TOLERANCE, "JavaScript")}, []


def prove_c(program: SampleProgram, folder: Path, cases: Sequence[Case]) -> Proof:
    """The same, in the precisions of the program, by every compiler that is here."""
    if compiler() is None:
        return {}, ["c: there is no C compiler here"]
    found: dict[str, float] = {}
    for kind, most in (
        (form.ONLY_DOUBLE, DOUBLE_TOLERANCE),
        (form.ONLY_SINGLE, SINGLE_TOLERANCE),
    ):
        if program.precision not in (kind, form.BOTH):
            continue
        for n, cc in enumerate(compilers()):
            run = c_runner(
                folder, program, folder, single=kind == form.ONLY_SINGLE, cc=cc
            )
            what = f"c, {kind}" + (f", {Path(cc).name}" if n else "")
            try:
                found[what] = worst(cases, run, most, what)
            except ExportError as error:
                if kind == form.ONLY_SINGLE:
                    raise SinglePrecisionError(str(error)) from error
                raise
    return found, []


def adaptation_runner(folder: Path, adaptive: AdaptiveProgram) -> AdaptationRunner:
    """The files of `folder`, compiled there."""
    program = adaptive.program
    name, upper = program.name, program.name.upper()
    sizes = [program.table(p.table).values.size for p in adaptive.parts]
    copies, at = [], 0
    for part, size in zip(adaptive.parts, sizes, strict=True):
        copies.append(f"for (k = 0; k < {size}; k++)")
        copies.append(f"    theta[{at} + k] = a.{part.table}[k];")
        at += size
    page = _LEARNING_PAGE.replace("NAME", name).replace("UPPER", upper)
    harness = folder / "adapt_harness.c"
    harness.write_text(page.replace("COPIES", "\n    ".join(copies)))
    sources = [folder / f"{name}.c", folder / f"{name}_adapt.c", harness]
    call = load_library(sources, folder / f"{name}_adapt.so").run

    def run(inputs, measured):
        u, y = (np.ascontiguousarray(x, float) for x in (inputs, measured))
        theta, reported = np.zeros(at), np.zeros((len(u), len(program.reported)))
        arrays = (u, y, theta, reported)
        pointers = (x.ctypes.data_as(ctypes.c_void_p) for x in arrays)
        call(ctypes.c_int(len(u)), *pointers)
        return theta, reported

    return run


_LEARNING_PAGE = """#include "NAME_adapt.h"
void run(int n, const double *u, const double *y, double *theta, double *reported);
void run(int n, const double *u, const double *y, double *theta, double *reported)
{
    NAME_state s;
    NAME_adaptation a;
    NAME_out out;
    int t, k;
    NAME_begin(&s, u, y);
    NAME_adapt_begin(&a, &s);
    for (t = 0; t < n; t++) {
        NAME_adapt(&a, &u[t * UPPER_INPUTS], &y[t * UPPER_COMPUTED], &out);
        for (k = 0; k < UPPER_REPORTED; k++)
            reported[t * UPPER_REPORTED + k] = out.reported[k];
    }
    COPIES
}
"""


def controller_runner(
    folder: Path, name: str, *, commands: int, limits: int
) -> ControllerRun:
    """The controller of that name in `folder`, with so many commands and limits,
    compiled there."""
    words = {"NAME": name, "UPPER": name.upper()}
    page = re.sub("NAME|UPPER", lambda found: words[found[0]], _CONTROLLER_PAGE)
    harness = folder / "control_harness.c"
    harness.write_text(page)
    sources = [folder / f"{name}_control.c", harness]
    call = load_library(sources, folder / f"{name}_control.so").run

    def run(begun, measured, wanted, given):
        rows = (begun, measured, wanted, given)
        (samples, horizon), outputs = wanted.shape[:2], measured.shape[1]
        shapes = (commands,), (horizon, outputs), (limits,), (outputs,), (2,)
        found = [np.zeros((samples, *shape)) for shape in shapes]
        arrays = [np.append(np.ravel(a).astype(float), 0.0) for a in rows] + found
        pointers = (x.ctypes.data_as(ctypes.c_void_p) for x in arrays)
        call(ctypes.c_int(samples), *pointers)
        *numbers, flags = found
        return (*numbers, *flags.T.astype(bool))

    return run


_CONTROLLER_PAGE = """#include "NAME_control.h"
static void copy(int n, const double *from, double *to)
{
    int k;
    for (k = 0; k < n; k++)
        to[k] = from[k];
}
void run(int n, const double *u, const double *y, const double *wanted,
    const double *given, double *commands, double *outputs, double *excess,
    double *disturbance, double *flags);
void run(int n, const double *u, const double *y, const double *wanted,
    const double *given, double *commands, double *outputs, double *excess,
    double *disturbance, double *flags)
{
    static NAME_controller c;
    NAME_decision now;
    const int width = UPPER_CONTROL_HORIZON * UPPER_CONTROL_OUTPUTS;
    int t;
    NAME_control_begin(&c, u, y);
    for (t = 0; t < n; t++) {
        NAME_control_step(&c, &y[(t + 1) * UPPER_CONTROL_OUTPUTS],
            &wanted[t * UPPER_CONTROL_HORIZON * UPPER_CONTROL_TARGETS],
            &given[t * UPPER_CONTROL_HORIZON * UPPER_CONTROL_GIVEN], &now);
        copy(UPPER_CONTROL_COMMANDS, now.commands,
            &commands[t * UPPER_CONTROL_COMMANDS]);
        copy(width, now.outputs, &outputs[t * width]);
        copy(UPPER_CONTROL_LIMITS, now.excess, &excess[t * UPPER_CONTROL_LIMITS]);
        copy(UPPER_CONTROL_OUTPUTS, now.disturbance,
            &disturbance[t * UPPER_CONTROL_OUTPUTS]);
        flags[2 * t] = now.solved;
        flags[(2 * t) + 1] = now.restarted;
    }
}
"""
