"""Functions of CasADi: the model inside of an optimal control problem.

What one sample takes is written as expressions of CasADi's SX, of which it makes
derivatives and C; acados takes the same expressions for discrete dynamics. Inputs are
finite in an optimisation: what a program keeps for those that are not is left out, and
so are flags. References: J. A. E. Andersson, J. Gillis, G. Horn, J. B. Rawlings, M.
Diehl, CasADi, Mathematical Programming Computation 11, 2019; R. Verschueren and others,
acados, Mathematical Programming Computation 14, 2022.
"""

import dataclasses
import importlib.util
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from string import Template

import numpy as np

from jaxnarx.exporters.code import (
    INFIX_TEMPLATES,
    Syntax,
    comment,
    digits,
    statements,
    value_text,
)
from jaxnarx.exporters.form import Op, SampleProgram, Value
from jaxnarx.exporters.proof import DOUBLE_TOLERANCE, Case, Runner, worst
from jaxnarx.exporters.runners import import_page
from jaxnarx.exporters.scripts import describe_ports, number, sources
from jaxnarx.exporters.target import Files, Golden, Proof

HELD_PREFIX = "held_"
"""Names of the states that keep the last finite value of an input."""


def casadi_files(program: SampleProgram, golden: Golden) -> Files:
    """A module of Python with the functions `step`, `f`, `h`, `begin` and `observe`."""
    del golden
    return {f"{program.name}_casadi.py": _page(without_gaps(program))}


def without_gaps(program: SampleProgram) -> SampleProgram:
    """The program for inputs that are finite: without what is kept for others, without
    flags, and with lines and states that the outputs take alone."""
    ops = list(program.ops)
    for n, op in enumerate(ops):
        if op.kind == "where" and _keeps_input(program, op):
            ops[n] = dataclasses.replace(program.ops[op.args[1]])
    bare = dataclasses.replace(program, ops=tuple(ops), flags={}, limited=())
    needed = bare.state_closure([*bare.outputs])
    used = {op.source for op in (ops[n] for n in needed) if op.source is not None}
    names = {at[0] if isinstance(at, tuple) else at for at in used}
    return dataclasses.replace(
        bare,
        delays=tuple(line for line in bare.delays if line.name in names),
        states=tuple(state for state in bare.states if state.name in names),
        tables=tuple(table for table in bare.tables if table.name in names),
        fed=(),
    )


def _keeps_input(program: SampleProgram, op: Op) -> bool:
    """Whether a value is an input, or its last finite value."""
    new, old = (program.ops[n] for n in op.args[1:])
    kept = old.kind == "state" and str(old.source).startswith(HELD_PREFIX)
    return new.kind == "input" and kept


_SYNTAX = Syntax(
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
    number=number("float('nan')", "float('inf')"),
    assign="{name} = {value}",
)

_PAGE = Template('''"""$about

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

import casadi as ca

SAMPLE_TIME = $sample_time
HISTORY = $history
STATES = $states
INPUTS = $inputs
OUTPUTS = $outputs
MEASURED = $measured
LOW = $low
HIGH = $high

$tables


def _unpack(x):
    return ($unpacked)


def _begin(u, y):
$begin


def _observe(x, u, y):
$observe


def _step(x, u):
$step


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
''')


def _page(program: SampleProgram) -> str:
    kept = [d.name for d in program.delays] + [s.name for s in program.states]
    states = [f"{d.name}[t-{k + 1}]" for d in program.delays for k in range(d.length)]
    states += [s.name for s in program.states]
    ports = program.inputs
    page = _PAGE.substitute(
        about=describe_ports(program),
        sample_time=digits(program.sample_time),
        history=str(program.history),
        states=json.dumps(states),
        inputs=json.dumps([p.name for p in ports]),
        outputs=json.dumps([p.name for p in program.reported]),
        measured=json.dumps([p.name for p in program.computed]),
        low=_list(digits(p.low) for p in ports),
        high=_list(digits(p.high) for p in ports),
        tables="\n".join(_tables(program)),
        unpacked=_tuple(_places(program)),
        begin=_body(
            program,
            program.needed_operations(
                [kept.start for kept in (*program.delays, *program.states)]
            ),
            _vector(
                [
                    *(
                        _text(program, d.start)
                        for d in program.delays
                        for _ in range(d.length)
                    ),
                    *(_text(program, s.start) for s in program.states),
                ]
            ),
        ),
        observe=_body(
            program,
            program.observe,
            _kept(program, measured=True),
            kept,
        ),
        step=_body(
            program,
            program.needed_operations(
                [
                    *program.outputs,
                    *(d.source for d in program.delays),
                    *(s.source for s in program.states),
                ]
            ),
            _kept(program, measured=False)
            + ", "
            + _vector([_text(program, n) for n in program.outputs]),
            kept,
        ),
    )
    return "\n".join(line.rstrip() for line in page.splitlines()) + "\n"


def _places(program: SampleProgram) -> Iterable[str]:
    """What the entries of the state are, line by line."""
    at = 0
    for line in program.delays:
        yield _list(f"x[{n}]" for n in range(at, at + line.length))
        at += line.length
    for _ in program.states:
        yield f"x[{at}]"
        at += 1


def _tables(program: SampleProgram) -> Iterable[str]:
    for table in program.tables:
        numbers = ", ".join(digits(x) for x in table.values.ravel())
        yield f"# {comment(table.about)}"
        yield f"{table.name} = [{numbers}]"


def _body(
    program: SampleProgram,
    needed: Iterable[Value],
    result: str,
    unpacked: Sequence[str] = (),
) -> str:
    lines = [f"    {_tuple(unpacked)} = _unpack(x)"] if unpacked else []
    lines += statements(program, needed, _SYNTAX)
    return "\n".join([*lines, f"    return {result}"])


def _kept(program: SampleProgram, *, measured: bool) -> str:
    """The state that is left for the next sample."""
    entries = []
    for line in program.delays:
        entries.append(_text(program, line.measured if measured else line.source))
        entries += [f"{line.name}[{k}]" for k in range(line.length - 1)]
    entries += [_text(program, s.source) for s in program.states]
    return _vector(entries)


def _text(program: SampleProgram, n: Value) -> str:
    return value_text(program, n, _SYNTAX)


def _vector(entries: Sequence[str]) -> str:
    return f"ca.vertcat({', '.join(entries)})" if entries else "ca.SX(0, 1)"


def _list(entries: Iterable[str]) -> str:
    return f"[{', '.join(entries)}]"


def _tuple(entries: Iterable[str]) -> str:
    return "".join(f"{e}, " for e in entries).rstrip()


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
    return {"casadi": worst(finite, run, DOUBLE_TOLERANCE, "CasADi")}, []
