"""Common parts of files of one page, in whatever language they are written.

A `Language` is a table of how its statements look and a page with places for them; the
program fills the places. `python`, `javascript` and `matlab` are such tables.
"""

import dataclasses
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from string import Template

from jaxnarx.exporters.code import Syntax, comment, digits, statements, value_text
from jaxnarx.exporters.form import ParameterTable, SampleProgram, Value
from jaxnarx.exporters.interpret import LONGEST_SETTLING, SETTLED_SHARE
from jaxnarx.exporters.notes import wrap_paragraphs


@dataclasses.dataclass(frozen=True)
class Language:
    """A scripting language: how it keeps values, and the page that they stand on.

    `own` is what is kept from sample to sample, by {name}, `flag` a flag; `fresh` is a
    delay line of {length} zeros, `filled` one that is {value} throughout, `entered` the
    {line} after {value} has entered it; `set` sets {name} to {value}, `row` is a list
    of {items}, which `between` separates. `names` writes texts, `table` a parameter
    table with its comment; `remark` leads a line of the comment at the top. `page` has
    the places that `write_page` fills, `indent` is that of statements.
    """

    page: Template
    syntax: Callable[[SampleProgram], Syntax]
    own: str
    flag: str
    fresh: str
    filled: str
    entered: str
    set: str
    row: str
    table: Callable[[ParameterTable], Sequence[str]]
    names: Callable[[Sequence[str]], str] = json.dumps
    between: str = ", "
    indent: str = "    "
    remark: str = ""


def write_page(
    program: SampleProgram, language: Language, extra: Mapping[str, str] | None = None
) -> str:
    """The page of a program; `extra` are places that a language alone has."""
    syntax, pad = language.syntax(program), language.indent

    def row(items: Iterable[str], between: str = language.between) -> str:
        return language.row.format(items=between.join(items))

    def values(numbers: Iterable[Value]) -> str:
        return row(value_text(program, n, syntax) for n in numbers)

    def block(lines: Iterable[str]) -> str:
        return "\n".join(pad + line for line in lines)

    def stage(needed: Sequence[Value], kept: Iterable[str]) -> str:
        return "\n".join([*statements(program, needed, syntax, pad), block(kept)])

    def set_(name: str, value: str) -> str:
        return language.set.format(name=name, value=value)

    def own(name: str) -> str:
        return language.own.format(name=name)

    computed = program.computed
    fields = [
        *(set_(own(d.name), _line(language.fresh, d)) for d in program.delays),
        *(set_(own(s.name), digits(0.0)) for s in program.states),
    ]
    begun = [
        *(
            set_(
                own(d.name),
                _line(language.filled, d, value_text(program, d.start, syntax)),
            )
            for d in program.delays
        ),
        *(
            set_(own(s.name), value_text(program, s.start, syntax))
            for s in program.states
        ),
    ]
    tables = [line for t in program.tables for line in language.table(t)]
    places = {
        "name": program.name,
        "about": describe_ports(program),
        "notes": "\n".join(wrap_paragraphs(program.notes, language.remark)),
        "sample_time": digits(program.sample_time),
        "history": str(program.history),
        "inputs": language.names([p.name for p in program.inputs]),
        "outputs": language.names([p.name for p in computed]),
        "reported": str(len(program.reported)),
        "middle": row(digits(0.5 * (p.low + p.high)) for p in computed),
        "width": row(digits(p.high - p.low) for p in computed),
        "settled": digits(SETTLED_SHARE),
        "longest": str(LONGEST_SETTLING),
        "tables": "\n".join(tables),
        "fields": block(fields),
        "begin": stage(program.begin, begun),
        "observe": stage(
            program.observe, _keep_states(program, language, measured=True)
        ),
        "step": "\n".join(statements(program, program.step, syntax, pad)),
        "keep": block(_keep_states(program, language, measured=False)),
        "limited": values(program.limited),
        "fed": values(program.fed),
        "values": values(program.outputs),
        "flags": block(
            set_(language.flag.format(name=flag), value_text(program, n, syntax))
            for flag, n in program.flags.items()
        ),
        "no_flags": block(
            set_(language.flag.format(name=flag), digits(0.0)) for flag in program.flags
        ),
    }
    page = language.page.substitute(places | dict(extra or {}))
    return "\n".join(line.rstrip() for line in page.splitlines()) + "\n"


def _line(form: str, line, value: str = "") -> str:
    return form.format(length=line.length, value=value)


def _keep_states(
    program: SampleProgram, language: Language, *, measured: bool
) -> Iterable[str]:
    """Assign what is left for the next sample; all values before anything is
    changed."""
    syntax = language.syntax(program)
    later = []
    for n, line in enumerate(program.delays):
        value = value_text(program, line.measured if measured else line.source, syntax)
        yield syntax.assign.format(name=f"d{n}", value=value)
        own = language.own.format(name=line.name)
        later.append(language.entered.format(line=own, value=f"d{n}"))
    for n, state in enumerate(program.states):
        value = value_text(program, state.source, syntax)
        yield syntax.assign.format(name=f"x{n}", value=value)
        own = language.own.format(name=state.name)
        later.append(language.set.format(name=own, value=f"x{n}"))
    yield from later


def sources(table: str, own: str, first: int, index: str) -> dict:
    """Texts of a program's sources by kind; entries count from `first`, in brackets as
    `index` has them."""
    return {
        "table": lambda at: table.format(name=at[0]) + index.format(at[1] + first),
        "input": lambda i: "u" + index.format(i + first),
        "measured": lambda o: "y" + index.format(o + first),
        "delay": lambda at: own.format(name=at[0]) + index.format(at[1] - 1 + first),
        "state": lambda name: own.format(name=name),
    }


def number(nan: str, infinity: str) -> Callable[[float], str]:
    """The text of a constant; negative ones in brackets."""

    def text(x: float) -> str:
        if math.isnan(x):
            return nan
        size = infinity if math.isinf(x) else digits(abs(x))
        return f"(-{size})" if x < 0 else size

    return text


def describe_ports(program: SampleProgram) -> str:
    """One line of what it is, for a comment."""
    ports = [
        ", ".join(f"{p.name} [{p.unit}]" if p.unit else p.name for p in some)
        for some in (program.inputs, program.computed)
    ]
    return comment(
        f"{ports[1]} from {ports[0]}, a sample every {program.sample_time:g} s."
    )
