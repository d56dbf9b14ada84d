"""Records of the fitting benchmark, its clock, and its measure of error.

Only the standard library is imported here; the rest inside the functions.
"""

import os
import time
from pathlib import Path
from typing import Any

PARTS = ("train", "validation", "test")

SETS: dict[str, dict[str, Any]] = {
    "cascaded_tanks": {
        "file": "cascaded_tanks/dataBenchmark.csv",
        "sample_time": 4.0,
        "start": 5,
        "train": 768,
        "unit": "V",
    },
    "ced_coupled_drives": {
        "file": "ced_coupled_drives/DATAUNIF.MAT",
        "sample_time": 0.02,
        "start": 4,
        "train": 300,
        "unit": "ticks/s",
    },
}
"""`start`: measured samples that the protocol of a set allows to begin a run, and the
longest lag; `train`: samples at the head of an estimation record, the rest validates.
"""


Record = tuple[Any, Any]
"""Input and output of a record."""


def one_processor() -> None:
    """Keep this process, and all its threads, on one processor (Linux)."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


class Clock:
    """Wall and processor time [s] since it was made."""

    def __init__(self):
        self.begin = self.now()

    @staticmethod
    def now() -> tuple[float, float]:
        """Both clocks, from origins of their own."""
        return time.perf_counter(), time.process_time()

    def read(self) -> dict[str, float]:
        """What has passed, by kind."""
        wall, cpu = (b - a for a, b in zip(self.begin, self.now(), strict=True))
        return {"wall": round(wall, 4), "cpu": round(cpu, 4)}


def _tanks(path: Path, head: int) -> dict[str, list[Record]]:
    import numpy as np

    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    u, u_test, y, y_test = table[:, :4].T
    return {
        "train": [(u[:head], y[:head])],
        "validation": [(u[head:], y[head:])],
        "test": [(u_test, y_test)],
    }


def _drives(path: Path, head: int) -> dict[str, list[Record]]:
    from scipy.io import loadmat

    content = loadmat(path)
    runs = [(content[f"u{n}"].ravel(), content[f"z{n}"].ravel()) for n in ("11", "12")]
    cuts = {
        "train": slice(0, head),
        "validation": slice(head, 400),
        "test": slice(400, 500),
    }
    return {part: [(u[cut], y[cut]) for u, y in runs] for part, cut in cuts.items()}


READERS = {"cascaded_tanks": _tanks, "ced_coupled_drives": _drives}


def load(path: str) -> dict[str, list[Record]]:
    """The records of every part, as `fitting_workers.prepare` wrote them."""
    import numpy as np

    with np.load(path) as file:
        arrays = dict(file)
    count = {p: sum(k.startswith(f"u_{p}_") for k in arrays) for p in PARTS}
    return {
        p: [(arrays[f"u_{p}_{n}"], arrays[f"y_{p}_{n}"]) for n in range(count[p])]
        for p in PARTS
    }


def errors(
    start: int, records: list[Record], runs: list[Any]
) -> dict[str, float | list[float | None] | None]:
    """RMSE of free runs from sample `start` on: over all records, and of each.

    In the unit of the output; None for a run that does not stay finite.
    """
    import numpy as np

    squares = [
        (np.asarray(run)[start:] - y[start:]) ** 2
        for (_, y), run in zip(records, runs, strict=True)
    ]

    def root(values: Any) -> float | None:
        value = float(np.sqrt(np.mean(values)))
        return float(f"{value:.5g}") if np.isfinite(value) else None

    return {"all": root(np.concatenate(squares)), "records": [root(s) for s in squares]}
