"""C99: one header, one source, and a self-test with golden vectors."""

import math
import textwrap
from collections.abc import Iterable

from jaxnarx.exporters.c_selftest import selftest
from jaxnarx.exporters.c_start import starts
from jaxnarx.exporters.code import (
    INFIX_TEMPLATES,
    Syntax,
    comment,
    digits,
    statements,
    value_text,
)
from jaxnarx.exporters.form import (
    ONLY_DOUBLE,
    ONLY_SINGLE,
    ParameterTable,
    Port,
    SampleProgram,
    Value,
)
from jaxnarx.exporters.notes import wrap_paragraphs
from jaxnarx.exporters.target import Files, Golden


def sources(program: SampleProgram, golden: Golden) -> Files:
    """Text of every file by its name; `golden` holds `inputs`, `measured` (the history
    and one sample more) and `outputs`, what the free run behind it reports."""
    name = program.name
    return {
        f"{name}.h": _header(program),
        f"{name}.c": _source(program),
        f"{name}_selftest.c": selftest(program, golden),
    }


def c_syntax(program: SampleProgram) -> Syntax:
    """The syntax of C for this program."""
    name = program.name

    def number(x: float) -> str:
        if math.isnan(x):
            return f"({name}_real)NAN"
        if math.isinf(x):
            return f"({'-' if x < 0 else ''}({name}_real)HUGE_VAL)"
        text = f"({name}_real){digits(abs(x))}"
        return f"(-{text})" if x < 0 else text

    one, zero = number(1.0), number(0.0)
    return Syntax(
        source={
            "table": lambda at: f"{name}_{at[0]}[{at[1]}]",
            "input": lambda i: f"u[{i}]",
            "measured": lambda o: f"y[{o}]",
            "delay": lambda at: f"s->{at[0]}[{at[1] - 1}]",
            "state": lambda own: f"s->{own}",
        },
        operation=INFIX_TEMPLATES
        | {
            "max": "({0} > {1}) ? {0} : {1}",
            "min": "({0} < {1}) ? {0} : {1}",
            "less": f"({{0}} < {{1}}) ? {one} : {zero}",
            "where": f"({{0}} > {number(0.5)}) ? {{1}} : {{2}}",
            "exp": f"{name.upper()}_EXP({{0}})",
            "sqrt": f"{name.upper()}_SQRT({{0}})",
        },
        number=number,
        assign=f"const {name}_real {{name}} = {{value}};",
    )


OF_INTERFACE = (
    "2.5 and 8.7, macros and functions of the header are an interface for others."
)
"""Deviations from MISRA rules that every file has."""


def misra_note(deviations: str) -> list[str]:
    """The comment of a file on MISRA rules."""
    about = textwrap.wrap(f"Deviations: {deviations}", 80)
    return [
        "/* Files as this one are checked by cppcheck with its MISRA C:2012 rules.",
        *(f" * {line}" for line in about),
        " */",
    ]


_IEEE_NOTE = (
    "Comparisons tell whether a value is missing, so the compiler must keep to IEEE "
    "754: -ffast-math, -Ofast and -ffinite-math-only are refused."
)
REFUSED_FLAGS = [
    "#ifdef __FAST_MATH__",
    '#error "compile without -ffast-math: a missing input would not be found"',
    "#endif",
    "#ifdef __FINITE_MATH_ONLY__",
    "#if __FINITE_MATH_ONLY__",
    '#error "compile without -ffinite-math-only: a missing input would not be found"',
    "#endif",
    "#endif",
    "",
]


def _unit(program: SampleProgram, flag: str) -> str:
    unit = program.flag_units.get(flag)
    return f" /* {comment(unit)} */" if unit else ""


