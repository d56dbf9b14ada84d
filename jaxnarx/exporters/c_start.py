"""Starts of a run of the C: steady state, mean, given outputs, zeros."""

from jaxnarx.exporters.code import Syntax
from jaxnarx.exporters.form import SampleProgram


def starts(program: SampleProgram, syntax: Syntax) -> list[str]:
    """The functions `settle` and `start`."""
    return [
        *_middle(program, syntax),
        *_settle(program, syntax),
        *_start(program, syntax),
    ]


def _middle(program: SampleProgram, syntax: Syntax) -> list[str]:
    name, count = program.name, len(program.computed)
    middle = [syntax.number(0.5 * (p.low + p.high)) for p in program.computed]
    return [
        f"static const {name}_real middle[{count}] = {{{', '.join(middle)}}};",
        "",
    ]


def _settle(program: SampleProgram, syntax: Syntax) -> list[str]:
    name, upper = program.name, program.name.upper()
    width = [syntax.number(p.high - p.low) for p in program.computed]
    count = len(program.computed)
    return [
        f"int {name}_settle({name}_state *s, const {name}_real *u)",
        "{",
        f"    static const {name}_real width[{count}] = {{{', '.join(width)}}};",
        f"    {name}_real before[{count}];",
        f"    {name}_out out;",
        "    int n;",
        "    int k;",
        "    int still = 0;",
        f"    {name}_begin(s, u, middle);",
        f"    for (k = 0; k < {count}; k++) {{",
        "        before[k] = middle[k];",
        "    }",
        f"    for (n = 0; n < {upper}_LONGEST; n++) {{",
        "        still++;",
        f"        {name}_step(s, u, &out);",
        f"        for (k = 0; k < {count}; k++) {{",
        f"            const {name}_real away = out.fed[k] - before[k];",
        f"            const {name}_real size = (away < {syntax.number(0.0)}) "
        "? -away : away;",
        "            /* what is not a number does not rest */",
        f"            if (!(size <= ({upper}_STILL * width[k]))) {{",
        "                still = 0;",
        "            }",
        "            before[k] = out.fed[k];",
        "        }",
        "        if (still > 10) {",
        "            break;",
        "        }",
        "    }",
        "    return n;",
        "}",
        "",
    ]


def _start(program: SampleProgram, syntax: Syntax) -> list[str]:
    name, upper, real = program.name, program.name.upper(), f"{program.name}_real"
    zeros = ", ".join([syntax.number(0.0)] * len(program.computed))
    return [
        f"int {name}_start({name}_state *s, int kind, const {real} *u, "
        f"const {real} *y)",
        "{",
        f"    static const {real} nothing[{upper}_COMPUTED] = {{{zeros}}};",
        "    int found = 0;",
        "    switch (kind) {",
        f"    case {upper}_STEADY:",
        f"        if ({name}_settle(s, u) == {upper}_LONGEST) {{",
        "            found = 1;",
        "        }",
        "        break;",
        f"    case {upper}_MEAN:",
        f"        {name}_begin(s, u, middle);",
        "        break;",
        f"    case {upper}_GIVEN:",
        f"        {name}_begin(s, u, y);",
        "        break;",
        f"    case {upper}_ZEROS:",
        f"        {name}_begin(s, u, nothing);",
        "        break;",
        "    default:",
        "        found = 2;",
        "        break;",
        "    }",
        "    return found;",
        "}",
        "",
    ]
