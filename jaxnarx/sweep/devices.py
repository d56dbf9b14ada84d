"""One process, several devices: every chunk is divided among them."""

import dataclasses
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax

from jaxnarx.sweep.work import Work


@dataclasses.dataclass(frozen=True)
class OverDevices:
    """Work whose chunks are computed in equal parts, one on every local device.

    ```python
    run_sweep(OverDevices(work), "runs/x", chunk=64)
    ```

    A thread for each device computes its part with that device as jax's default. All
    parts but the last have the same size. A row does not depend on the number of
    devices as long as the size of its part does not.
    """

    work: Work

    @property
    def members(self) -> list[dict[str, Any]]:
        """The labels of the work."""
        return self.work.members

    def describe(self) -> dict[str, Any]:
        """Describe the work; where it is computed is no part of it."""
        return self.work.describe()

    def run(self, indices: Sequence[int]) -> list[dict[str, Any]]:
        """The rows of the work."""
        devices = jax.local_devices()
        size = -(-len(indices) // len(devices))
        parts = [indices[i : i + size] for i in range(0, len(indices), size)]
        with ThreadPoolExecutor(len(devices)) as threads:
            found = threads.map(self._part, devices, parts)
            return [row for rows in found for row in rows]

    def _part(self, device: Any, indices: Sequence[int]) -> list[dict[str, Any]]:
        with jax.default_device(device):
            return self.work.run(indices)