def _header(program: SampleProgram) -> str:
    name, upper = program.name, program.name.upper()
    lines = [
        f"/* {name}: one sample of a model every {program.sample_time:g} s.",
        " *",
        f" *   {name}_start(&state, {upper}_STEADY, u, NULL);",
        f" *   {name}_step(&state, u, &out);   a sample of the free run: y(t) by u(t)",
        " *",
        " * Physical units. Inputs, then outputs (name [unit], trained range):",
        *(f" *   u[{k}] {_port(p)}" for k, p in enumerate(program.inputs)),
        *(f" *   y[{k}] {_port(p)}" for k, p in enumerate(program.computed)),
        *wrap_paragraphs(program.notes, " * "),
        *wrap_paragraphs([_IEEE_NOTE, f"{program.cost.capitalize()}."], " * "),
        " */",
        f"#ifndef {upper}_H",
        f"#define {upper}_H",
        "",
        *_number_type(program),
        "",
        f"#define {upper}_SAMPLE_TIME {digits(program.sample_time)}",
        f"#define {upper}_HISTORY {program.history}",
        f"#define {upper}_INPUTS {len(program.inputs)}",
        f"#define {upper}_REPORTED {len(program.reported)}",
        f"#define {upper}_COMPUTED {len(program.computed)}",
        f"#define {upper}_PAST {len(program.past)}",
        "",
        "/* What a run starts from, at its first inputs u, as if they had been so for",
        " * ever: the steady state there (solved); outputs in the middle of their",
        " * trained ranges; given outputs y; outputs at zero. Behind given ones,",
        " * observe HISTORY samples of measured history, the first included. */",
        f"#define {upper}_STEADY 0",
        f"#define {upper}_MEAN 1",
        f"#define {upper}_GIVEN 2",
        f"#define {upper}_ZEROS 3",
        "",
        "typedef struct {",
        *(f"    {name}_real {d.name}[{d.length}];" for d in program.delays),
        *(f"    {name}_real {s.name};" for s in program.states),
        *([] if program.delays or program.states else ["    int nothing;"]),
        f"}} {name}_state;",
        "",
        "/* reported: what the model says; fed: what is fed back, hidden channels too;",
        " * limited, and the flags behind it: see above. */",
        "typedef struct {",
        f"    {name}_real reported[{len(program.reported)}];",
        f"    {name}_real fed[{len(program.computed)}];",
        f"    int limited[{len(program.computed)}];",
        *(f"    {name}_real {flag};{_unit(program, flag)}" for flag in program.flags),
        f"}} {name}_out;",
        "",
        "/* Parameters are constants, which a compiler may fold. Where a tool changes",
        f" * them in memory: -D{upper}_PARAMETER=volatile, and with const in flash. */",
        f"#ifndef {upper}_PARAMETER",
        parameter_line(program),
        "#endif",
        "",
        *(
            f"extern {upper}_PARAMETER {name}_real {name}_{t.name}[{t.values.size}];"
            for t in program.tables
        ),
        f"extern const char *const {name}_input_names[{len(program.inputs)}];",
        f"extern const char *const {name}_output_names[{len(program.computed)}];",
        "",
        "/* 0; 1: there is no steady state; 2: there is no such kind. y is looked at",
        " * where it is given. */",
        f"int {name}_start({name}_state *s, int kind, const {name}_real *u, "
        f"const {name}_real *y);",
        "/* as if u and y had been so for ever */",
        f"void {name}_begin({name}_state *s, const {name}_real *u, "
        f"const {name}_real *y);",
        "/* a sample of measured history */",
        f"void {name}_observe({name}_state *s, const {name}_real *u, "
        f"const {name}_real *y);",
        f"/* the steady state at u; samples it took, {upper}_LONGEST: it has none */",
        f"#define {upper}_LONGEST 100000",
        f"int {name}_settle({name}_state *s, const {name}_real *u);",
        f"void {name}_step({name}_state *s, const {name}_real *u, {name}_out *out);",
        "/* slopes of fed by u and by past outputs, as the next step would have them;",
        f" * row by row, {upper}_INPUTS + {upper}_PAST columns */",
        f"void {name}_jacobian(const {name}_state *s, const {name}_real *u, "
        f"{name}_real *slopes);",
        "",
        "#endif",
    ]
    return "\n".join(lines) + "\n"


