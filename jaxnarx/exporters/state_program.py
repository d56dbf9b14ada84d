"""The state form of a program: its next state, and exact slopes, as operations.

What optimal control, controllers in C and tests of exports take. Inputs are finite
there: what a program keeps for others is left out, and so are flags.
"""

import dataclasses
from collections.abc import Iterator, Sequence

from jaxnarx.exporters.c99 import c_syntax
from jaxnarx.exporters.code import Syntax
from jaxnarx.exporters.derivatives import gradient
from jaxnarx.exporters.entrance import HELD_PREFIX
from jaxnarx.exporters.form import Builder, Op, SampleProgram, Value


@dataclasses.dataclass(frozen=True, eq=False)
class StateProgram:
    """A program with what is left of its state after a sample, and derivatives.

    Row k of `jacobian` has the slopes of `after` k by inputs and state, `hessian`, if
    it was asked for, those of the sum of lam times `after`; the multipliers are inputs
    behind the others.
    """

    program: SampleProgram
    after: tuple[Value, ...]
    jacobian: tuple[tuple[Value, ...], ...]
    hessian: tuple[tuple[Value, ...], ...]
    out_jacobian: tuple[tuple[Value, ...], ...]

    @classmethod
    def of(cls, program: SampleProgram, *, hessian: bool = False) -> "StateProgram":
        """The state form of a program, with derivatives as further operations."""
        bare = without_gaps(program)
        b = Builder.of(bare)
        after = (*_next_lines(bare, b), *(s.source for s in bare.states))
        count = len(bare.inputs)
        sources = [Op("input", source=k) for k in range(count)]
        sources += [
            Op("delay", source=(line.name, k + 1))
            for line in bare.delays
            for k in range(line.length)
        ]
        sources += [Op("state", source=s.name) for s in bare.states]
        found = cls(
            bare,
            after,
            _slopes(b, after, sources),
            _curvature(b, after, sources) if hessian else (),
            _slopes(b, bare.outputs, sources),
        )
        whole = dataclasses.replace(bare, ops=tuple(b.ops))
        return dataclasses.replace(found, program=whole)


def _slopes(
    b: Builder, values: Sequence[Value], sources: Sequence[Op]
) -> tuple[tuple[Value, ...], ...]:
    """Rows of slopes. What is taken from a source may stand several times among the
    operations: an input once as it is and once as the value that was held."""
    places = [[n for n, op in enumerate(b.ops) if op == one] for one in sources]
    every = [n for own in places for n in own]
    rows = []
    for value in values:
        slope = dict(zip(every, gradient(b, value, every), strict=True))
        rows.append(tuple(b.add(*(slope[n] for n in own)) for own in places))
    return tuple(rows)


def _curvature(
    b: Builder, after: Sequence[Value], sources: Sequence[Op]
) -> tuple[tuple[Value, ...], ...]:
    """The Hessian of lam times the next state; what is below the diagonal is the same
    as above it."""
    count = sum(op.kind == "input" for op in sources)
    lam = [b.op("input", source=count + k) for k in range(len(after))]
    slopes = _slopes(b, [b.dot(lam, after)], sources)[0]
    upper = [_slopes(b, [one], sources[k:])[0] for k, one in enumerate(slopes)]
    count = len(sources)
    return tuple(
        tuple(upper[min(i, j)][abs(i - j)] for j in range(count)) for i in range(count)
    )


def _next_lines(program: SampleProgram, b: Builder) -> Iterator[Value]:
    """Entries of the delay lines behind a sample."""
    for line in program.delays:
        yield line.source
        for k in range(line.length - 1):
            yield b.op("delay", source=(line.name, k + 1))


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


def name_states(program: SampleProgram) -> Iterator[str]:
    """Names of the entries of the state, line by line."""
    for line in program.delays:
        yield from (f"{line.name}[t-{k + 1}]" for k in range(line.length))
    yield from (state.name for state in program.states)


def state_syntax(program: SampleProgram) -> Syntax:
    """Lines and states are entries of x; multipliers stand behind the inputs."""
    syntax, place, at = c_syntax(program), {}, 0
    for line in program.delays:
        place[line.name] = at
        at += line.length
    for state in program.states:
        place[state.name] = at
        at += 1
    count = len(program.inputs)
    own = {
        "input": lambda k: f"u[{k}]" if k < count else f"lam[{k - count}]",
        "delay": lambda where: f"x[{place[where[0]] + where[1] - 1}]",
        "state": lambda name: f"x[{place[name]}]",
    }
    return dataclasses.replace(syntax, source={**syntax.source, **own})
