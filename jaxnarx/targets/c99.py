"""C99: one header, one source, and a self-test with golden vectors."""

import math
from collections.abc import Iterable

import numpy as np

from jaxnarx.targets.code import INFIX, Syntax, digits, shown, statements
from jaxnarx.targets.form import ParameterTable, Port, SampleProgram, Value
from jaxnarx.targets.target import Files, Golden


def sources(program: SampleProgram, golden: Golden) -> Files:
    """Text of every file by its name; `golden` holds `inputs`, `measured` (the history
    and one sample more) and `outputs`, what the free run behind it reports."""
    name = program.name
    return {
        f"{name}.h": _header(program),
        f"{name}.c": _source(program),
        f"{name}_selftest.c": _selftest(program, golden),
    }


def _syntax(program: SampleProgram) -> Syntax:
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
        operation=INFIX
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


def _header(program: SampleProgram) -> str:
    name, upper = program.name, program.name.upper()
    lines = [
        f"/* {name}: one sample of a model every {program.sample_time:g} s.",
        " *",
        f" *   {name}_begin(&state, u, y);     as if u and y had been so for ever",
        f" *   {name}_observe(&state, u, y);   a sample of measured history",
        f" *   {name}_settle(&state, u);       or the steady state at u",
        f" *   {name}_step(&state, u, &out);   a sample of the free run: y(t) by u(t)",
        " *",
        " * Physical units. Inputs, then outputs (name [unit], trained range):",
        *(f" *   u[{k}] {_port(p)}" for k, p in enumerate(program.inputs)),
        *(f" *   y[{k}] {_port(p)}" for k, p in enumerate(program.computed)),
        " */",
        f"#ifndef {upper}_H",
        f"#define {upper}_H",
        "",
        f"#ifdef {upper}_SINGLE",
        f"typedef float {name}_real;",
        "#else",
        f"typedef double {name}_real;",
        "#endif",
        "",
        f"#define {upper}_SAMPLE_TIME {digits(program.sample_time)}",
        f"#define {upper}_HISTORY {program.history}",
        f"#define {upper}_INPUTS {len(program.inputs)}",
        f"#define {upper}_REPORTED {len(program.reported)}",
        f"#define {upper}_COMPUTED {len(program.computed)}",
        f"#define {upper}_PAST {len(program.past)}",
        "",
        "typedef struct {",
        *(f"    {name}_real {d.name}[{d.length}];" for d in program.delays),
        *(f"    {name}_real {s.name};" for s in program.states),
        *([] if program.delays or program.states else ["    int nothing;"]),
        f"}} {name}_state;",
        "",
        "/* reported: what the model says; fed: what is fed back, hidden channels too;",
        " * limited: whether the feedback bound acted; the flags are 1 or 0. */",
        "typedef struct {",
        f"    {name}_real reported[{len(program.reported)}];",
        f"    {name}_real fed[{len(program.computed)}];",
        f"    int limited[{len(program.computed)}];",
        *(f"    {name}_real {flag};" for flag in program.flags),
        f"}} {name}_out;",
        "",
        *(
            f"extern const {name}_real {name}_{t.name}[{t.values.size}];"
            for t in program.tables
        ),
        f"extern const char *const {name}_input_names[{len(program.inputs)}];",
        f"extern const char *const {name}_output_names[{len(program.computed)}];",
        "",
        f"void {name}_begin({name}_state *s, const {name}_real *u, "
        f"const {name}_real *y);",
        f"void {name}_observe({name}_state *s, const {name}_real *u, "
        f"const {name}_real *y);",
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


def _port(port: Port) -> str:
    unit = f" [{port.unit}]" if port.unit else ""
    text = f"{port.name}{unit}, {port.low:.6g} to {port.high:.6g}"
    return text.replace("*/", "* /").replace("\\", "/")


def _source(program: SampleProgram) -> str:
    name, upper = program.name, program.name.upper()
    syntax = _syntax(program)
    lines = [
        f'#include "{name}.h"',
        "",
        "#include <math.h>",
        "",
        f"#ifdef {upper}_SINGLE",
        f"#define {upper}_EXP(x) expf(x)",
        f"#define {upper}_SQRT(x) sqrtf(x)",
        f"#define {upper}_STILL ({name}_real)1e-6",
        "#else",
        f"#define {upper}_EXP(x) exp(x)",
        f"#define {upper}_SQRT(x) sqrt(x)",
        f"#define {upper}_STILL ({name}_real)1e-10",
        "#endif",
        "",
    ]
    for table in program.tables:
        lines += _table(name, table)
    for what, ports in (("input", program.inputs), ("output", program.computed)):
        texts = ", ".join(_quoted(p) for p in ports)
        lines.append(
            f"const char *const {name}_{what}_names[{len(ports)}] = {{{texts}}};"
        )
    arguments = f"{name}_state *s, const {name}_real *u"
    lines += [
        "",
        f"void {name}_begin({arguments}, const {name}_real *y)",
        "{",
        *_unused(program, program.begin, ("measured", "y"), ("input", "u")),
        *statements(program, program.begin, syntax),
        *_filled(program, syntax),
        "}",
        "",
        f"void {name}_observe({arguments}, const {name}_real *y)",
        "{",
        *_unused(program, program.observe, ("measured", "y"), ("input", "u")),
        *statements(program, program.observe, syntax),
        *_kept(program, syntax, measured=True),
        "}",
        "",
        f"void {name}_step({arguments}, {name}_out *out)",
        "{",
        *_unused(program, program.step, ("input", "u")),
        *statements(program, program.step, syntax),
        *(
            f"    out->{field}[{k}] = {shown(program, n, syntax)};"
            for field, values in (("reported", program.outputs), ("fed", program.fed))
            for k, n in enumerate(values)
        ),
        *(
            f"    out->limited[{k}] = ({shown(program, n, syntax)} > "
            f"{syntax.number(0.5)}) ? 1 : 0;"
            for k, n in enumerate(program.limited)
        ),
        *(
            f"    out->{flag} = {shown(program, n, syntax)};"
            for flag, n in program.flags.items()
        ),
        *_kept(program, syntax, measured=False),
        "}",
        "",
        *_settle(program, syntax),
        *_jacobian(program, syntax),
    ]
    return "\n".join(lines) + "\n"


def _table(name: str, table: ParameterTable) -> list[str]:
    rows = table.values.reshape(table.values.shape[0], -1) if table.values.size else []
    lines = [
        f"/* {table.about}" + (f" [{table.unit}]" if table.unit else "") + " */",
        f"const {name}_real {name}_{table.name}[{table.values.size}] = {{",
    ]
    for row in rows:
        numbers = [f"({name}_real){digits(x)}" for x in row]
        for k in range(0, len(numbers), 3):
            lines.append("    " + ", ".join(numbers[k : k + 3]) + ",")
    lines[-1] = lines[-1].rstrip(",")
    return [*lines, "};", ""]


def _quoted(port: Port) -> str:
    unit = f" [{port.unit}]" if port.unit else ""
    text = "".join(
        chr(byte) if 32 <= byte < 127 and chr(byte) not in '"\\?' else f"\\{byte:03o}"
        for byte in (port.name + unit).encode()
    )
    return f'"{text}"'


def _unused(
    program: SampleProgram, needed: Iterable[Value], *pairs: tuple[str, str]
) -> list[str]:
    kinds = {program.ops[n].kind for n in needed}
    return [f"    (void){argument};" for kind, argument in pairs if kind not in kinds]


def _filled(program: SampleProgram, syntax: Syntax) -> list[str]:
    lines = []
    if any(d.length > 1 for d in program.delays):
        lines.append("    int k;")
    for line in program.delays:
        value = shown(program, line.start, syntax)
        if line.length > 1:
            lines.append(f"    for (k = 0; k < {line.length}; k++) {{")
            lines.append(f"        s->{line.name}[k] = {value};")
            lines.append("    }")
        else:
            lines.append(f"    s->{line.name}[0] = {value};")
    return lines + [
        f"    s->{state.name} = {shown(program, state.start, syntax)};"
        for state in program.states
    ]


def _kept(program: SampleProgram, syntax: Syntax, *, measured: bool) -> list[str]:
    """Every value first, then the assignments: sources may be states themselves."""
    lines, real = [], f"{program.name}_real"
    if any(d.length > 1 for d in program.delays):
        lines.append("    int k;")
    later = []
    for n, line in enumerate(program.delays):
        value = shown(program, line.measured if measured else line.source, syntax)
        lines.append(f"    const {real} d{n} = {value};")
        if line.length > 1:
            later.append(f"    for (k = {line.length - 1}; k > 0; k--) {{")
            later.append(f"        s->{line.name}[k] = s->{line.name}[k - 1];")
            later.append("    }")
        later.append(f"    s->{line.name}[0] = d{n};")
    for n, state in enumerate(program.states):
        lines.append(f"    const {real} x{n} = {shown(program, state.source, syntax)};")
        later.append(f"    s->{state.name} = x{n};")
    return lines + later


def _settle(program: SampleProgram, syntax: Syntax) -> list[str]:
    name, upper = program.name, program.name.upper()
    middle = [syntax.number(0.5 * (p.low + p.high)) for p in program.computed]
    width = [syntax.number(p.high - p.low) for p in program.computed]
    count = len(program.computed)
    return [
        f"int {name}_settle({name}_state *s, const {name}_real *u)",
        "{",
        f"    static const {name}_real middle[{count}] = {{{', '.join(middle)}}};",
        f"    static const {name}_real width[{count}] = {{{', '.join(width)}}};",
        f"    {name}_real before[{count}];",
        f"    {name}_out out;",
        "    int n, k, still = 0;",
        f"    {name}_begin(s, u, middle);",
        f"    for (k = 0; k < {count}; k++) {{",
        "        before[k] = middle[k];",
        "    }",
        "    for (n = 0; n < 100000; n++) {",
        "        int moves = 0;",
        f"        {name}_step(s, u, &out);",
        f"        for (k = 0; k < {count}; k++) {{",
        f"            const {name}_real away = out.fed[k] - before[k];",
        f"            const {name}_real size = (away < {syntax.number(0.0)}) "
        "? -away : away;",
        f"            if (size > {upper}_STILL * width[k]) {{",
        "                moves = 1;",
        "            }",
        "            before[k] = out.fed[k];",
        "        }",
        "        still = (moves == 0) ? still + 1 : 0;",
        "        if (still > 10) {",
        "            break;",
        "        }",
        "    }",
        "    return n;",
        "}",
        "",
    ]


def _jacobian(program: SampleProgram, syntax: Syntax) -> list[str]:
    name = program.name
    needed = program.needed([n for row in program.jacobian for n in row])
    columns = len(program.inputs) + len(program.past)
    return [
        f"void {name}_jacobian(const {name}_state *s, const {name}_real *u, "
        f"{name}_real *slopes)",
        "{",
        *_unused(program, needed, ("input", "u")),
        *(
            []
            if {"delay", "state"} & {program.ops[n].kind for n in needed}
            else ["    (void)s;"]
        ),
        *statements(program, needed, syntax),
        *(
            f"    slopes[{o * columns + k}] = {shown(program, n, syntax)};"
            for o, row in enumerate(program.jacobian)
            for k, n in enumerate(row)
        ),
        "}",
    ]


def _selftest(program: SampleProgram, golden: Golden) -> str:
    name, upper = program.name, program.name.upper()
    inputs, measured = golden["inputs"], golden["measured"]
    outputs = golden["outputs"]

    def matrix(what: str, x: np.ndarray) -> list[str]:
        # where nothing is reported, nothing is expected
        rows = [
            ", ".join("NAN" if math.isnan(v) else digits(v) for v in row) for row in x
        ]
        return [
            f"static const double {what}[{x.shape[0]}][{x.shape[1]}] = {{",
            *(f"    {{{row}}}," for row in rows[:-1]),
            f"    {{{rows[-1]}}}",
            "};",
        ]

    return (
        "\n".join(
            [
                "/* Golden vectors: what the model does in its home. Returns 0. */",
                f'#include "{name}.h"',
                "",
                "#include <math.h>",
                "#include <stdio.h>",
                "",
                *matrix("inputs", inputs),
                *matrix("measured", measured),
                *matrix("expected", outputs),
                "",
                "int main(void)",
                "{",
                f"    {name}_state s;",
                f"    {name}_out out;",
                f"    {name}_real u[{upper}_INPUTS], y[{upper}_COMPUTED];",
                "    double worst = 0.0, scale = 0.0, tolerance;",
                "    int t, k, wrong = 0;",
                f"    for (t = 0; t < {len(inputs)}; t++) {{",
                f"        for (k = 0; k < {upper}_INPUTS; k++) {{",
                f"            u[k] = ({name}_real)inputs[t][k];",
                "        }",
                f"        if (t <= {upper}_HISTORY) {{",
                f"            for (k = 0; k < {upper}_COMPUTED; k++) {{",
                f"                y[k] = ({name}_real)measured[t][k];",
                "            }",
                "        }",
                "        if (t == 0) {",
                f"            {name}_begin(&s, u, y);",
                "        }",
                f"        if (t < {upper}_HISTORY) {{",
                f"            {name}_observe(&s, u, y);",
                "            continue;",
                "        }",
                f"        {name}_step(&s, u, &out);",
                f"        for (k = 0; k < {upper}_REPORTED; k++) {{",
                f"            const double right = expected[t - {upper}_HISTORY][k];",
                "            const double off = (double)out.reported[k] - right;",
                "            const double size = (off < 0.0) ? -off : off;",
                "            const double full = (right < 0.0) ? -right : right;",
                "            if (isnan(right)) {",
                "                wrong |= isnan(out.reported[k]) ? 0 : 1;",
                "                continue;",
                "            }",
                "            wrong |= isnan(out.reported[k]) ? 1 : 0;",
                "            worst = (size > worst) ? size : worst;",
                "            scale = (full > scale) ? full : scale;",
                "        }",
                "    }",
                f"    tolerance = (sizeof({name}_real) == sizeof(double)) "
                "? 1e-11 : 1e-4;",
                '    printf("largest difference %.3g of %.3g\\n", worst, scale);',
                "    return (wrong == 0 && worst <= tolerance * scale) ? 0 : 1;",
                "}",
            ]
        )
        + "\n"
    )
