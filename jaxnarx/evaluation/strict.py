"""Any host value as strict JSON: no NaN, no infinity, no arrays."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np


def strict(value: Any) -> Any:
    """`value` in lists, dicts, text, numbers and None; `inf` as text, NaN as None."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = dataclasses.fields(value)
        return {f.name: strict(getattr(value, f.name)) for f in fields}
    if isinstance(value, Mapping):
        return {str(key): strict(item) for key, item in value.items()}
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return _real(float(value))
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, Sequence | set | frozenset):
        return [strict(item) for item in value]
    if isinstance(value, np.ndarray | jax.Array):
        return strict(np.asarray(value).tolist())
    return str(value)


def _real(value: float) -> float | str | None:
    if math.isnan(value):
        return None
    return value if math.isfinite(value) else ("inf" if value > 0 else "-inf")
