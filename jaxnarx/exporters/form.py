"""The intermediate form of a model that is exported: a list of operations on numbers.

A `SampleProgram` is what one sample takes. Its operations are in static single
assignment: operation n makes value n from values before it, from inputs, from
parameters in tables, and from delay lines and states, which hold what earlier samples
left. Every target is a writer of this form, and `jaxnarx.exporters.interpret` runs it
in numpy.

| operation | value |
|---|---|
| `const x` | the number x |
| `table (name, k)` | entry k of a table, flattened by rows |
| `input i`, `measured o` | of this sample, physical units; `measured` of an output |
| `delay (name, k)` | what entered a delay line k samples ago, k from 1 |
| `state name` | what the sample before has left |
| `add sub mul div max min` | of two values |
| `neg exp sqrt` | of one value |
| `less a b`, `where c a b` | 1 or 0; a where c is not 0, else b |
"""

import contextlib
import dataclasses
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from jaxnarx.deprecation import old_method
from jaxnarx.exporters.names import identifiers

ONLY_DOUBLE, ONLY_SINGLE, BOTH = PRECISIONS = "double", "single", "both"
"""Number types that C is written and proven for."""

INDEX_FLAG, HALF_FLAG_PREFIX = "index", "half_"
"""Flags: the index of the domain, and half of a prediction interval by output."""

TERMS, WEIGHTS, BLEND, FILTERS, FRAME = "terms", "weights", "blend", "filters", "frame"
"""Purposes of operations; the frame are scales, limits, flags and what is missing."""

SOURCE_KINDS = ("const", "table", "input", "measured", "delay", "state")
"""Kinds that take no arithmetic."""

Value = int
"""Number of the operation that makes a value."""


@dataclasses.dataclass(frozen=True)
class Op:
    """One operation: its kind, the values it takes, and what names a source.

    Its `purpose` is that of who asked for it first, and makes it no other operation.
    """

    kind: str
    args: tuple[Value, ...] = ()
    source: Any = None
    purpose: str = dataclasses.field(default=FRAME, compare=False)


@dataclasses.dataclass(frozen=True)
class ParameterTable:
    """Parameters that a target keeps together, with what they are, and what the columns
    belong to where each belongs to something."""

    name: str
    values: np.ndarray
    about: str
    unit: str = ""
    columns: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class DelayLine:
    """The last `length` values of `source`, newest first; `start` fills it at the
    beginning, `measured` takes the place of `source` while history is given."""

    name: str
    length: int
    source: Value
    start: Value
    measured: Value


@dataclasses.dataclass(frozen=True)
class StateValue:
    """One number that is kept from sample to sample."""

    name: str
    source: Value
    start: Value


@dataclasses.dataclass(frozen=True)
class Port:
    """An input or output: name, unit and trained range in physical units."""

    name: str
    unit: str
    low: float
    high: float


@dataclasses.dataclass(frozen=True)
class LearntOutput:
    """What the coefficients of one output are learnt from, sample by sample.

    `entries` are places in the flattened `table` of coefficients and `terms` what these
    multiply, local model by local model; `shares` are the models' weights. `value` is
    the output by them, before its bounds `low` and `high`, and `measured` what was
    measured, 0 where it is not `there`; all divided by the gain.
    """

    table: str
    entries: tuple[tuple[int, ...], ...]
    terms: tuple[tuple[Value, ...], ...]
    shares: tuple[Value, ...]
    value: Value
    low: float
    high: float
    gain: float
    measured: Value
    there: Value


