"""Analysis of variance the slow way: nested models fitted by explicit projections."""

import itertools

import numpy as np
from jaxtyping import Float, Int


def columns(
    codes: Int[np.ndarray, "rows vars"], effect: tuple[int, ...]
) -> Float[np.ndarray, "rows columns"]:
    """Indicators of every combination of the effect's levels; () is the constant."""
    found = [np.ones(len(codes))]
    if effect:
        part = codes[:, list(effect)]
        found = [np.all(part == level, axis=1) for level in np.unique(part, axis=0)]
    return np.column_stack(found).astype(float)


def left(
    codes: Int[np.ndarray, "rows vars"],
    effects: list[tuple[int, ...]],
    y: Float[np.ndarray, " rows"],
) -> tuple[float, int]:
    """Residual sum of squares and rank of a model of these effects."""
    design = np.hstack([columns(codes, e) for e in [(), *effects]])
    basis, size, _ = np.linalg.svd(design, full_matrices=False)
    basis = basis[:, size > 1e-9 * size[0]]
    rest = y - basis @ (basis.T @ y)
    return float(rest @ rest), basis.shape[1]


def effects(variables: int, order: int) -> list[tuple[int, ...]]:
    """All effects up to this order."""
    return [
        e
        for n in range(1, order + 1)
        for e in itertools.combinations(range(variables), n)
    ]


def f_test(
    codes: Int[np.ndarray, "rows vars"],
    effect: tuple[int, ...],
    y: Float[np.ndarray, " rows"],
    order: int,
) -> tuple[int, int, float, float]:
    """(freedom, spare, squares, F) beyond all effects that do not contain this one.

    The error is what the saturated model of all cells leaves.
    """
    others = [e for e in effects(codes.shape[1], order) if not set(effect) <= set(e)]
    without, rank = left(codes, others, y)
    within, full = left(codes, [*others, effect], y)
    error, cells = left(codes, [tuple(range(codes.shape[1]))], y)
    spare = len(y) - cells
    squares = without - within
    return full - rank, spare, squares, squares / (full - rank) / (error / spare)
