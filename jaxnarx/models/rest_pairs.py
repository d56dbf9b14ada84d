"""Pairs of held inputs between which physics says how outputs at rest move."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.data import Dataset, input_levels
from jaxnarx.errors import SpecError
from jaxnarx.models._assemble import ranges
from jaxnarx.settings import Physics

INPUT_STEP_SHARE = 0.05
"""Share of its trained range by which an input is moved to either side of an operating
point."""
OPERATING_POINTS = 1000
"""Operating points at which every sign is asked: measured samples, evenly spread. Of a
measured engine's NOx with five regions a hundred left 17 gains of 402 at other points
wrong, a thousand four, at half a second and no larger an error."""


@dataclasses.dataclass(frozen=True, eq=False)
class RestPairs:
    """Held inputs, physical units: the output at rest at `high` is not lower than that
    at `low`.

    Pairs of one input follow one another, operating point by operating point.
    """

    low: Float[np.ndarray, "pairs inputs"]
    high: Float[np.ndarray, "pairs inputs"]
    moved: tuple[str, ...]
    """The input in which the two differ, pair by pair."""

    def __len__(self) -> int:
        return len(self.low)

    def count(self, chosen: Bool[np.ndarray, " pairs"]) -> dict[str, tuple[int, int]]:
        """The numbers of chosen pairs and of all, by input."""
        moved = np.array(self.moved)
        return {
            name: (int(chosen[moved == name].sum()), int((moved == name).sum()))
            for name in dict.fromkeys(self.moved)
        }


def make_pairs(
    data: Dataset,
    physics: Physics,
    *,
    output: str,
    points: int = OPERATING_POINTS,
) -> RestPairs:
    """What physics says of an output, at measured samples that are spread evenly.

    An input with few values is moved from each to the next, others by
    `INPUT_STEP_SHARE` of their range to either side. SpecError where an input does not
    move in the data: no term of it can be trained.
    """
    names, inputs = data.channels.input_names, len(data.channels.inputs)
    least, most = (end[:inputs] for end in ranges(data))
    rows = operating_points(data, points)
    low, high, moved = [], [], []
    for name, sign in physics.signs.items():
        s = names.index(name)
        if not most[s] > least[s]:
            raise SpecError(
                f"physics of {output}: {name} does not move in the records, so no "
                "model has a term of it; leave its sign out, or add records in which "
                "it moves",
                field=f"physics.{output}",
            )
        for below, above in _steps(
            rows[:, s], input_levels(data, s), least[s], most[s]
        ):
            ends = [_with_input(rows, s, value) for value in (below, above)]
            low.append(ends[0 if sign > 0 else 1])
            high.append(ends[1 if sign > 0 else 0])
            moved += [name] * len(rows)
    return RestPairs(np.concatenate(low), np.concatenate(high), tuple(moved))


def operating_points(data: Dataset, points: int) -> Float[np.ndarray, "points inputs"]:
    """Inputs of so many samples at which all of them are valid, evenly spread."""
    inputs = len(data.channels.inputs)
    rows = [r.u[r.valid[:, :inputs].all(axis=1)] for r in data]
    every = np.concatenate(rows).astype(float)
    at = np.linspace(0, len(every) - 1, min(points, len(every)))
    return every[np.unique(at.astype(int))]


def _steps(
    here: Float[np.ndarray, " points"],
    levels: Sequence[float] | None,
    least: float,
    most: float,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Lower and upper values of an input at every point."""
    if levels is not None and len(levels) > 1:
        pairs = zip(levels, levels[1:], strict=False)
        return [(np.full(len(here), a), np.full(len(here), b)) for a, b in pairs]
    step = INPUT_STEP_SHARE * (most - least)
    return [(np.maximum(here - step, least), np.minimum(here + step, most))]


def _with_input(rows: np.ndarray, s: int, value: np.ndarray) -> np.ndarray:
    out = rows.copy()
    out[:, s] = value
    return out
