"""The reference: a program run in numpy, operation by operation."""

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from jaxnarx.checks import choice
from jaxnarx.errors import SpecError
from jaxnarx.targets.form import Op, SampleProgram

SETTLED, LONGEST = 1e-10, 100_000
"""Share of an output's range within which it stands still, and samples for it."""
STEADY, MEAN, GIVEN, ZEROS = STARTS = "steady", "mean", "given", "zeros"
"""How a run may begin, in every target; see `Instance.start`."""


@dataclasses.dataclass(eq=False)
class Instance:
    """A program with what it keeps from sample to sample, of one run or of many side by
    side: those are trailing axes of inputs and outputs."""

    program: SampleProgram

    def __post_init__(self) -> None:
        self.tables = {t.name: t.values.ravel().tolist() for t in self.program.tables}
        self.delays = {d.name: [0.0] * d.length for d in self.program.delays}
        self.states: dict[str, Any] = {s.name: 0.0 for s in self.program.states}
        self._begin = self.program.begin
        self._observe, self._step = self.program.observe, self.program.step

    def start(
        self,
        kind: str,
        inputs: Float[np.ndarray, "inputs *runs"],
        outputs: Float[np.ndarray, "computed *runs"] | None = None,
    ) -> None:
        """Begin a run at its first inputs by one of four rules.

        `"steady"`: the steady state there (`settle`); `"mean"`: outputs as if they had
        been in the middle of their trained ranges for ever; `"given"`: as if they had
        been `outputs`, the first measured ones; `"zeros"`: as if they had been zero.
        Inputs are those of the first sample in all of them, for ever.
        """
        choice(kind, STARTS, "kind")
        middle, _ = self._ranges(inputs)
        if kind == STEADY:
            self.settle(inputs)
        elif kind == MEAN:
            self.begin(inputs, middle)
        elif kind == ZEROS:
            self.begin(inputs, np.zeros_like(middle))
        elif outputs is not None:
            self.begin(inputs, outputs)
        else:
            raise SpecError("outputs must be told to start as given", field="outputs")

    def begin(
        self,
        inputs: Float[np.ndarray, "inputs *runs"],
        outputs: Float[np.ndarray, "computed *runs"],
    ) -> None:
        """As if inputs and outputs (hidden ones, too) had been these for ever."""
        values = self._values(self._begin, inputs, outputs)
        for line in self.program.delays:
            self.delays[line.name] = [values[line.start]] * line.length
        for state in self.program.states:
            self.states[state.name] = values[state.start]

    def settle(
        self, inputs: Float[np.ndarray, "inputs *runs"]
    ) -> Int[np.ndarray, "*runs"]:
        """Start from the steady state at these inputs: where the free run comes to rest
        from the middle of the trained ranges. Returns how many samples that took,
        `LONGEST` where it did not."""
        middle, width = self._ranges(inputs)
        self.begin(inputs, middle)
        before, still = middle, np.zeros(middle.shape[1:], int)
        rested = np.full_like(still, LONGEST)
        for n in range(LONGEST):
            now = self.step(inputs)["fed"]
            moves = np.any(abs(now - before) > SETTLED * width, axis=0)
            still = np.where(moves, 0, still + 1)
            rested = np.where((still > 10) & (rested == LONGEST), n, rested)
            if np.all(rested < LONGEST):
                break
            before = now
        return rested

    def _ranges(self, inputs: Float[np.ndarray, "inputs *runs"]):
        """Middle and width of the trained ranges of all that is computed, by run."""
        runs = np.shape(inputs)[1:]
        low, high = (
            np.array([getattr(p, end) for p in self.program.computed], float)
            for end in ("low", "high")
        )
        shape = (-1, *(1 for _ in runs))
        middle, width = (a.reshape(shape) for a in (0.5 * (low + high), high - low))
        return middle + np.zeros(runs), width

    def observe(
        self,
        inputs: Float[np.ndarray, "inputs *runs"],
        outputs: Float[np.ndarray, "computed *runs"],
    ) -> None:
        """One sample of measured history; `outputs` holds hidden ones, too."""
        values = self._values(self._observe, inputs, outputs)
        self._keep(values, measured=True)

    def step(self, inputs: Float[np.ndarray, "inputs *runs"]) -> dict[str, Any]:
        """One sample of the free run: `outputs` as reported, `fed` what is fed back,
        `limited` and the program's flags."""
        values = self._values(self._step, inputs, np.zeros(0))
        program, runs = self.program, np.shape(inputs)[1:]
        found = {
            name: np.array(
                [np.broadcast_to(values[n], runs) for n in getattr(program, name)]
            )
            for name in ("outputs", "fed", "limited")
        }
        self._keep(values, measured=False)
        return found | {name: values[n] for name, n in program.flags.items()}

    def _keep(self, values: dict[int, Any], *, measured: bool) -> None:
        for line in self.program.delays:
            new = values[line.measured if measured else line.source]
            self.delays[line.name] = [new, *self.delays[line.name][:-1]]
        for state in self.program.states:
            self.states[state.name] = values[state.source]

    def _values(self, needed: Iterable[int], inputs, outputs) -> dict[int, Any]:
        values: dict[int, Any] = {}
        for n in needed:
            op = self.program.ops[n]
            values[n] = self._value(op, [values[a] for a in op.args], inputs, outputs)
        return values

    def _value(self, op: Op, args: list[Any], inputs, outputs) -> Any:
        match op.kind:
            case "const":
                return op.source
            case "table":
                name, k = op.source
                return self.tables[name][k]
            case "input":
                return inputs[op.source]
            case "measured":
                return outputs[op.source]
            case "delay":
                name, k = op.source
                return self.delays[name][k - 1]
            case "state":
                return self.states[op.source]
        return _FUNCTIONS[op.kind](*args)


def _exp(x):
    with np.errstate(over="ignore"):
        return np.exp(x)


_FUNCTIONS = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "max": lambda a, b: np.where(a > b, a, b),
    "min": lambda a, b: np.where(a < b, a, b),
    "less": lambda a, b: np.where(a < b, 1.0, 0.0),
    "where": lambda c, a, b: np.where(c, a, b),
    "neg": lambda a: -a,
    "exp": _exp,
    "sqrt": np.sqrt,
}