def _number_type(program: SampleProgram) -> list[str]:
    """The type of numbers; one that is not asked for or not proven does not compile."""
    name, upper = program.name, program.name.upper()
    single = [f"typedef float {name}_real;"]
    if program.precision == ONLY_SINGLE:
        return [f"#ifndef {upper}_SINGLE", f"#define {upper}_SINGLE", "#endif", *single]
    if program.precision == ONLY_DOUBLE:
        single = ['#error "this model is not proven in single precision"']
    return [
        f"#ifdef {upper}_SINGLE",
        *single,
        "#else",
        f"typedef double {name}_real;",
        "#endif",
    ]


def _port(port: Port) -> str:
    unit = f" [{port.unit}]" if port.unit else ""
    return comment(f"{port.name}{unit}, {port.low:.6g} to {port.high:.6g}")


def _source(program: SampleProgram) -> str:
    name, upper = program.name, program.name.upper()
    syntax = c_syntax(program)
    kinds = {op.kind for op in program.ops}
    functions = [f for f in ("exp", "sqrt") if f in kinds]
    lines = [
        *misra_note(OF_INTERFACE),
        f'#include "{name}.h"',
        "",
        "#include <math.h>",
        "",
        *REFUSED_FLAGS,
        f"#ifdef {upper}_SINGLE",
        *(f"#define {upper}_{f.upper()}(x) {f}f(x)" for f in functions),
        f"#define {upper}_STILL ({name}_real)1e-6",
        "#else",
        *(f"#define {upper}_{f.upper()}(x) {f}(x)" for f in functions),
        f"#define {upper}_STILL ({name}_real)1e-10",
        "#endif",
        "",
    ]
    for table in program.tables:
        lines += table_lines(name, table)
    for what, ports in (("input", program.inputs), ("output", program.computed)):
        texts = ", ".join(_quote(p) for p in ports)
        lines.append(
            f"const char *const {name}_{what}_names[{len(ports)}] = {{{texts}}};"
        )
    arguments = f"{name}_state *s, const {name}_real *u"
    lines += [
        "",
        f"void {name}_begin({arguments}, const {name}_real *y)",
        "{",
        *_void_unused(program, program.begin, ("measured", "y"), ("input", "u")),
        *statements(program, program.begin, syntax),
        *_fill_lines(program, syntax),
        "}",
        "",
        f"void {name}_observe({arguments}, const {name}_real *y)",
        "{",
        *_void_unused(program, program.observe, ("measured", "y"), ("input", "u")),
        *statements(program, program.observe, syntax),
        *store_lines(program, syntax, measured=True),
        "}",
        "",
        f"void {name}_step({arguments}, {name}_out *out)",
        "{",
        *_void_unused(program, program.step, ("input", "u")),
        *statements(program, program.step, syntax),
        *told_lines(program, syntax),
        *store_lines(program, syntax, measured=False),
        "}",
        "",
        *starts(program, syntax),
        *_jacobian(program, syntax),
    ]
    return "\n".join(lines) + "\n"


def parameter_line(program: SampleProgram, kind: str = "const") -> str:
    """The line of the header that says of what kind tables of parameters are."""
    return f"#define {program.name.upper()}_PARAMETER {kind}"


def told_lines(program: SampleProgram, syntax: Syntax) -> list[str]:
    """What is told of a sample: `out` is filled."""
    lines = [
        f"    out->{field}[{k}] = {value_text(program, n, syntax)};"
        for field, values in (("reported", program.outputs), ("fed", program.fed))
        for k, n in enumerate(values)
    ]
    for k, n in enumerate(program.limited):
        lines += [
            f"    out->limited[{k}] = 0;",
            f"    if ({value_text(program, n, syntax)} > {syntax.number(0.5)}) {{",
            f"        out->limited[{k}] = 1;",
            "    }",
        ]
    flags = program.flags.items()
    return lines + [
        f"    out->{flag} = {value_text(program, n, syntax)};" for flag, n in flags
    ]