@dataclasses.dataclass(frozen=True)
class SampleProgram:
    """The program of one sample of a model: inputs, operations and states.

    `outputs` are reported values in physical units, `fed` the fed-back values (of the
    modelled outputs, then of hidden ones), `limited` whether the feedback bound acted
    on it, `flags` further values by name. Row o of `jacobian` has the slopes of `fed` o
    by the inputs of this sample and then by the `past` outputs, (line, k), as they are
    in the lines: divided by the gain. `history` samples of measured inputs and outputs
    begin a run, if there are any. `notes` are paragraphs for callers of the code, which
    stand in the comments of every target. `precision` says which of the number types of
    C the source may be compiled in. `changed` names the tables that differ from those
    of the model that a unit holds already; None: no such model is known. `regressions`
    are those of the outputs, where they were asked for.
    """

    name: str
    sample_time: float
    history: int
    inputs: tuple[Port, ...]
    reported: tuple[Port, ...]
    computed: tuple[Port, ...]
    ops: tuple[Op, ...]
    tables: tuple[ParameterTable, ...]
    delays: tuple[DelayLine, ...]
    states: tuple[StateValue, ...]
    outputs: tuple[Value, ...]
    jacobian: tuple[tuple[Value, ...], ...]
    past: tuple[tuple[str, int], ...]
    fed: tuple[Value, ...]
    limited: tuple[Value, ...]
    flags: Mapping[str, Value]
    notes: tuple[str, ...] = ()
    precision: str = BOTH
    changed: frozenset[str] | None = None
    regressions: tuple[LearntOutput, ...] = ()

    def needed_operations(self, values: Iterable[Value]) -> list[Value]:
        """The operations that these values take, in order."""
        return _needed_values(self.ops, values)

    needed = old_method("needed", "needed_operations")

    @property
    def step(self) -> list[Value]:
        """The operations of one sample of a free run."""
        return self.needed_operations(
            [
                *(*self.outputs, *self.fed, *self.limited, *self.flags.values()),
                *(line.source for line in self.delays),
                *(state.source for state in self.states),
            ]
        )

    @property
    def begin(self) -> list[Value]:
        """The operations that start from the first inputs and outputs."""
        return self.needed_operations(
            [kept.start for kept in (*self.delays, *self.states)]
        )

    @property
    def observe(self) -> list[Value]:
        """The operations of one sample of measured history."""
        lines = (line.measured for line in self.delays)
        return self.needed_operations(
            [*lines, *(state.source for state in self.states)]
        )

    @property
    def operations(self) -> int:
        """Additions, multiplications, comparisons and functions of one sample."""
        return self._count(self.step)

    @property
    def model_operations(self) -> int:
        """The same without what the index and intervals take."""
        return self._count(self.model_step())

    def model_step(self) -> list[Value]:
        """The operations of one sample without what the index and intervals take."""
        flags = [
            n
            for f, n in self.flags.items()
            if f != INDEX_FLAG and f[:5] != HALF_FLAG_PREFIX
        ]
        return self.state_closure([*self.outputs, *self.fed, *self.limited, *flags])

    def state_closure(
        self, values: Iterable[Value], without: Sequence[str] = ()
    ) -> list[Value]:
        """The operations that values take, and those of all that is kept for them from
        sample to sample, but for the lines `without`."""
        found = self.needed_operations(values)
        count = -1
        while count < len(found):
            count = len(found)
            kept = {op.source for op in (self.ops[n] for n in found) if op.source}
            names = {at[0] if isinstance(at, tuple) else at for at in kept}
            names -= set(without)
            lines = [k.source for k in (*self.delays, *self.states) if k.name in names]
            found = self.needed_operations([*found, *lines])
        return found

    def _count(self, values: Iterable[Value]) -> int:
        return sum(self.ops[n].kind not in SOURCE_KINDS for n in values)

    @property
    def flag_units(self) -> dict[str, str]:
        """Units of the flags that have one: halves of intervals have that of their
        output."""
        words = identifiers(port.name for port in self.computed)
        pairs = zip(words, self.computed, strict=True)
        units = {f"{HALF_FLAG_PREFIX}{word}": port.unit for word, port in pairs}
        return {flag: units[flag] for flag in self.flags if units.get(flag)}

    @property
    def cost(self) -> str:
        """The operations in words."""
        text, model = f"{self.operations} operations a sample", self.model_operations
        if model == self.operations:
            return text
        extra = (
            "the index of the domain" if INDEX_FLAG in self.flags else "the intervals"
        )
        return f"{text}, {model} of them without {extra}"

    def table(self, name: str) -> ParameterTable:
        """The table of a name."""
        return next(table for table in self.tables if table.name == name)


def _needed_values(ops: Sequence[Op], values: Iterable[Value]) -> list[Value]:
    """The operations that values take, in order."""
    found: set[Value] = set()
    left = list(values)
    while left:
        n = left.pop()
        if n not in found:
            found.add(n)
            left += ops[n].args
    return sorted(found)


