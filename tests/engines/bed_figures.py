"""What the tests of single beds share: printed figures, and slopes by differences."""

from collections.abc import Callable

import equinox as eqx
import jax
import numpy as np


def half_digit(entry: str) -> float:
    """Half a unit of the last digit that is printed."""
    return 0.5 * 10.0 ** -len(entry.partition(".")[2])


def assert_prints(values, entries: list[str]):
    """Within 0.5 % or half a digit of the printed figures."""
    for value, entry in zip(np.asarray(values), entries, strict=True):
        reference = float(entry)
        allowed = max(0.005 * abs(reference), half_digit(entry))
        assert abs(value - reference) <= allowed, (value, entry)


def at(path: str) -> Callable:
    """The part of a bed by its dotted name."""

    def where(bed):
        for name in path.split("."):
            bed = getattr(bed, name)
        return bed

    return where


def assert_slope(
    value_and_slope: Callable,
    bed,
    path: str,
    *,
    step: float = 1e-5,
    rounding: float = 0.0,
) -> float:
    """The slope by a parameter is the central difference, to 1e-5 of it.

    `value_and_slope` maps a bed to a value and a bed of slopes; the parameter moves by
    the share `step`. A difference resolves `rounding` of the value over the parameter.
    Returns the slope.
    """
    p = float(at(path)(bed))
    low, high = (
        float(value_and_slope(eqx.tree_at(at(path), bed, at(path)(bed) * factor))[0])
        for factor in (1 - step, 1 + step)
    )
    expected = (high - low) / (2 * step * p)
    slope = float(at(path)(value_and_slope(bed)[1]))
    allowed = 1e-5 * abs(expected) + rounding * abs(low / p)
    assert abs(expected) > 0 and abs(slope - expected) <= allowed
    return slope


def assert_finite(tree):
    """No leaf has anything else."""
    for leaf in jax.tree.leaves(tree):
        assert bool(np.isfinite(leaf).all())
