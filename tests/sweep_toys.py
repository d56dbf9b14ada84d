"""Works of a sweep that need no engine: each obeys the protocol and is picklable."""

import dataclasses
import os
import random
import signal
import time
from collections.abc import Sequence
from typing import Any

BED = """
[data]
bed = "pfi-cc"
count = 2
spread = 0.02
length = 120
[identification.pool]
outputs = ["speed"]
input_lags = [0, 1]
degree = 1
[identification.select]
max_terms = 3
[identification.refine]
horizons = []
max_steps = 1
[cases]
refine.ridge = [1e-6, 1e-4]
"""
"""The smallest sweep of virtual engines, as the command reads it."""


@dataclasses.dataclass(frozen=True)
class Toy:
    """Members of two engines by ridge, whose error is a formula of their labels.

    `trouble` says what befalls the members `bad`: `"raise"`, `"memory"` (whenever more
    than `room` are computed at once), `"kill"` or `"interrupt"`.
    """

    count: int = 12
    scale: float = 1.0
    pause: float = 0.0
    bad: tuple[int, ...] = ()
    trouble: str = "raise"
    room: int = 1
    diary: str = ""
    text: int = 0

    @property
    def members(self) -> list[dict[str, Any]]:
        return [
            {"engine": f"e{i // 6}", "ridge": 10.0 ** -(i % 3), "start": i % 6 // 3}
            for i in range(self.count)
        ]

    def describe(self) -> dict[str, Any]:
        return {"settings": {"count": self.count, "scale": self.scale}, "data": "ab12"}

    def run(self, indices: Sequence[int]) -> list[dict[str, Any]]:
        time.sleep(self.pause * len(indices))
        self._write(indices)
        self._suffer(indices)
        return [self._row(i) for i in indices]

    def _row(self, i: int) -> dict[str, Any]:
        diverged = i % 7 == 5
        return {
            "status": "diverged" if diverged else "ok",
            "error": None if diverged else self.scale / (1 + i),
            "terms": ["u[t]", "y[t-1]"][: 1 + i % 2],
            "text": random.Random(i).randbytes(self.text).hex(),
        }

    def _write(self, indices: Sequence[int]) -> None:
        if self.diary:
            with open(self.diary, "a") as file:
                file.write(f"{os.getpid()} {' '.join(map(str, indices))}\n")

    def _suffer(self, indices: Sequence[int]) -> None:
        if self.trouble == "memory":
            if len(indices) > self.room:
                raise RuntimeError("RESOURCE_EXHAUSTED: out of memory allocating")
            return
        hit = [i for i in indices if i in self.bad]
        if hit and self.trouble == "raise":
            raise ZeroDivisionError(f"engine {hit[0]} stalled")
        if hit and self.trouble == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        if hit and self.trouble == "interrupt":
            raise KeyboardInterrupt


class Settings(Toy):
    """A row tells how the process that computes it is set."""

    def _row(self, i: int) -> dict[str, Any]:
        names = ("OMP_NUM_THREADS", "JAX_ENABLE_X64", "PYTHONSAFEPATH", "XLA_FLAGS")
        return {
            "status": "ok",
            "cores": sorted(os.sched_getaffinity(0)),
            "set": [os.environ[name] for name in names],
        }


class Lawless(Toy):
    """It returns a row too few."""

    def run(self, indices: Sequence[int]) -> list[dict[str, Any]]:
        return super().run(indices)[1:]


class Compiled(Toy):
    """Rows from a compiled program of as many lanes as there are members."""

    def run(self, indices: Sequence[int]) -> list[dict[str, Any]]:
        import jax
        import jax.numpy as jnp

        # float64 is the point: equal to the last bit.
        at = jnp.asarray(indices, float)
        waves = jax.jit(
            lambda x: jnp.sum(jnp.sin(x[:, None] * jnp.arange(1.0, 50.0)), 1)
        )
        found = waves(at)
        (device,) = found.devices()
        return [{"status": "ok", "value": float(v), "device": device.id} for v in found]