def table_lines(name: str, table: ParameterTable, *, static: bool = False) -> list[str]:
    """A table of parameters, seen by others or by its own file alone."""
    rows = table.values.reshape(table.values.shape[0], -1) if table.values.size else []
    about = comment(table.about + (f" [{table.unit}]" if table.unit else ""))
    kind = "static const" if static else f"{name.upper()}_PARAMETER"
    lines = [
        f"/* {about} */",
        f"{kind} {name}_real {name}_{table.name}[{table.values.size}] = {{",
    ]
    for row in rows:
        numbers = [f"({name}_real){digits(x)}" for x in row]
        for k in range(0, len(numbers), 3):
            lines.append("    " + ", ".join(numbers[k : k + 3]) + ",")
    lines[-1] = lines[-1].rstrip(",")
    return [*lines, "};", ""]


def _quote(port: Port) -> str:
    unit = f" [{port.unit}]" if port.unit else ""
    text = "".join(
        chr(byte) if 32 <= byte < 127 and chr(byte) not in '"\\?' else f"\\{byte:03o}"
        for byte in (port.name + unit).encode()
    )
    return f'"{text}"'


def _void_unused(
    program: SampleProgram, needed: Iterable[Value], *pairs: tuple[str, str]
) -> list[str]:
    kinds = {program.ops[n].kind for n in needed}
    return [f"    (void){argument};" for kind, argument in pairs if kind not in kinds]


def _fill_lines(program: SampleProgram, syntax: Syntax) -> list[str]:
    lines = []
    if any(d.length > 1 for d in program.delays):
        lines.append("    int k;")
    for line in program.delays:
        value = value_text(program, line.start, syntax)
        if line.length > 1:
            lines.append(f"    for (k = 0; k < {line.length}; k++) {{")
            lines.append(f"        s->{line.name}[k] = {value};")
            lines.append("    }")
        else:
            lines.append(f"    s->{line.name}[0] = {value};")
    return lines + [
        f"    s->{state.name} = {value_text(program, state.start, syntax)};"
        for state in program.states
    ]


def store_lines(program: SampleProgram, syntax: Syntax, *, measured: bool) -> list[str]:
    """Every value first, then the assignments: sources may be states themselves."""
    lines, real = [], f"{program.name}_real"
    if any(d.length > 1 for d in program.delays):
        lines.append("    int k;")
    later = []
    for n, line in enumerate(program.delays):
        value = value_text(program, line.measured if measured else line.source, syntax)
        lines.append(f"    const {real} d{n} = {value};")
        if line.length > 1:
            later.append(f"    for (k = {line.length - 1}; k > 0; k--) {{")
            later.append(f"        s->{line.name}[k] = s->{line.name}[k - 1];")
            later.append("    }")
        later.append(f"    s->{line.name}[0] = d{n};")
    for n, state in enumerate(program.states):
        lines.append(
            f"    const {real} x{n} = {value_text(program, state.source, syntax)};"
        )
        later.append(f"    s->{state.name} = x{n};")
    return lines + later


def _jacobian(program: SampleProgram, syntax: Syntax) -> list[str]:
    name = program.name
    needed = program.needed_operations([n for row in program.jacobian for n in row])
    columns = len(program.inputs) + len(program.past)
    return [
        f"void {name}_jacobian(const {name}_state *s, const {name}_real *u, "
        f"{name}_real *slopes)",
        "{",
        *_void_unused(program, needed, ("input", "u")),
        *(
            []
            if {"delay", "state"} & {program.ops[n].kind for n in needed}
            else ["    (void)s;"]
        ),
        *statements(program, needed, syntax),
        *(
            f"    slopes[{o * columns + k}] = {value_text(program, n, syntax)};"
            for o, row in enumerate(program.jacobian)
            for k, n in enumerate(row)
        ),
        "}",
    ]
