"""Checks of the numbers given to a regression: shape, kind, finiteness, size."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxnarx.data import check_precision
from jaxnarx.errors import DataError, SpecError


def require_numbers(
    columns: Any, y: Any, names: Sequence[str] | None
) -> tuple[
    Float[np.ndarray, "time terms"], Float[np.ndarray, " time"], tuple[str, ...]
]:
    """Columns, target and names, checked; float32 stays, integers become float64.

    A one-dimensional `columns` is a single column. `SpecError` for other shapes and
    kinds, `DataError` naming column and row for numbers that are not finite or whose
    squares overflow.
    """
    x, target = _array(columns, "columns"), _array(y, "y")
    x = x[:, None] if x.ndim == 1 else x
    target = target[:, 0] if target.ndim == 2 and target.shape[1] == 1 else target
    if x.ndim != 2 or target.ndim != 1 or len(x) != len(target) or 0 in x.shape:
        hint = "; transpose columns" if x.shape[-1:] == target.shape else ""
        raise SpecError(
            f"columns must be (time, terms) and y (time,) of the same length, got "
            f"{x.shape} and {target.shape}{hint}",
            field="columns",
        )
    labels = tuple(names) if names is not None else _number_names(x.shape[1])
    if len(labels) != x.shape[1]:
        raise SpecError(
            f"names must be one per column: {x.shape[1]} columns, {len(labels)} names",
            field="names",
        )
    dtype = np.result_type(x, target)
    check_precision(dtype)
    for column, label in zip((*x.T, target), (*labels, "y"), strict=True):
        _require_finite(column, label)
    return x.astype(dtype), target.astype(dtype), labels


def _number_names(terms: int) -> tuple[str, ...]:
    return tuple(f"x{n + 1}" for n in range(terms))


def _array(value: Any, field: str) -> np.ndarray:
    try:
        array = np.asarray(value)
    except (TypeError, ValueError) as error:
        raise SpecError(
            f"{field} must be an array of numbers: {error}", field=field
        ) from error
    if array.dtype.kind not in "fiub":
        raise SpecError(
            f"{field} must hold real numbers, got {array.dtype}", field=field
        )
    small = array.dtype.kind == "f" and array.dtype.itemsize <= 4
    return array.astype(np.float32 if small else np.float64)


def _require_finite(column: Float[np.ndarray, " time"], name: str) -> None:
    bad = ~np.isfinite(column)
    if bad.any():
        row = int(np.argmax(bad))
        raise DataError(
            f"{name} has {int(bad.sum())} values that are not finite, first "
            f"{column[row]} at row {row}; leave these rows out",
            channel=name,
            row=row,
        )
    largest = float(np.abs(column).max())
    if largest > np.sqrt(np.finfo(column.dtype).max / len(column)):
        row = int(np.argmax(np.abs(column)))
        raise DataError(
            f"{name} reaches {largest:g} at row {row}, whose square overflows; use "
            "another unit",
            channel=name,
            row=row,
        )


def require_weights(
    weights: Any, y: Float[np.ndarray, " time"]
) -> Float[np.ndarray, " time"]:
    """Weights of the samples, ones where none are given; finite and not negative."""
    if weights is None:
        return np.ones_like(y)
    weight = _array(weights, "weights")
    if weight.shape != y.shape:
        raise SpecError(
            f"weights must be one number per sample, {y.shape}, got {weight.shape}",
            field="weights",
        )
    bad = ~np.isfinite(weight) | (weight < 0)
    if bad.any():
        row = int(np.argmax(bad))
        raise DataError(
            f"weights must be finite and not negative, got {weight[row]} at row {row}",
            row=row,
        )
    return weight.astype(y.dtype)
