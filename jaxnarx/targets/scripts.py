"""Files of one page without dependencies: Python and JavaScript."""

import json
import math
from collections.abc import Iterable

from jaxnarx.targets.code import INFIX, Syntax, digits, shown, statements
from jaxnarx.targets.form import Port, SampleProgram, Value
from jaxnarx.targets.target import Files, Golden


def python_files(program: SampleProgram, golden: Golden) -> Files:
    """By name; no golden vectors go with it."""
    return {f"{program.name}.py": python(program)}


def javascript_files(program: SampleProgram, golden: Golden) -> Files:
    """By name; no golden vectors go with it."""
    return {f"{program.name}.mjs": javascript(program)}


def python(program: SampleProgram) -> str:
    """A module with the class `Model`."""
    syntax = Syntax(
        source=_sources("self.", "self."),
        operation=INFIX
        | {
            "max": "{0} if {0} > {1} else {1}",
            "min": "{0} if {0} < {1} else {1}",
            "less": "1.0 if {0} < {1} else 0.0",
            "where": "{1} if {0} > 0.5 else {2}",
            "exp": "_exp({0})",
            "sqrt": "math.sqrt({0})",
        },
        number=_number("math.nan", "math.inf"),
        assign="{name} = {value}",
    )
    pad = " " * 8
    lines = [
        f'"""{_about(program)}',
        "",
        "    model = Model()",
        "    model.begin(u, y)        # as if inputs and outputs had been so for ever",
        "    model.observe(u, y)      # for every sample of measured history, if any",
        "    y = model.step(u)        # for every sample of the free run",
        "",
        "Physical units; limited and the flags are of the last step.",
        '"""',
        "",
        "import math",
        "",
        f"SAMPLE_TIME = {digits(program.sample_time)}",
        f"HISTORY = {program.history}",
        f"INPUTS = {_names(program.inputs)}",
        f"OUTPUTS = {_names(program.computed)}",
        f"REPORTED = {len(program.reported)}",
        "",
        "",
        "def _exp(x):",
        "    return math.exp(x) if x < 709.0 else math.inf",
        "",
        "",
        "class Model:",
    ]
    for table in program.tables:
        numbers = ", ".join(digits(x) for x in table.values.ravel())
        lines += [f"    # {table.about}", f"    {table.name} = [{numbers}]"]
    lines += ["", "    def __init__(self):"]
    lines += [f"{pad}self.{d.name} = [0.0] * {d.length}" for d in program.delays]
    lines += [f"{pad}self.{s.name} = 0.0" for s in program.states]
    lines += [f"{pad}self.limited = [0.0] * {len(program.limited)}"]
    lines += [f"{pad}self.{flag} = 0.0" for flag in program.flags]
    for what, needed in (("begin", program.begin), ("observe", program.observe)):
        lines += ["", f"    def {what}(self, u, y):"]
        lines += statements(program, needed, syntax, pad)
        lines += [pad + text for text in _kept(program, syntax, "self.", what)]
    lines += ["", "    def step(self, u):"]
    lines += statements(program, program.step, syntax, pad)
    limited = ", ".join(shown(program, n, syntax) for n in program.limited)
    lines += [f"{pad}self.limited = [{limited}]"]
    lines += [
        f"{pad}self.{flag} = {shown(program, n, syntax)}"
        for flag, n in program.flags.items()
    ]
    reported = ", ".join(shown(program, n, syntax) for n in program.outputs)
    lines += [f"{pad}reported = [{reported}]"]
    lines += [pad + text for text in _kept(program, syntax, "self.", "step")]
    return "\n".join([*lines, f"{pad}return reported"]) + "\n"


