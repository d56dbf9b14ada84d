"""C99 of a predictive controller: what `jaxnarx.control.controller` does at a sample.

The sample of the model and its exact slopes are written as operations, only where they
are not zero; observer, linearised horizon and quadratic program are those of
`control.c`, with the sizes of the controller. Nothing is allocated and every loop is
bounded by a count.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from importlib import resources

import numpy as np

from jaxnarx.exporters.c99 import (
    OF_INTERFACE,
    REFUSED_FLAGS,
    misra_note,
    table_lines,
)
from jaxnarx.exporters.code import Syntax, comment, statements, value_text
from jaxnarx.exporters.form import DelayLine, SampleProgram, Value
from jaxnarx.exporters.notes import wrap_paragraphs
from jaxnarx.exporters.state_program import StateProgram, name_states, state_syntax
from jaxnarx.exporters.target import Files


@dataclasses.dataclass(frozen=True)
class FeedbackLine:
    """A delay line of values that are fed back: of which output, or none, the gain they
    are divided by, the middle of their range, the variances of what it holds, and
    whether it holds roots of values; the middle is then that above the floor."""

    line: str
    output: int | None
    gain: float
    middle: float
    root: bool
    variances: tuple[float, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class ControlProgram:
    """A program with what a controller asks of it.

    `inputs` are all inputs in the controller's order, `counts`, `integers` and `reals`
    the sizes, constants and tables of `control.c` by name. Where the state is
    estimated, what the `loops` hold is; `unsure` is its first variance, in that of its
    steps. `bounds` are those of the feedback of every output, in its unit, and whether
    it is free to reach them; none: a run at its bounds never begins anew.
    """

    program: SampleProgram
    inputs: tuple[str, ...]
    counts: Mapping[str, int]
    constants: Mapping[str, float]
    integers: Mapping[str, Sequence[int]]
    reals: Mapping[str, np.ndarray]
    loops: tuple[FeedbackLine, ...]
    observe_states: bool
    unsure: float
    bounds: tuple[tuple[float, float, bool], ...] | None


@dataclasses.dataclass(frozen=True)
class _Slopes:
    """Entries of a Jacobian that are not zero."""

    rows: tuple[int, ...]
    columns: tuple[int, ...]
    values: tuple[Value, ...]


_DEVIATIONS = (
    "2.2, sizes of one or none leave operations without an effect; 8.9, tables stand "
    f"together; {OF_INTERFACE}"
)


class _Writer:
    """The C of a controller."""

    def __init__(self, control: ControlProgram) -> None:
        self.control = control
        self.form = StateProgram.of(control.program)
        self.program = program = self.form.program
        self.name, self.upper = program.name, program.name.upper()
        self.syntax = _syntax(program, control.inputs)
        self.states = list(name_states(program))
        self.inputs = len(program.inputs)
        commands = [control.inputs[k] for k in control.integers["command_at"]]
        names = [port.name for port in program.inputs]
        # Columns of slopes by commands; one that the model has no input of has none.
        self.moved = [names.index(n) if n in names else None for n in commands]
        self.parts = dict(
            zip("abcd", map(self._entries, range(4)), strict=True)
        )  # x+ by x and commands, y by x and commands
        self.lines = {line.name: (n, line) for n, line in self._loop_lines()}
        self.loops = [one for one in control.loops if one.line in self.lines]
        self.tables = {**self._state_tables(), **self._numbers()}
        self.counts = self._counts()

    def files(self) -> Files:
        """Header and source, by their names."""
        return {
            f"{self.name}_control.h": self._header(),
            f"{self.name}_control.c": self._source(),
        }

    def _loop_lines(self) -> Iterator[tuple[int, DelayLine]]:
        """Delay lines with the place of their first entry in the state."""
        at = 0
        for line in self.program.delays:
            yield at, line
            at += line.length

    def _entries(self, which: int) -> _Slopes:
        matrix = self.form.jacobian if which < 2 else self.form.out_jacobian
        by_state = which in (0, 2)
        found = []
        for row, slopes in enumerate(matrix):
            columns: Sequence[int | None]
            columns = range(self.inputs, len(slopes)) if by_state else self.moved
            for place, column in enumerate(columns):
                if column is not None and not self._is_zero(slopes[column]):
                    found.append((row, place, slopes[column]))
        rows, places, values = zip(*found, strict=True) if found else ((), (), ())
        return _Slopes(rows, places, values)

    def _is_zero(self, value: Value) -> bool:
        op = self.program.ops[value]
        return op.kind == "const" and op.source == 0.0

    # tables ------------------------------------------------------------------------

    def _state_tables(self) -> dict[str, Sequence[int]]:
        loop_of, carried_of = [-1] * len(self.states), [-1] * len(self.states)
        carried: list[int] = []
        for n, one in enumerate(self.loops):
            first, line = self.lines[one.line]
            for k in range(first, first + line.length):
                loop_of[k] = n
                if self.control.observe_states:
                    carried_of[k] = len(carried)
                    carried.append(k)
        found: dict[str, Sequence[int]] = {
            "loop_of": loop_of,
            "loop_first": [self.lines[one.line][0] for one in self.loops],
            "loop_length": [self.lines[one.line][1].length for one in self.loops],
            "loop_output": [one.output or 0 for one in self.loops],
            "loop_root": [int(one.root) for one in self.loops],
            "carried_of": carried_of,
            "carried_at": carried,
            "loop_free": [int(free) for *_, free in self._bounds()],
            **self.control.integers,
        }
        for letter, part in self.parts.items():
            found[f"{letter}_row"] = part.rows
            found[f"{letter}_column"] = part.columns
        return found

    def _bounds(self) -> Sequence[tuple[float, float, bool]]:
        none = [(-np.inf, np.inf, False)] * len(self.program.outputs)
        return none if self.control.bounds is None else self.control.bounds

    def _numbers(self) -> dict[str, np.ndarray]:
        """The tables of numbers; variances in the order of states that are estimated,
        offsets and errors that fade."""
        reals = dict(self.control.reals)
        own = [
            one.variances[k] / one.gain**2
            for one in self.loops
            for k in range(self.lines[one.line][1].length)
            if self.control.observe_states
        ]
        unsure = self.control.unsure
        steps = reals.pop("offset_variance"), reals.pop("fading_variance")
        reals["step_variance"] = np.concatenate([own, *steps])
        reals["first_variance"] = np.concatenate([np.array(own) * unsure, *steps])
        reals["loop_gain"] = np.array([one.gain for one in self.loops])
        middles = [one.middle / one.gain for one in self.loops]
        reals["loop_middle"] = np.array(middles)
        low, high, _ = zip(*self._bounds(), strict=True)
        return reals | {"loop_low": np.array(low), "loop_high": np.array(high)}

    def _counts(self) -> dict[str, int]:
        own = dict(self.control.counts)
        carried, outputs = len(self.tables["carried_at"]), len(self.program.outputs)
        numbers = own["BLOCKS"] * own["COMMANDS"]
        soft = len(self.control.integers["soft_column"])
        return own | {
            "STATES": len(self.states),
            "INPUTS": len(self.control.inputs),
            "OUTPUTS": outputs,
            "LOOPS": len(self.loops),
            "CARRIED": carried,
            "OWN": carried + 2 * outputs,
            "RECOVERS": int(self.control.bounds is not None),
            "NUMBERS": numbers,
            "SOFT": soft,
            "VARIABLES": numbers + soft,
            "ROWS": 4 * numbers + (2 * own["HORIZON"] + 1) * soft,
            "COLUMNS": outputs + int(soft > own["LIMITS"]),
            "USED": len(self.control.integers["used_at"]),
            **{f"{k.upper()}_ENTRIES": len(p.rows) for k, p in self.parts.items()},
        }

    # memory ------------------------------------------------------------------------

    def _memory(self) -> dict[str, tuple[int, str]]:
        """Numbers of the controller: how many of a name, and what they are."""
        n = self.counts
        own, columns, numbers = n["OWN"], n["COLUMNS"], n["NUMBERS"]
        return {
            "x": (n["STATES"], "state of the model"),
            "offset": (n["OUTPUTS"], "errors of the outputs that stay"),
            "fading": (n["OUTPUTS"], "errors that fade"),
            "covariance": (own**2, "of what is estimated"),
            "u": (n["INPUTS"], "inputs of the last sample"),
            "plan": (n["HORIZON"] * n["COMMANDS"], "commands from the next on"),
            "slow": (n["USED"], "filtered inputs of the domain"),
            "next": (n["STATES"], "scratch: this and all that follow"),
            "run": (n["STATES"], ""),
            **dict.fromkeys(("y", "fed"), (n["OUTPUTS"], "")),
            **{k: (n[f"{k.upper()}_ENTRIES"], "") for k in "abcd"},
            "now": (n["INPUTS"], ""),
            "ahead": (n["HORIZON"] * n["GIVEN"], ""),
            **dict.fromkeys(("slope", "moved"), (n["STATES"] * max(numbers, 1), "")),
            "passed": (n["USED"], ""),
            "passed_slope": (n["USED"] * numbers, ""),
            "z": (numbers, ""),
            "change": (numbers, ""),
            "out": (n["HORIZON"] * columns, ""),
            "steep": (n["HORIZON"] * columns * numbers, ""),
            **dict.fromkeys(("seen", "product", "gain"), (n["OUTPUTS"] * own, "")),
            "middle": (n["OUTPUTS"] ** 2, ""),
            **dict.fromkeys(("half", "transition"), (own**2, "")),
            **dict.fromkeys(("hessian", "factor"), (n["VARIABLES"] ** 2, "")),
            **dict.fromkeys(
                ("gradient", "step", "last", "dz", "dual"), (n["VARIABLES"], "")
            ),
            **dict.fromkeys(
                (
                    *("bound", "there", "slack", "multipliers", "weight", "lower"),
                    *("primal", "inner", "ds", "dm"),
                ),
                (n["ROWS"], ""),
            ),
        }

    def _header(self) -> str:
        name, upper, n = self.name, self.upper, self.counts
        integers = self.control.integers
        units = {port.name: port.unit for port in self.program.inputs}
        outputs = [_named(port.name, port.unit) for port in self.program.reported]
        inputs = [_named(text, units.get(text, "")) for text in self.control.inputs]
        memory = self._memory()
        ram = 8 * sum(max(size, 1) for size, _ in memory.values())
        about = [
            f"Every {self.program.sample_time:g} s it plans commands over "
            f"{n['HORIZON']} samples, and sets the first. The references are those of "
            f"the samples from {'the next' if n['FIRST'] else 'this'} one on.",
            "A value is missing that is not finite, or a million times as large as any "
            "of the training: a measured output corrects nothing then, an input is "
            "held as it was, at the beginning in the middle of its range. "
            "Where the quadratic program was not solved, as with a reference that is "
            "not finite, the plan of before goes on, and `solved` is 0.",
            f"{ram} bytes of memory, nothing is allocated; double precision.",
        ]
        rows = (
            ("u", inputs),
            ("commands", [inputs[k] for k in integers["command_at"]]),
            ("given", [inputs[k] for k in integers["given_at"]]),
            ("measured, disturbance, outputs", outputs),
            ("reference", [outputs[k] for k in integers["target_at"]]),
            ("excess", [outputs[k] for k in integers["soft_column"][: n["LIMITS"]]]),
        )
        lines = [
            f"/* {name}_control: a predictive controller.",
            " *",
            f" *   {name}_control_begin(&c, u, measured);     at rest, once",
            f" *   {name}_control_step(&c, measured, reference, given, &out);",
            *wrap_paragraphs(about, " * "),
            " *",
            " * Entries, in physical units:",
            *(f" *   {what}: {', '.join(own)}" for what, own in rows if own),
            " */",
            f"#ifndef {upper}_CONTROL_H",
            f"#define {upper}_CONTROL_H",
            "",
            *(
                f"#define {upper}_CONTROL_{word} {n[word]}"
                for word in (
                    *("INPUTS", "OUTPUTS", "COMMANDS", "GIVEN", "TARGETS", "LIMITS"),
                    "HORIZON",
                )
            ),
            "",
            "typedef struct {",
            *(
                f"    double {word}[{max(size, 1)}];"
                + (f" /* {told} */" if told else "")
                for word, (size, told) in memory.items()
            ),
            f"}} {name}_controller;",
            "",
            "typedef struct {",
            f"    double commands[{n['COMMANDS']}];",
            f"    double outputs[{n['HORIZON'] * n['OUTPUTS']}]; /* expected */",
            f"    double excess[{max(n['LIMITS'], 1)}]; /* how far limits give way */",
            f"    double disturbance[{n['OUTPUTS']}]; /* errors of the model now */",
            "    int solved;",
            "    int restarted; /* the model began anew from what was measured */",
            f"}} {name}_decision;",
            "",
            "/* the plant is at rest under u, with these outputs */",
            f"void {name}_control_begin({name}_controller *c, const double *u,",
            "    const double *measured);",
            f"/* reference and given have {n['HORIZON']} rows, a sample each */",
            f"void {name}_control_step({name}_controller *c, const double *measured,",
            f"    const double *reference, const double *given, {name}_decision *out);",
            "",
            "#endif",
        ]
        return "\n".join(lines) + "\n"

    # source ------------------------------------------------------------------------

    def _source(self) -> str:
        name, program, number = self.name, self.program, self.syntax.number
        code = resources.files("jaxnarx.exporters") / "control.c"
        lines = [
            *misra_note(_DEVIATIONS),
            f'#include "{name}_control.h"',
            "",
            "#include <math.h>",
            "#include <stddef.h>",
            "",
            *REFUSED_FLAGS,
            f"#define {name}_real double",
            f"#define {self.upper}_EXP(a) exp(a)",
            f"#define {self.upper}_SQRT(a) sqrt(a)",
            *(f"#define {k} {v}" for k, v in self.counts.items()),
            *(f"#define {k} {number(v)}" for k, v in self.control.constants.items()),
            "",
        ]
        for word, own in self.tables.items():
            real = isinstance(own, np.ndarray)
            values = [number(float(v)) if real else str(int(v)) for v in own]
            kind = f"{name}_real" if real else "int"
            lines += _table(f"static const {kind} {word}", values or ["0"])
        for table in program.tables:
            lines += table_lines(name, table, static=True)
        lines += self._rest()
        fed = self.control.program.fed[: len(program.outputs)]
        common = {"next": self.form.after, "y": program.outputs}
        lines += self._function("sample", common | {"fed": fed})
        own = {k: part.values for k, part in self.parts.items()}
        lines += self._function("slopes", common | own)
        text = code.read_text(encoding="utf-8")
        return "\n".join([*lines, text.replace("NAME_", f"{name}_")])

    def _function(self, word: str, gives: Mapping[str, Sequence[Value]]) -> list[str]:
        """A function of x and u that fills arrays."""
        asked = [value for values in gives.values() for value in values]
        return [
            f"static void {word}(const double *x, const double *u,",
            "    " + ", ".join(f"double *{name}" for name in gives) + ")",
            "{",
            *self._statements(asked),
            *(
                f"    {name}[{k}] = {value_text(self.program, n, self.syntax)};"
                for name, values in gives.items()
                for k, n in enumerate(values)
            ),
            "    (void)x;",
            "    (void)u;",
            *(f"    (void){name};" for name, values in gives.items() if not values),
            "}",
            "",
        ]

    def _rest(self) -> list[str]:
        """The state after u and the fed-back values z have been so for ever."""
        entries: list[str] = []
        needed: list[Value] = []
        places = {one.line: n for n, one in enumerate(self.loops)}
        for line in self.program.delays:
            if line.name in places:
                entries += [f"z[{places[line.name]}]"] * line.length
            else:
                needed.append(line.start)
                text = value_text(self.program, line.start, self.syntax)
                entries += [text] * line.length
        for state in self.program.states:
            needed.append(state.start)
            entries.append(value_text(self.program, state.start, self.syntax))
        return [
            "static void rest(const double *u, const double *z, double *x)",
            "{",
            *self._statements(needed),
            *(f"    x[{k}] = {text};" for k, text in enumerate(entries)),
            "    (void)x;",
            "    (void)u;",
            "    (void)z;",
            "}",
            "",
        ]

    def _statements(self, asked: Sequence[Value]) -> list[str]:
        needed = self.program.needed_operations(asked)
        return statements(self.program, needed, self.syntax)


def control_files(control: ControlProgram) -> Files:
    """Header and source, by their names."""
    return _Writer(control).files()


def _syntax(program: SampleProgram, inputs: Sequence[str]) -> Syntax:
    """Inputs in the order of the controller; those that it has not are zero."""
    syntax = state_syntax(program)
    places = [
        inputs.index(port.name) if port.name in inputs else None
        for port in program.inputs
    ]

    def text(k: int) -> str:
        return "0.0" if places[k] is None else f"u[{places[k]}]"

    return dataclasses.replace(syntax, source={**syntax.source, "input": text})


def _named(name: str, unit: str) -> str:
    return comment(f"{name} [{unit}]" if unit else name)


def _table(head: str, values: Sequence[str]) -> list[str]:
    rows = [", ".join(values[k : k + 4]) for k in range(0, len(values), 4)]
    return [f"{head}[{len(values)}] = {{", "    " + ",\n    ".join(rows), "};", ""]
