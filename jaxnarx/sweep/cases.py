"""Points of a sweep: all combinations of some values, or points drawn at random."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxnarx.errors import SpecError
from jaxnarx.methods import Case

SCALES = ("log", "uniform", "integer")


def _known(names: Sequence[str]) -> None:
    for name in names:
        if name not in Case.__dataclass_fields__:
            known = ", ".join(Case.__dataclass_fields__)
            raise SpecError(
                f"a case has no setting {name!r}; it has {known}", field=name
            )


def grid_cases(**values: Any) -> list[Case]:
    """Cases of all combinations: `grid_cases(ridge=[0, 1e-4], terms=[4, 8])` are four.

    The last setting varies fastest. Settings that are not named keep their defaults.
    """
    _known(list(values))
    for name, row in values.items():
        if isinstance(row, str) or not isinstance(row, Sequence | np.ndarray):
            raise SpecError(f"{name} must be a list of values, got {row!r}", field=name)
    rows = [[_plain(v) for v in row] for row in values.values()]
    chosen = itertools.product(*rows)
    return [Case(**dict(zip(values, row, strict=True))) for row in chosen]


def random_cases(seed: int, count: int, **ranges: Any) -> list[Case]:
    """`count` cases with settings drawn at random, the same for the same `seed`.

    A range is `("log", low, high)`, uniform in the logarithm, `("uniform", low, high)`,
    `("integer", low, high)` with both ends, or a list to choose from.
    """
    _known(list(ranges))
    if count < 1:
        raise SpecError(f"count must be at least 1, got {count}", field="count")
    rng = np.random.default_rng(seed)
    columns = {name: _drawn(name, r, count, rng) for name, r in ranges.items()}
    return [
        Case(**{name: column[n] for name, column in columns.items()})
        for n in range(count)
    ]


def _drawn(name: str, values: Any, count: int, rng: np.random.Generator) -> list:
    if isinstance(values, str) or not len(values):
        raise SpecError(f"{name} has no range: {values!r}", field=name)
    if not isinstance(values[0], str) or values[0] not in SCALES:
        return [_plain(values[n]) for n in rng.integers(len(values), size=count)]
    scale, *ends = values
    if len(ends) != 2 or not ends[0] <= ends[1] or (scale == "log" and ends[0] <= 0):
        raise SpecError(
            f"the range of {name} must be ({scale!r}, low, high) with low <= high"
            f"{' and low > 0' if scale == 'log' else ''}, got {values!r}",
            field=name,
        )
    low, high = ends
    if scale == "integer":
        return rng.integers(low, high, size=count, endpoint=True).tolist()
    if scale == "log":
        return np.exp(rng.uniform(np.log(low), np.log(high), size=count)).tolist()
    return rng.uniform(low, high, size=count).tolist()


def _plain(value: Any) -> Any:
    """Numbers of NumPy as those of Python: they stand in tables and in JSON."""
    return value.item() if isinstance(value, np.generic) else value
