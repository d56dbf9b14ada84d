"""C99 of a model that learns while it runs: recursive least squares beside its step.

The files stand beside those of `jaxnarx.exporters.c99` and use them. What they do is
what `jaxnarx.linear.adapt` does with the same settings: P is kept as a square root, a
local model forgets in proportion to its weight, and windows that make the error grow
are undone.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from importlib import resources

from jaxnarx.exporters.c99 import REFUSED_FLAGS, c_syntax, store_lines, told_lines
from jaxnarx.exporters.code import Syntax, statements, value_text
from jaxnarx.exporters.form import INDEX_FLAG, LearntOutput, SampleProgram, Value
from jaxnarx.exporters.notes import wrap_paragraphs
from jaxnarx.exporters.target import Files
from jaxnarx.settings import LEAST_WINDOW_ERROR, Recursive

SIMULATED, MEASURED, NONE = "simulated", "measured", "none"
"""Past outputs that enter a model: its own, measured ones, or none."""


@dataclasses.dataclass(frozen=True)
class AdaptiveProgram:
    """A program, with regressions, that learns; `past` is one of the three above, and
    `chosen` are the local models of every output that learn."""

    program: SampleProgram
    method: Recursive
    past: str
    chosen: tuple[tuple[int, ...], ...]

    @property
    def joint(self) -> bool:
        """Whether the local models of an output learn together."""
        return self.method.estimation == "joint"

    @property
    def parts(self) -> list["LearntTerms"]:
        """What is learnt, output by output."""
        return [
            LearntTerms(regression, chosen, self.joint)
            for regression, chosen in zip(
                self.program.regressions, self.chosen, strict=True
            )
        ]

    @property
    def numbers(self) -> int:
        """Numbers in memory: runs of the model, coefficients twice, roots of all
        covariances, sums and errors."""
        lines = sum(line.length for line in self.program.delays)
        runs = len(states_of(self)) * (lines + len(self.program.states))
        tables = sum(2 * self.program.table(p.table).values.size for p in self.parts)
        return runs + tables + sum(p.root for p in self.parts) + 6 * len(self.parts)

    @property
    def multiplications(self) -> int:
        """Multiplications of a sample beside those of the model, at most."""
        return sum(5 * n**2 + 9 * n for part in self.parts for n in part.terms)


@dataclasses.dataclass(frozen=True)
class LearntTerms:
    """What is learnt of an output: places and terms, group by group."""

    regression: LearntOutput
    chosen: tuple[int, ...]
    joint: bool

    @property
    def table(self) -> str:
        """The table of the coefficients."""
        return self.regression.table

    @property
    def word(self) -> str:
        """The output in names."""
        return self.table.removeprefix("theta_")

    @property
    def entries(self) -> list[int]:
        """Places in the table."""
        return [e for m in self.chosen for e in self.regression.entries[m]]

    @property
    def terms(self) -> list[int]:
        """Numbers of terms, group by group."""
        counts = [len(self.regression.entries[m]) for m in self.chosen]
        return [sum(counts)] if self.joint else counts

    @property
    def root(self) -> int:
        """Numbers of the roots of all covariances."""
        return sum(n**2 for n in self.terms)


def adaptive_files(adaptive: AdaptiveProgram) -> Files:
    """Header and source, by their names."""
    name = adaptive.program.name
    return {
        f"{name}_adapt.h": _header(adaptive),
        f"{name}_adapt.c": _source(adaptive),
    }


def _header(adaptive: AdaptiveProgram) -> str:
    program, method = adaptive.program, adaptive.method
    name, upper = program.name, program.name.upper()
    outputs = len(program.regressions)
    real = f"{name}_real"
    about = [
        f"Coefficients follow the engine by recursive least squares; forgetting "
        f"{method.forgetting:g}, start {method.start:g}, windows of {method.window} "
        f"samples. Past outputs that enter: {adaptive.past}.",
        "y are the outputs as they are measured now, NaN where one is not: nothing is "
        "learnt from that, nor outside of the domain, nor where an input is missing, "
        f"nor before {program.history} samples in a row were complete: until then the "
        "run goes by measured outputs.",
        f"{adaptive.numbers} numbers in memory, and {adaptive.multiplications} "
        "multiplications a sample at most beside those of the model.",
    ]
    lines = [
        f"/* {name}_adapt: the model of {name}.h, learning while it runs.",
        " *",
        f" *   {name}_begin(&state, u, y);      at the first sample",
        f" *   {name}_adapt_begin(&a, &state);",
        f" *   {name}_adapt(&a, u, y, &out);    at this and every other sample",
        " *",
        *wrap_paragraphs(about, " * "),
        " */",
        f"#ifndef {upper}_ADAPT_H",
        f"#define {upper}_ADAPT_H",
        "",
        f'#include "{name}.h"',
        "",
        f"#ifdef {upper}_SINGLE",
        '#error "learning is proven in double precision alone"',
        "#endif",
        "",
        "/* rmse, that of the model as it began, and the root mean square of their",
        " * difference: of the last whole window that had a sample, in the outputs'",
        " * units; undone: how many windows were. */",
        "typedef struct {",
        *(f"    {name}_state {state};" for state in states_of(adaptive)),
        *(
            f"    {real} {what}[{size}];"
            for part in adaptive.parts
            for what, size in (
                (part.table, program.table(part.table).values.size),
                (f"good_{part.word}", program.table(part.table).values.size),
                (f"root_{part.word}", part.root),
            )
        ),
        f"    {real} sums[{3 * outputs}];",
        f"    {real} rmse[{outputs}];",
        f"    {real} rmse_start[{outputs}];",
        f"    {real} drift[{outputs}];",
        f"    int count[{outputs}];",
        f"    int undone[{outputs}];",
        "    int learn; /* 0: coefficients stay; 1 from begin on */",
        "    int at;",
        "    int ready;",
        "    int begun;",
        f"}} {name}_adaptation;",
        "",
        f"void {name}_adapt_begin({name}_adaptation *a, const {name}_state *s);",
        f"void {name}_adapt({name}_adaptation *a, const {real} *u, const {real} *y,",
        f"    {name}_out *out);",
        "",
        "#endif",
    ]
    return "\n".join(lines) + "\n"


def states_of(adaptive: AdaptiveProgram) -> list[str]:
    """Runs that are kept: where a model is fed with its own past, also that of the
    model as it began, and that of measured outputs, to go back to."""
    return ["model", "start", "seen"] if adaptive.past == SIMULATED else ["model"]


def _source(adaptive: AdaptiveProgram) -> str:
    program = adaptive.program
    name, upper = program.name, program.name.upper()
    most = max(max(part.terms) for part in adaptive.parts)
    learning = resources.files("jaxnarx.exporters") / "adapt.c"
    method, number = adaptive.method, c_syntax(program).number
    numbers = {
        "FORGETTING": method.forgetting,
        "FIRST": method.start,
        "DEAD_ZONE": method.dead_zone,
        "LEAST_NEWS": method.excitation * (1 - method.forgetting),
        "LARGEST_TRACE": method.largest_trace,
        "GROWTH": method.growth,
        "LEAST_ERROR": LEAST_WINDOW_ERROR,
    }
    lines = [
        f'#include "{name}_adapt.h"',
        "",
        "#include <math.h>",
        "",
        *REFUSED_FLAGS,
        *(f"#define {k} {number(float(v))}" for k, v in numbers.items()),
        f"#define WINDOW {method.window}",
        f"#define MOST_TERMS {most}",
        "#define ROOT(x) sqrt(x)",
        "#define EXPONENTIAL(x) exp(x)",
        f"#define {upper}_EXP(x) EXPONENTIAL(x)",
        f"#define {upper}_SQRT(x) ROOT(x)",
        "",
        learning.read_text(encoding="utf-8").replace("NAME_", f"{name}_"),
    ]
    for part in adaptive.parts:
        word = part.word
        lines += [
            f"static const int terms_{word}[{len(part.terms)}] = {_set(part.terms)};",
            f"static const int at_{word}[{len(part.entries)}] = {_set(part.entries)};",
            f"static const learnt_part part_{word} = {{",
            f"    {len(part.terms)}, {program.table(part.table).values.size},",
            f"    terms_{word}, at_{word}, {name}_{part.table}",
            "};",
            "",
        ]
    return "\n".join([*lines, *_begin(adaptive), "", *_adapt(adaptive)]) + "\n"


def _set(numbers: Sequence[int]) -> str:
    rows = [numbers[k : k + 12] for k in range(0, len(numbers), 12)]
    return "{\n    " + ",\n    ".join(", ".join(map(str, r)) for r in rows) + "\n}"


def _begin(adaptive: AdaptiveProgram) -> list[str]:
    name, upper = adaptive.program.name, adaptive.program.name.upper()
    lines = [
        f"void {name}_adapt_begin({name}_adaptation *a, const {name}_state *s)",
        "{",
        "    int k;",
        *(f"    a->{state} = *s;" for state in states_of(adaptive)),
    ]
    for o, part in enumerate(adaptive.parts):
        word = part.word
        lines += [
            f"    restore(&part_{word}, a->{part.table}, part_{word}.first);",
            f"    restore(&part_{word}, a->good_{word}, part_{word}.first);",
            f"    reset(&part_{word}, a->root_{word});",
            f"    a->rmse[{o}] = 0.0;",
            f"    a->rmse_start[{o}] = 0.0;",
            f"    a->drift[{o}] = 0.0;",
            f"    a->count[{o}] = 0;",
            f"    a->undone[{o}] = 0;",
        ]
    return [
        *lines,
        f"    for (k = 0; k < {3 * len(adaptive.parts)}; k++) {{",
        "        a->sums[k] = 0.0;",
        "    }",
        "    a->learn = 1;",
        "    a->at = 0;",
        "    a->ready = 0;",
        f"    a->begun = ({upper}_HISTORY == 0) ? 1 : 0;",
        "}",
    ]


def _learning_syntax(adaptive: AdaptiveProgram) -> Syntax:
    """Coefficients are those in memory."""
    syntax, own = c_syntax(adaptive.program), {p.table for p in adaptive.parts}
    fixed = syntax.source["table"]

    def table(at: tuple[str, int]) -> str:
        return f"a->{at[0]}[{at[1]}]" if at[0] in own else fixed(at)

    return dataclasses.replace(syntax, source={**syntax.source, "table": table})


def _adapt(adaptive: AdaptiveProgram) -> list[str]:
    program, syntax = adaptive.program, _learning_syntax(adaptive)
    name, upper = program.name, program.name.upper()
    measured = adaptive.past == MEASURED
    asked = [n for p in adaptive.parts for n in _values(p)]
    needed = program.needed_operations(
        [*program.step, *(program.observe if measured else ()), *asked]
    )
    own = adaptive.past == SIMULATED
    lines = [
        f"void {name}_adapt({name}_adaptation *a, const {name}_real *u,",
        f"    const {name}_real *y, {name}_out *out)",
        "{",
        f"    {name}_state *const s = &a->model;",
        *([f"    {name}_out was;"] if own else []),
        f"    {name}_real started;",
        "    int usable;",
        *statements(program, needed, syntax),
        *told_lines(program, syntax),
        *([f"    {name}_step(&a->start, u, &was);"] if own else []),
        *_usable(adaptive, syntax),
        *itertools.chain(
            *(_learn(p, o, adaptive) for o, p in enumerate(adaptive.parts))
        ),
        *store_lines(program, syntax, measured=measured),
        *([f"    {name}_observe(&a->seen, u, y);"] if own else []),
        "    if (a->begun == 0) {",
        *(
            ["        a->model = a->seen;", "        a->start = a->seen;"]
            if own
            else []
        ),
        f"        a->begun = (a->ready >= {upper}_HISTORY) ? 1 : 0;",
        "    }",
        "    a->at++;",
        "    if (a->at >= WINDOW) {",
        *(["        int lost = 0;"] if own else []),
    ]
    for o, part in enumerate(adaptive.parts):
        word, gain = part.word, syntax.number(part.regression.gain)
        call = (
            f"judge(a, {o}, &part_{word}, a->{part.table}, a->good_{word}, "
            f"a->root_{word}, {gain})"
        )
        lines.append(f"        lost |= {call};" if own else f"        (void){call};")
    return [
        *lines,
        *(
            ["        if (lost != 0) {", "            a->model = a->seen;", "        }"]
            if own
            else []
        ),
        "        a->at = 0;",
        "    }",
        "}",
    ]


def _values(part: LearntTerms) -> list[Value]:
    one = part.regression
    own = [n for m in part.chosen for n in (*one.terms[m], one.shares[m])]
    return [*own, one.value, one.measured, one.there]


def _usable(adaptive: AdaptiveProgram, syntax: Syntax) -> list[str]:
    """Whether anything can be learnt at this sample, and what is complete behind it.

    The history that a run begins from needs its outputs too, where they enter."""
    program, upper = adaptive.program, adaptive.program.name.upper()
    text = {k: value_text(program, n, syntax) for k, n in program.flags.items()}
    half = syntax.number(0.5)
    inputs = f"({text['missing']} < {half})"
    own = (value_text(program, p.regression.there, syntax) for p in adaptive.parts)
    outputs = [f"({one} > {half})" for one in own]
    measured = f"({' && '.join(outputs)})"
    there = inputs
    if adaptive.past == MEASURED:
        there = f"({inputs} && {measured})"
    if adaptive.past == SIMULATED:
        there = f"({inputs} && ((a->begun != 0) || {measured}))"
    wanted = ["(a->learn != 0)", f"(a->ready >= {upper}_HISTORY)"]
    wanted += ["(a->begun != 0)", inputs]
    if INDEX_FLAG in text and adaptive.method.largest_index is not None:
        largest = syntax.number(adaptive.method.largest_index)
        wanted.append(f"({text[INDEX_FLAG]} <= {largest})")
    return [
        f"    usable = ({' && '.join(wanted)}) ? 1 : 0;",
        f"    if {there} {{",
        f"        a->ready = (a->ready < {upper}_HISTORY) ? (a->ready + 1) : a->ready;",
        "    } else {",
        "        a->ready = 0;",
        "    }",
    ]


def _learn(part: LearntTerms, o: int, adaptive: AdaptiveProgram) -> list[str]:
    """One output learns."""
    program, syntax = adaptive.program, _learning_syntax(adaptive)
    one, word, real = part.regression, part.word, f"{adaptive.program.name}_real"

    def text(n: Value) -> str:
        return value_text(program, n, syntax)

    terms = [
        f"{text(n)} * {text(one.shares[m])}" if part.joint else text(n)
        for m in part.chosen
        for n in one.terms[m]
    ]
    shares = [text(one.shares[m]) for m in part.chosen]
    shares = [syntax.number(1.0)] if part.joint else shares
    ends = f"{syntax.number(one.low)}, {syntax.number(one.high)}"
    started = f"was.fed[{o}] * {syntax.number(1 / one.gain)}"
    if adaptive.past != SIMULATED:
        started = (
            f"{text(one.value)} + answer(&part_{word}, part_{word}.first, x, share) "
            f"- answer(&part_{word}, a->{part.table}, x, share)"
        )
    return [
        "    {",
        f"        const {real} x[{len(terms)}] = {{",
        *(f"            {t}," for t in terms[:-1]),
        f"            {terms[-1]}",
        "        };",
        f"        const {real} share[{len(shares)}] = {{{', '.join(shares)}}};",
        f"        started = limit({started}, {ends});",
        f"        if ((usable != 0) && ({text(one.there)} > {syntax.number(0.5)})) {{",
        f"            note(a, {o}, {text(one.measured)},",
        f"                limit({text(one.value)}, {ends}), started);",
        f"            learn(&part_{word}, a->{part.table}, a->root_{word}, x, share,",
        f"                {text(one.measured)}, {text(one.value)}, {int(part.joint)});",
        "        }",
        "    }",
    ]
