"""Functions of CasADi: the model inside of an optimal control problem.

A sample of the model is written as expressions of CasADi's SX, of which CasADi makes
derivatives and C; acados takes the same expressions for discrete dynamics. Inputs are
finite in an optimisation: all that a program keeps for others is left out, and so are
flags. References: J. A. E. Andersson, J. Gillis, G. Horn, J. B. Rawlings, M.
Diehl, CasADi, Mathematical Programming Computation 11, 2019; R. Verschueren and others,
acados, Mathematical Programming Computation 14, 2022.
"""

import importlib.util
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from string import Template

import numpy as np

from jaxnarx.exporters.code import INFIX_TEMPLATES, Syntax, comment, digits
from jaxnarx.exporters.form import ParameterTable, SampleProgram
from jaxnarx.exporters.proof import DOUBLE_TOLERANCE, Case, Runner, worst
from jaxnarx.exporters.runners import import_page
from jaxnarx.exporters.scripts import Language, number, sources, write_page
from jaxnarx.exporters.state_program import name_states, without_gaps
from jaxnarx.exporters.target import Files, Golden, Proof


def casadi_files(program: SampleProgram, golden: Golden) -> Files:
    """A module of Python with the functions `step`, `f`, `h`, `begin` and `observe`."""
    del golden
    bare = without_gaps(program)
    ports = bare.inputs
    extra = {
        "states": json.dumps(list(name_states(bare))),
        "outputs_told": json.dumps([p.name for p in bare.reported]),
        "low": str([float(p.low) for p in ports]),
        "high": str([float(p.high) for p in ports]),
        "unpack": "\n".join(_unpack(bare)),
        "packed": ", ".join(
            [*(f"*{d.name}" for d in bare.delays), *(s.name for s in bare.states)]
        ),
    }
    return {f"{program.name}_casadi.py": write_page(bare, CASADI, extra)}


def _syntax(program: SampleProgram) -> Syntax:
    del program
    return Syntax(
        source=sources("{name}", "{name}", 0, "[{}]"),
        operation=INFIX_TEMPLATES
        | {
            "max": "ca.fmax({0}, {1})",
            "min": "ca.fmin({0}, {1})",
            "less": "{0} < {1}",
            "where": "ca.if_else({0} > 0.5, {1}, {2})",
            "exp": "ca.exp({0})",
            "sqrt": "ca.sqrt({0})",
        },
        number=number("math.nan", "math.inf"),
        assign="{name} = {value}",
    )


def _table(table: ParameterTable) -> list[str]:
    numbers = ", ".join(digits(x) for x in table.values.ravel())
    return [f"# {comment(table.about)}", f"{table.name} = [{numbers}]"]


def _unpack(program: SampleProgram) -> Iterator[str]:
    """Statements that take lines and states from the entries of x."""
    at = 0
    for line in program.delays:
        yield f"    {line.name} = [x[k] for k in range({at}, {at + line.length})]"
        at += line.length
    for state in program.states:
        yield f"    {state.name} = x[{at}]"
        at += 1


CASADI = Language(
    page=Template('''"""$about

    x = begin(u, y)        # as if inputs and outputs had been so for ever
    x = observe(x, u, y)   # for every sample of measured history, if any
    x, y = step(x, u)      # for every sample of the free run

`f` is the next state alone and `h` the outputs, x(t+1) = f(x(t), u(t)), y(t) = h(x(t),
u(t)), in physical units but for the state, whose past outputs are scaled. All are
casadi.Function of SX with Jacobians of every order; for acados,

    model.x, model.u = x, u = ca.SX.sym("x", len(STATES)), ca.SX.sym("u", len(INPUTS))
    model.disc_dyn_expr = f(x, u)
    model.cost_y_expr = h(x, u)

Inputs must be finite. What an export to other targets says of missing inputs, flags and
intervals is left out.
"""

import math

import casadi as ca

SAMPLE_TIME = $sample_time
HISTORY = $history
STATES = $states
INPUTS = $inputs
OUTPUTS = $outputs_told
MEASURED = $outputs
LOW = $low
HIGH = $high

$tables


def _begin(u, y):
$begin
    return ca.vertcat(ca.SX(0, 1), $packed)


def _observe(x, u, y):
$unpack
$observe
    return ca.vertcat(ca.SX(0, 1), $packed)


def _step(x, u):
$unpack
$step
    out = ca.vertcat(*$values)
$keep
    return ca.vertcat(ca.SX(0, 1), $packed), out


_x, _u = ca.SX.sym("x", len(STATES)), ca.SX.sym("u", len(INPUTS))
_y = ca.SX.sym("y", len(MEASURED))
_next, _out = _step(_x, _u)
step = ca.Function("step", [_x, _u], [_next, _out], ["x", "u"], ["x_next", "y"])
f = ca.Function("f", [_x, _u], [_next], ["x", "u"], ["x_next"])
h = ca.Function("h", [_x, _u], [_out], ["x", "u"], ["y"])
begin = ca.Function("begin", [_u, _y], [_begin(_u, _y)], ["u", "y"], ["x"])
observe = ca.Function(
    "observe", [_x, _u, _y], [_observe(_x, _u, _y)], ["x", "u", "y"], ["x_next"]
)
'''),
    syntax=_syntax,
    own="{name}",
    flag="{name}",
    fresh="[0.0] * {length}",
    filled="[{value}] * {length}",
    entered="{line} = [{value}, *{line}[:-1]]",
    set="{name} = {value}",
    row="[{items}]",
    table=_table,
)
"""Expressions of SX; what is kept are local names, packed into the state at the end."""


def casadi_runner(path: Path) -> Runner:
    """The functions that `casadi_files` has written."""
    module = import_page(path)

    def run(inputs, measured):
        x = module.begin(inputs[0], measured[0])
        for u, y in zip(inputs[: module.HISTORY], measured, strict=False):
            x = module.observe(x, u, y)
        rows = []
        for u in inputs[module.HISTORY :]:
            x, y = module.step(x, u)
            rows.append(y.full().ravel())
        return np.array(rows)

    return run


def prove_casadi(program: SampleProgram, folder: Path, cases: Sequence[Case]) -> Proof:
    """The functions of `folder` beside the model, where inputs are finite."""
    if importlib.util.find_spec("casadi") is None:
        return {}, ["casadi: it is not installed here"]
    run = casadi_runner(folder / f"{program.name}_casadi.py")
    finite = [case for case in cases if np.all(np.isfinite(case.inputs))]
    if not finite:
        return {}, ["casadi: no record of the proof has finite inputs throughout"]
    return {"casadi": worst(finite, run, DOUBLE_TOLERANCE, "CasADi")}, []
