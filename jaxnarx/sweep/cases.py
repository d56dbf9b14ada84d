"""Points of a sweep: all combinations of some values, or points drawn at random.

A case is a mapping from paths into the settings tree to values, such as
`{"refine.ridge": 1e-4}`; `{}` is the identification as it stands.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import whole
from jaxnarx.errors import SpecError
from jaxnarx.settings import Identification, hint_at, plain_value, value_at

RANGE_SCALES = ("log", "uniform", "integer")
Case = Mapping[str, Any]


@guard_arguments
def grid_cases(values: Mapping[str, Any]) -> list[Case]:
    """Cases of all combinations of values by path; the last path varies fastest.

    `grid_cases({"refine.ridge": [0, 1e-4], "select.max_terms": [4, 8]})` are four.
    """
    for path, row in values.items():
        hint_at(Identification, path)
        if isinstance(row, str) or not isinstance(row, Sequence | np.ndarray):
            raise SpecError(f"{path} must be a list of values, got {row!r}", field=path)
    rows = [[plain_value(v) for v in row] for row in values.values()]
    return [dict(zip(values, row, strict=True)) for row in itertools.product(*rows)]


@guard_arguments
def random_cases(seed: int, count: int, ranges: Mapping[str, Any]) -> list[Case]:
    """`count` cases with settings drawn at random, the same for the same `seed`.

    A range is `("log", low, high)`, uniform in the logarithm, `("uniform", low, high)`,
    `("integer", low, high)` with both ends, or a list to choose from.
    """
    count = whole(count, "count")
    rng = np.random.default_rng(whole(seed, "seed", 0))
    columns = {path: _draw(path, r, count, rng) for path, r in ranges.items()}
    return [{path: column[n] for path, column in columns.items()} for n in range(count)]


def setting_label(method: Identification, path: str) -> str | int | float | bool | None:
    """A setting as a plain scalar, for a table."""
    value = plain_value(value_at(method, path))
    if value is None and path in ("select", "grow", "refine"):
        return "none"
    if isinstance(value, list):
        return " ".join(map(str, value))
    if isinstance(value, dict):
        return ", ".join(f"{name} {plain_value(v)}" for name, v in value.items())
    if isinstance(value, str | int | float | None):
        return value
    return getattr(value, "__qualname__", type(value).__qualname__)


def _draw(path: str, values: Any, count: int, rng: np.random.Generator) -> list:
    hint_at(Identification, path)
    if isinstance(values, str) or not len(values):
        raise SpecError(f"{path} has no range: {values!r}", field=path)
    if not isinstance(values[0], str) or values[0] not in RANGE_SCALES:
        return [plain_value(values[n]) for n in rng.integers(len(values), size=count)]
    scale, *ends = values
    if len(ends) != 2 or not ends[0] <= ends[1] or (scale == "log" and ends[0] <= 0):
        raise SpecError(
            f"the range of {path} must be ({scale!r}, low, high) with low <= high"
            f"{' and low > 0' if scale == 'log' else ''}, got {values!r}",
            field=path,
        )
    low, high = ends
    if scale == "integer":
        return rng.integers(low, high, size=count, endpoint=True).tolist()
    if scale == "log":
        return np.exp(rng.uniform(np.log(low), np.log(high), size=count)).tolist()
    return rng.uniform(low, high, size=count).tolist()