def javascript(program: SampleProgram) -> str:
    """A module with the class `Model`."""
    syntax = Syntax(
        source=_sources("TABLES.", "this."),
        operation=INFIX
        | {
            "max": "{0} > {1} ? {0} : {1}",
            "min": "{0} < {1} ? {0} : {1}",
            "less": "{0} < {1} ? 1.0 : 0.0",
            "where": "{0} > 0.5 ? {1} : {2}",
            "exp": "Math.exp({0})",
            "sqrt": "Math.sqrt({0})",
        },
        number=_number("NaN", "Infinity"),
        assign="const {name} = {value};",
    )
    pad = "    "
    tables = {t.name: t.values.ravel().tolist() for t in program.tables}
    lines = [
        f"/* {_about(program)}",
        "",
        "   const model = new Model();",
        "   model.begin(u, y);         as if inputs and outputs had been so for ever",
        "   model.observe(u, y);       for every sample of measured history, if any",
        "   const y = model.step(u);   for every sample of the free run",
        "",
        "   Physical units; limited and the flags are of the last step. */",
        f"export const SAMPLE_TIME = {digits(program.sample_time)};",
        f"export const HISTORY = {program.history};",
        f"export const INPUTS = {_names(program.inputs)};",
        f"export const OUTPUTS = {_names(program.computed)};",
        f"export const REPORTED = {len(program.reported)};",
        f"export const TABLES = {json.dumps(tables)};",
        "",
        "export class Model {",
        "  constructor() {",
    ]
    lines += [
        f"{pad}this.{d.name} = new Array({d.length}).fill(0.0);" for d in program.delays
    ]
    lines += [f"{pad}this.{s.name} = 0.0;" for s in program.states]
    lines += [f"{pad}this.limited = [];"]
    lines += ["  }"]
    for what, needed in (("begin", program.begin), ("observe", program.observe)):
        lines += [f"  {what}(u, y) {{"]
        lines += statements(program, needed, syntax, pad)
        lines += [f"{pad}{t};" for t in _kept(program, syntax, "this.", what)]
        lines += ["  }"]
    lines += ["  step(u) {", *statements(program, program.step, syntax, pad)]
    limited = ", ".join(shown(program, n, syntax) for n in program.limited)
    lines += [f"{pad}this.limited = [{limited}];"]
    lines += [
        f"{pad}this.{flag} = {shown(program, n, syntax)};"
        for flag, n in program.flags.items()
    ]
    reported = ", ".join(shown(program, n, syntax) for n in program.outputs)
    lines += [f"{pad}const reported = [{reported}];"]
    lines += [f"{pad}{t};" for t in _kept(program, syntax, "this.", "step")]
    return "\n".join([*lines, f"{pad}return reported;", "  }", "}"]) + "\n"


def _sources(tables: str, kept: str):
    return {
        "table": lambda at: f"{tables}{at[0]}[{at[1]}]",
        "input": lambda i: f"u[{i}]",
        "measured": lambda o: f"y[{o}]",
        "delay": lambda at: f"{kept}{at[0]}[{at[1] - 1}]",
        "state": lambda own: f"{kept}{own}",
    }


def _number(nan: str, infinity: str):
    def number(x: float) -> str:
        if math.isnan(x):
            return nan
        text = infinity if math.isinf(x) else digits(abs(x))
        return f"(-{text})" if x < 0 else text

    return number


def _about(program: SampleProgram) -> str:
    """One line of what it is; names cannot end the comment it stands in."""
    ports = [
        ", ".join(f"{p.name} [{p.unit}]" if p.unit else p.name for p in some)
        for some in (program.inputs, program.computed)
    ]
    text = f"{ports[1]} from {ports[0]}, a sample every {program.sample_time:g} s."
    for mark, other in (("\\", "/"), ('"""', "'"), ("*/", "* /")):
        text = text.replace(mark, other)
    return " ".join(text.split())


def _names(ports: Iterable[Port]) -> str:
    return json.dumps([port.name for port in ports])


def _kept(
    program: SampleProgram, syntax: Syntax, kept: str, what: str
) -> Iterable[str]:
    """What is left for the next sample; all values before anything is changed."""

    def text(n: Value) -> str:
        return shown(program, n, syntax)

    lines, values = program.delays, program.states
    if what == "begin":
        fill = "[{0}] * {1}" if kept == "self." else "new Array({1}).fill({0})"
        yield from (
            f"{kept}{d.name} = {fill.format(text(d.start), d.length)}" for d in lines
        )
        yield from (f"{kept}{s.name} = {text(s.start)}" for s in values)
        return
    # a state is never another's next value by itself, a line's newest value may be
    sources = [d.measured if what == "observe" else d.source for d in lines]
    held = [text(n) for n in (*sources, *(s.source for s in values))]
    begin = "" if kept == "self." else "const "
    yield f"{begin}now = [{', '.join(held)}]"
    for n, line in enumerate(lines):
        own = f"{kept}{line.name}"
        if kept == "self.":
            yield f"{own} = [now[{n}], *{own}[:-1]]"
        else:
            yield f"{own}.unshift(now[{n}]), {own}.pop()"
    for n, state in enumerate(values):
        yield f"{kept}{state.name} = now[{len(lines) + n}]"
