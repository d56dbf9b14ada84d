"""Statements of a program in a language: what the writers of targets share."""

import dataclasses
import math
import re
from collections.abc import Callable, Iterable, Mapping

from jaxnarx.exporters.form import Op, SampleProgram, Value


@dataclasses.dataclass(frozen=True)
class Syntax:
    """The syntax of a language: a source, an operation and an assignment.

    `source` is by kind, a function of what names it; `operation` by kind, with {0}, {1}
    and {2} for the values it takes; `number` writes a constant, `assign` with {name}
    and {value} a statement. `statement` are whole statements, by kind, where a language
    has no such operation.
    """

    source: Mapping[str, Callable[..., str]]
    operation: Mapping[str, str]
    number: Callable[[float], str]
    assign: str
    statement: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def value(self, op: Op, n: Value) -> str:
        """The text of a value where it is used."""
        if op.kind == "const":
            return self.number(op.source)
        if op.kind in self.source:
            return self.source[op.kind](op.source)
        return f"v{n}"


INFIX_TEMPLATES = {
    "add": "{0} + {1}",
    "sub": "{0} - {1}",
    "mul": "{0} * {1}",
    "div": "{0} / {1}",
    "neg": "-{0}",
}


def statements(
    program: SampleProgram,
    needed: Iterable[Value],
    syntax: Syntax,
    indent: str = "    ",
) -> list[str]:
    """A statement for every operation; sources are written where they are used."""
    lines = []
    for n in needed:
        op = program.ops[n]
        if op.kind == "const" or op.kind in syntax.source:
            continue
        names = [syntax.value(program.ops[a], a) for a in op.args]
        if op.kind in syntax.statement:
            text = syntax.statement[op.kind].format(*names, name=f"v{n}")
        else:
            value = syntax.operation[op.kind].format(*names)
            text = syntax.assign.format(name=f"v{n}", value=value)
        lines.append(indent + text)
    return lines


def value_text(program: SampleProgram, n: Value, syntax: Syntax) -> str:
    """The text of value `n`."""
    return syntax.value(program.ops[n], n)


def comment(text: str) -> str:
    """People's words as they may stand in a comment of any language: they end none,
    begin none, continue no line and are no trigraph."""
    text = " ".join(text.replace("\\", "/").replace('"""', "'").split())
    return re.sub(r"(?<=[/*])(?=[/*])|(?<=\?)(?=\?)", " ", text)


def digits(x: float) -> str:
    """A number that reads back as it is, with a point."""
    if math.isfinite(x):
        text = repr(float(x))
        return text if any(c in text for c in ".en") else f"{text}.0"
    raise ValueError(f"{x} has no digits")
