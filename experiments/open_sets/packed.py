"""An open set as one file of arrays, for interpreters that do not have the package.

Only the standard library is imported here; numpy inside the functions.
"""

import dataclasses
import json
from pathlib import Path
from typing import Any

from sets import OpenSet, Part


@dataclasses.dataclass(frozen=True, eq=False)
class Runs:
    """Inputs (time, inputs) and one output (time,) of every record.

    `truth` is what a run is held against, `first` the first scored sample, `window` how
    many measured samples before it are given officially.
    """

    u: list[Any]
    y: list[Any]
    truth: list[Any]
    first: int = 0
    window: int = 0


@dataclasses.dataclass(frozen=True, eq=False)
class Task:
    """What a peer is given: one output, training records, and the parts of the test."""

    train: Runs
    parts: dict[str, Runs]
    scale: float


def pack(open_set: OpenSet, path: Path) -> dict[str, Any]:
    """Write the set to `path`; return what the table says of it."""
    import numpy as np

    arrays: dict[str, Any] = {}
    groups: dict[str, Part] = {"train": Part(open_set.train, 0, window=0)}
    groups |= {f"part {name}": part for name, part in open_set.parts.items()}
    about: dict[str, Any] = {"scale": open_set.scale, "outputs": open_set.outputs}
    about["groups"] = {}
    for name, part in groups.items():
        sizes = {"first": part.first, "window": part.window}
        about["groups"][name] = {"records": len(part.data)} | sizes
        for n, record in enumerate(part.data):
            assert record.valid.all(), "peers do not know missing samples"
            arrays[f"{name} u {n}"] = record.u
            arrays[f"{name} y {n}"] = record.y
            arrays[f"{name} truth {n}"] = part.targets[n]
    np.savez(path, about=np.array(json.dumps(about)), **arrays)
    return told(open_set)


def told(open_set: OpenSet) -> dict[str, Any]:
    """What the table says of a set: sizes, split, units."""
    channels = open_set.train.channels
    return {
        "inputs": list(channels.input_names),
        "outputs": open_set.outputs,
        "sample_time": float(f"{open_set.train.sample_time:.6g}"),
        "train": [len(record) for record in open_set.train],
        "test": {
            name: {"samples": [len(r) for r in part.data], "first_scored": part.first}
            for name, part in open_set.parts.items()
        },
        "split": open_set.split,
        "unit": dict(open_set.unit),
        "published": open_set.published,
    }


def unpack(path: str, output: str) -> Task:
    """The task of one output from a file that `pack` has written."""
    import numpy as np

    with np.load(path) as file:
        about = json.loads(str(file["about"]))
        at = about["outputs"].index(output)

        def runs(name: str) -> Runs:
            known = about["groups"][name]
            u, y, truth = (
                [file[f"{name} {kind} {n}"] for n in range(known["records"])]
                for kind in ("u", "y", "truth")
            )
            y, truth = ([a[:, at] for a in arrays] for arrays in (y, truth))
            return Runs(u, y, truth, known["first"], known["window"])

        parts = {n[5:]: runs(n) for n in about["groups"] if n.startswith("part ")}
        return Task(runs("train"), parts, about["scale"])
