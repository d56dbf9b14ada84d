"""The reference: a program run in numpy, operation by operation."""

import dataclasses
from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxnarx.checks import choice
from jaxnarx.errors import SpecError
from jaxnarx.exporters.form import Op, SampleProgram

Inputs = Float[np.ndarray, "inputs *runs"] | Float[Array, "inputs *runs"]
Outputs = Float[np.ndarray, "computed *runs"] | Float[Array, "computed *runs"]
SETTLED_SHARE, LONGEST_SETTLING = 1e-10, 100_000
"""Share of an output's range within which it stands still, and samples for it."""
SETTLED_SINGLE = 1e-6
"""The same in single precision."""
STILL_SAMPLES = 10
"""It rests when it has stood still for more samples than this."""
STARTS = {
    "steady": "the steady state at the first inputs, solved",
    "mean": "outputs in the middle of their trained ranges, for ever",
    "given": "given outputs, and measured history behind them",
    "zeros": "outputs at zero, for ever",
}
"""How a run may begin, in every target and in this order: inputs have been as at first
for ever, but for what is given. See `Instance.start`."""
STEADY, MEAN, GIVEN, ZEROS = STARTS


@dataclasses.dataclass(eq=False)
class Instance:
    """A program with what it keeps from sample to sample, of one run or of many side by
    side: those are trailing axes of inputs and outputs. `xp` are the functions of
    arrays, those of numpy or of jax."""

    program: SampleProgram
    xp: Any = np

    def __post_init__(self) -> None:
        self.tables = {t.name: t.values.ravel().tolist() for t in self.program.tables}
        self.delays = {d.name: [0.0] * d.length for d in self.program.delays}
        self.states: dict[str, Any] = {s.name: 0.0 for s in self.program.states}
        self._begin = self.program.begin
        self._observe, self._step = self.program.observe, self.program.step

    def start(
        self,
        kind: str,
        inputs: Inputs,
        outputs: Outputs | None = None,
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
        inputs: Inputs,
        outputs: Outputs,
    ) -> None:
        """Begin as if inputs and outputs (hidden ones, too) had been these for ever."""
        values = self._values(self._begin, inputs, outputs)
        for line in self.program.delays:
            self.delays[line.name] = [values[line.start]] * line.length
        for state in self.program.states:
            self.states[state.name] = values[state.start]

    def settle(self, inputs: Inputs) -> Int[np.ndarray, "*runs"]:
        """Start from the steady state at these inputs: where the free run comes to rest
        from the middle of the trained ranges. Returns how many samples that took,
        `LONGEST_SETTLING` where it did not."""
        samples, self.delays, self.states = _samples_to_rest(self.program, inputs)
        return samples

    def _ranges(self, inputs: Inputs):
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
        inputs: Inputs,
        outputs: Outputs,
    ) -> None:
        """One sample of measured history; `outputs` holds hidden ones, too."""
        values = self._values(self._observe, inputs, outputs)
        self._keep(values, measured=True)

    def step(self, inputs: Inputs) -> dict[str, Any]:
        """One sample of the free run: `outputs` as reported, `fed` what is fed back,
        `limited` and the program's flags."""
        values = self._values(self._step, inputs, np.zeros(0))
        program, runs, xp = self.program, np.shape(inputs)[1:], self.xp
        found = {
            name: xp.stack(
                [xp.broadcast_to(values[n], runs) for n in getattr(program, name)]
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
        with np.errstate(over="ignore"):
            for n in needed:
                op = self.program.ops[n]
                args = [values[a] for a in op.args]
                values[n] = self._value(op, args, inputs, outputs)
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
        return _apply(self.xp, op.kind, *args)


def _apply(xp: Any, kind: str, a: Any, *more: Any) -> Any:
    """An operation on values; of single ones numbers, not arrays, which could be
    changed where they are kept."""
    match kind, more:
        case "add", (b,):
            return a + b
        case "sub", (b,):
            return a - b
        case "mul", (b,):
            return a * b
        case "div", (b,):
            return a / b
        case "max", (b,):
            return xp.where(a > b, a, b)[()]
        case "min", (b,):
            return xp.where(a < b, a, b)[()]
        case "less", (b,):
            return xp.where(a < b, 1.0, 0.0)[()]
        case "where", (b, c):
            return xp.where(a > 0.5, b, c)[()]
        case "neg", ():
            return -a
        case "exp", ():
            return xp.exp(a)
        case "sqrt", ():
            return xp.sqrt(a)
    raise NotImplementedError(kind)


def _samples_to_rest(program: SampleProgram, inputs: Inputs):
    """The number of samples in which the free run comes to rest, and what it then
    keeps.

    It is one loop of jax: some thousand samples of some hundred runs take a second.
    """
    u = jnp.asarray(inputs)
    u = u.astype(jnp.result_type(u, float))
    settled = SETTLED_SHARE if u.dtype == jnp.float64 else SETTLED_SINGLE
    instance = Instance(program, jnp)
    middle, width = (jnp.asarray(a, u.dtype) for a in instance._ranges(inputs))
    runs = u.shape[1:]

    def broadcast_state():
        held = instance.delays, instance.states
        return jax.tree.map(
            lambda x: jnp.broadcast_to(jnp.asarray(x, u.dtype), runs), held
        )

    def goes_on(carry):
        n, rested, *_ = carry
        return (n < LONGEST_SETTLING) & jnp.any(rested == LONGEST_SETTLING)

    def advance(carry):
        n, rested, still, before, held = carry
        instance.delays, instance.states = held
        now = instance.step(u)["fed"]
        # what is not a number does not rest
        rests = jnp.all(jnp.abs(now - before) <= settled * width, axis=0)
        still = jnp.where(rests, still + 1, 0)
        rested = jnp.where(
            (still > STILL_SAMPLES) & (rested == LONGEST_SETTLING), n, rested
        )
        return n + 1, rested, still, now, broadcast_state()

    @jax.jit
    def run():
        instance.begin(u, middle)
        none = jnp.zeros(runs, int)
        start = 0, none + LONGEST_SETTLING, none, middle, broadcast_state()
        _, rested, _, _, held = jax.lax.while_loop(goes_on, advance, start)
        return rested, held

    rested, held = jax.tree.map(np.asarray, run())
    return rested, *held
