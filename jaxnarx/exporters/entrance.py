"""Entrance of inputs and measured outputs into a program: missing ones are held.

The rule is that of `jaxnarx.models.missing`. A comparison with NaN is false, so a value
is there where its size is less than the largest one; this holds wherever the language
keeps to IEEE 754, in C not under -ffast-math.
"""

from collections.abc import Sequence

import numpy as np

from jaxnarx.exporters.form import Builder, StateValue, Value
from jaxnarx.models import Network, largest_sizes, trusted_samples

HELD_PREFIX = "held_"
"""Names of the states that keep the last value of an input that was not missing."""
GAP_STATE = "gap"
"""State: for how many samples in a row an input has been missing."""


class Entrance:
    """The inputs of a program as it sees them, held where they are missing.

    `first` has the value that stands for each of them while a run begins, when nothing
    has been held yet.
    """

    def __init__(self, b: Builder, network: Network, inputs: Sequence[int]) -> None:
        self.b, self.network, self.inputs = b, network, list(inputs)
        self.sizes = largest_sizes(network)
        low, high = (np.asarray(a, float) for a in (network.low, network.high))
        self.middle = 0.5 * (low + high)
        self.first: dict[Value, Value] = {}
        self.held: dict[int, StateValue] = {}

    def signal(self, signal: int) -> Value:
        """An input at this sample, or the last value that was not missing."""
        b, place = self.b, self.inputs.index(signal)
        raw, name = b.op("input", source=place), f"{HELD_PREFIX}{place}"
        there = self._is_there(raw, signal)
        clean = b.op("where", there, raw, b.op("state", source=name))
        first = b.op("where", there, raw, b.const(self.middle[signal]))
        self.first[clean] = first
        self.held[signal] = StateValue(name, clean, first)
        return clean

    def measured_output(
        self, o: int, value: Value | None = None, else_: Value | None = None
    ) -> Value:
        """The measured output o, or a value made of it; where it is missing another, by
        default the middle of its trained range."""
        b, signal = self.b, self.network.signals[o]
        raw = b.op("measured", source=o)
        value = raw if value is None else value
        else_ = b.const(self.middle[signal]) if else_ is None else else_
        return b.op("where", self._is_there(raw, signal), value, else_)

    @property
    def missing(self) -> Value:
        """1 where an input that the network uses is missing, else 0."""
        b, used = self.b, self.network.used
        if not used:
            return b.const(0.0)
        raws = (b.op("input", source=self.inputs.index(s)) for s in used)
        there = [self._is_there(raw, s) for raw, s in zip(raws, used, strict=True)]
        return b.no(b.smallest(there))

    def flags(self) -> dict[str, Value]:
        """`missing`: for how many samples in a row; `invalid`: for too many."""
        b = self.b
        enough = b.const(trusted_samples(self.network) - 0.5)
        count = self._count()
        return {"missing": count, "invalid": b.op("less", enough, count)}

    def states(self) -> list[StateValue]:
        """Held inputs, and how long one has been missing."""
        b, held = self.b, list(self.held.values())
        if not self.network.used:
            return held
        never = b.const(float(trusted_samples(self.network)))
        start = b.op("where", self.missing, never, b.const(0.0))
        return [*held, StateValue(GAP_STATE, self._count(), start)]

    def _count(self) -> Value:
        b = self.b
        if not self.network.used:
            return b.const(0.0)
        more = b.add(b.op("state", source=GAP_STATE), b.const(1.0))
        return b.op("where", self.missing, more, b.const(0.0))

    def _is_there(self, raw: Value, signal: int) -> Value:
        size = self.b.size(raw, 1.0)
        return self.b.op("less", size, self.b.const(float(self.sizes[signal])))