class Builder:
    """Makes the operations; the same one is made once, and constants are folded."""

    def __init__(self) -> None:
        self.ops: list[Op] = []
        self.tables: dict[str, ParameterTable] = {}
        self._known: dict[Op, Value] = {}
        self._purpose = FRAME

    @classmethod
    def of(cls, program: SampleProgram) -> "Builder":
        """One that goes on from a program's operations."""
        own = cls()
        own.ops = list(program.ops)
        for n, op in enumerate(own.ops):
            own._known.setdefault(op, n)
        return own

    @contextlib.contextmanager
    def purpose(self, name: str) -> Iterator[None]:
        """Give operations made inside this purpose."""
        before, self._purpose = self._purpose, name
        try:
            yield
        finally:
            self._purpose = before

    def op(self, kind: str, *args: Value, source: Any = None) -> Value:
        """The value of an operation."""
        folded = self._fold(kind, args)
        if folded is not None:
            return folded
        op = Op(kind, args, source, self._purpose)
        if op not in self._known:
            self._known[op] = len(self.ops)
            self.ops.append(op)
        return self._known[op]

    def const(self, value: float) -> Value:
        """A number."""
        return self.op("const", source=float(value))

    def parameters(
        self,
        name: str,
        values: Any,
        about: str,
        unit: str = "",
        columns: Iterable[str] = (),
    ) -> np.ndarray:
        """A table of parameters, as values of its shape."""
        values = np.asarray(values, float)
        self.tables[name] = ParameterTable(name, values, about, unit, tuple(columns))
        found = [self.op("table", source=(name, k)) for k in range(values.size)]
        return np.array(found, object).reshape(values.shape)

    def add(self, *args: Value) -> Value:
        """The sum, from the left."""
        return self._chain("add", args, 0.0)

    def mul(self, *args: Value) -> Value:
        """The product, from the left."""
        return self._chain("mul", args, 1.0)

    def largest(self, args: Sequence[Value]) -> Value:
        """The largest of some values."""
        return self._chain("max", args, -math.inf)

    def smallest(self, args: Sequence[Value]) -> Value:
        """The smallest of some values."""
        return self._chain("min", args, math.inf)

    def dot(self, a: Iterable[Value], b: Iterable[Value]) -> Value:
        """The sum of products."""
        return self.add(*(self.mul(x, y) for x, y in zip(a, b, strict=True)))

    def clip(self, x: Value, low: Value, high: Value) -> Value:
        """x, not below low nor above high."""
        return self.op("min", self.op("max", x, low), high)

    def no(self, x: Value) -> Value:
        """1 where x is 0, else 0."""
        return self.op("where", x, self.const(0.0), self.const(1.0))

    def square(self, x: Value) -> Value:
        """x x."""
        return self.mul(x, x)

    def size(self, x: Value, scale: float) -> Value:
        """|x| times a constant."""
        scaled = self.mul(x, self.const(scale))
        return self.op("max", scaled, self.op("neg", scaled))

    def sigmoid(self, a: Value) -> Value:
        """1/(1 + exp(-a))."""
        one = self.const(1.0)
        return self.op(
            "div", one, self.op("add", one, self.op("exp", self.op("neg", a)))
        )

    def substitute(self, value: Value, by: Mapping[Value, Value]) -> Value:
        """The value with others in place of some that it takes."""
        found = dict(by)
        for n in _needed_values(self.ops, [value]):
            if n not in found:
                op = self.ops[n]
                args = (found[a] for a in op.args)
                found[n] = self.op(op.kind, *args, source=op.source)
        return found[value]

    def _chain(self, kind: str, args: Sequence[Value], empty: float) -> Value:
        if not args:
            return self.const(empty)
        value, *rest = args
        for other in rest:
            value = self.op(kind, value, other)
        return value

    def _number(self, n: Value) -> float | None:
        op = self.ops[n]
        return op.source if op.kind == "const" else None

    def _fold(self, kind: str, args: tuple[Value, ...]) -> Value | None:
        """The value that needs no operation, if there is one."""
        if kind in SOURCE_KINDS:
            return None
        numbers = [self._number(n) for n in args]
        if kind == "add" and 0.0 in numbers:
            return args[1 - numbers.index(0.0)]
        if kind == "sub" and numbers[1] == 0.0:
            return args[0]
        if kind == "mul" and 1.0 in numbers:
            return args[1 - numbers.index(1.0)]
        if kind == "mul" and 0.0 in numbers:
            return self.const(0.0)
        if kind == "div" and numbers[1] == 1.0:
            return args[0]
        if kind == "max" and -math.inf in numbers:
            return args[1 - numbers.index(-math.inf)]
        if kind == "min" and math.inf in numbers:
            return args[1 - numbers.index(math.inf)]
        return None
