"""The reference: a program run in numpy, operation by operation."""

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxnarx.targets.form import Op, SampleProgram

SETTLED, LONGEST = 1e-10, 100_000
"""Share of an output's range within which it stands still, and samples for it."""


@dataclasses.dataclass(eq=False)
class Instance:
    """A program with what it keeps from sample to sample."""

    program: SampleProgram

    def __post_init__(self) -> None:
        self.tables = {t.name: t.values.ravel() for t in self.program.tables}
        self.delays = {d.name: np.zeros(d.length) for d in self.program.delays}
        self.states = {s.name: 0.0 for s in self.program.states}
        self._begin = self.program.begin
        self._observe, self._step = self.program.observe, self.program.step

    def begin(
        self, inputs: Float[np.ndarray, " inputs"], outputs: Float[np.ndarray, " _"]
    ) -> None:
        """As if inputs and outputs (hidden ones, too) had been these for ever."""
        values = self._values(self._begin, inputs, outputs)
        for line in self.program.delays:
            self.delays[line.name][:] = values[line.start]
        for state in self.program.states:
            self.states[state.name] = values[state.start]

    def settle(self, inputs: Float[np.ndarray, " inputs"]) -> int:
        """Start from the steady state at these inputs: where the free run comes to rest
        from the middle of the trained ranges. Returns how many samples that took."""
        ports = self.program.computed
        middle = np.array([0.5 * (p.low + p.high) for p in ports])
        width = np.array([p.high - p.low for p in ports])
        self.begin(inputs, middle)
        before = middle
        still = 0
        for n in range(LONGEST):
            now = self.step(inputs)["fed"]
            still = still + 1 if np.all(abs(now - before) <= SETTLED * width) else 0
            if still > 10:
                return n
            before = now
        return LONGEST

    def observe(
        self, inputs: Float[np.ndarray, " inputs"], outputs: Float[np.ndarray, " _"]
    ) -> None:
        """One sample of measured history; `outputs` holds hidden ones, too."""
        values = self._values(self._observe, inputs, outputs)
        self._keep(values, measured=True)

    def step(self, inputs: Float[np.ndarray, " inputs"]) -> dict[str, Any]:
        """One sample of the free run: `outputs` as reported, `fed` what is fed back,
        `limited` and the program's flags."""
        values = self._values(self._step, inputs, np.zeros(0))
        program = self.program
        found = {
            name: np.array([values[n] for n in getattr(program, name)])
            for name in ("outputs", "fed", "limited")
        }
        self._keep(values, measured=False)
        return found | {name: values[n] for name, n in program.flags.items()}

    def _keep(self, values: dict[int, float], *, measured: bool) -> None:
        for line in self.program.delays:
            held = self.delays[line.name]
            held[1:] = held[:-1].copy()
            held[0] = values[line.measured if measured else line.source]
        for state in self.program.states:
            self.states[state.name] = values[state.source]

    def _values(self, needed: Iterable[int], inputs, outputs) -> dict[int, float]:
        values: dict[int, float] = {}
        for n in needed:
            op = self.program.ops[n]
            values[n] = self._value(op, [values[a] for a in op.args], inputs, outputs)
        return values

    def _value(self, op: Op, args: list[float], inputs, outputs) -> float:
        match op.kind:
            case "const":
                return op.source
            case "table":
                name, k = op.source
                return float(self.tables[name][k])
            case "input":
                return float(inputs[op.source])
            case "measured":
                return float(outputs[op.source])
            case "delay":
                name, k = op.source
                return float(self.delays[name][k - 1])
            case "state":
                return self.states[op.source]
        return _FUNCTIONS[op.kind](*args)


def _exp(x: float) -> float:
    with np.errstate(over="ignore"):
        return np.exp(x)


_FUNCTIONS = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "max": lambda a, b: a if a > b else b,
    "min": lambda a, b: a if a < b else b,
    "less": lambda a, b: float(a < b),
    "where": lambda c, a, b: a if c else b,
    "neg": lambda a: -a,
    "exp": _exp,
    "sqrt": np.sqrt,
}
