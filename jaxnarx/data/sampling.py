"""The sample time a time column states, and whether the column keeps to it."""

import numpy as np
from jaxtyping import Float

from jaxnarx.data.place import Place
from jaxnarx.errors import DataError, SpecError

MAX_JITTER = 0.01
"""Largest deviation of a time step that still counts as uniform, as a fraction."""

JUMP = 1.5
"""A step longer than this many sample times is a gap between samples."""


def positive_sample_time(value: object) -> float:
    """`value` as a sample time [s]; SpecError unless positive, finite and a number."""
    is_number = isinstance(value, int | float | np.integer | np.floating)
    if not is_number or isinstance(value, bool) or not 0 < value < np.inf:  # type: ignore[operator]
        raise SpecError(
            "sample_time must be a positive finite number of seconds, "
            f"got {value!r}; for 10 Hz give sample_time=0.1",
            field="sample_time",
        )
    return float(value)  # type: ignore[arg-type]


def sampling(
    t: Float[np.ndarray, " time"],
    *,
    column: str,
    place: Place,
    sample_time: float | None = None,
    split: bool = False,
) -> tuple[float, list[int]]:
    """Sample time [s] and the rows at which a new segment begins after a gap.

    `t` [s] must increase. Without `sample_time` every step must be within 1 % of the
    mean step, which is returned, rounded to nine digits. With it, the
    stamps need only lie within half a step of the stated grid, which forgives stamps
    that were rounded. Steps longer than 1.5 sample times are gaps: refused, or
    with `split` the beginnings of new segments.
    """
    _require_increasing(t, column, place)
    steps = np.diff(t)
    usual = float(np.median(steps)) if sample_time is None else sample_time
    gaps = np.flatnonzero(steps > JUMP * usual)
    if gaps.size > 0.1 * steps.size:
        gaps = gaps[:0]  # not gaps in a raster: there is no raster
    inside = np.delete(steps, gaps)
    if sample_time is not None:
        _require_same_step(float(inside.mean()), sample_time, column, place)
    if gaps.size and not split:
        raise _jump(t, gaps, column, place)
    cuts = [int(i) + 1 for i in gaps]
    if sample_time is None:
        _require_uniform(steps, gaps, column, place)
        return float(f"{inside.mean():.9g}"), cuts
    _require_grid(t, cuts, sample_time, column, place)
    return sample_time, cuts


def _require_increasing(t, column, place):
    if t.size < 2:
        raise DataError(
            f"{place.lead}time column {column!r} has {t.size} row(s); at least 2 are "
            "needed to tell the sample time. Give sample_time instead.",
            channel=column,
        )
    bad = np.flatnonzero(~np.isfinite(t))
    if bad.size:
        raise DataError(
            f"{place.lead}time column {column!r} has {bad.size} missing value(s), "
            f"first at {place.row(bad[0])}. Repair the column, or leave it out and "
            "give sample_time.",
            channel=column,
            row=int(bad[0]),
        )
    back = np.flatnonzero(np.diff(t) <= 0)
    if back.size:
        i = int(back[0])
        does = "repeats" if t[i + 1] == t[i] else "goes back from"
        to = "" if t[i + 1] == t[i] else f" to {t[i + 1]:.9g} s"
        raise DataError(
            f"{place.lead}time column {column!r} does not increase: it {does} "
            f"{t[i]:.9g} s{to} between {place.rows(i, i + 1)}; {back.size} such "
            "place(s). Remove the repeated rows, or put each run in a file or record "
            "of its own.",
            channel=column,
            row=i + 1,
            time=float(t[i + 1]),
        )


def _require_same_step(step, sample_time, column, place):
    if abs(step - sample_time) > 0.1 * sample_time:
        raise DataError(
            f"{place.lead}time column {column!r} advances by {step:.6g} s a row, but "
            f"sample_time is {sample_time:.6g} s. Correct sample_time, or leave it "
            "out to take it from the column.",
            channel=column,
        )


def _jump(t, gaps, column, place) -> DataError:
    i = int(gaps[0])
    return DataError(
        f"{place.lead}time column {column!r} jumps from {t[i]:.9g} s to "
        f"{t[i + 1]:.9g} s between {place.rows(i, i + 1)}; {gaps.size} such place(s). "
        "Use missing='split' to begin a new record after every jump.",
        channel=column,
        row=i + 1,
        time=float(t[i + 1]),
    )


def _require_uniform(steps, gaps, column, place):
    inside = np.delete(steps, gaps)
    reference = float(inside.mean())
    off = np.abs(steps - reference)
    off[gaps] = 0
    i = int(np.argmax(off))
    jitter = float(off[i]) / reference
    if jitter > MAX_JITTER:
        raise DataError(
            f"{place.lead}time column {column!r} is not uniform: steps from "
            f"{inside.min():.6g} s to {inside.max():.6g} s around {reference:.6g} s, "
            f"jitter {100 * jitter:.3g} % (worst between {place.rows(i, i + 1)}). "
            "Resample the data to a constant step first; if only the stamps are "
            f"rough, state sample_time={reference:.6g} beside the time column or "
            "leave the column out.",
            channel=column,
            row=i + 1,
        )


def _require_grid(t, cuts, sample_time, column, place):
    bounds = [0, *cuts, t.size]
    for first, stop in zip(bounds[:-1], bounds[1:], strict=True):
        grid = t[first] + sample_time * np.arange(stop - first)
        off = np.abs(t[first:stop] - grid)
        if off.max() > 0.5 * sample_time:
            i = int(np.argmax(off > 0.5 * sample_time))
            raise DataError(
                f"{place.lead}time column {column!r} leaves the grid of sample_time "
                f"{sample_time:.6g} s by more than half a step at "
                f"{place.row(first + i)} (jitter "
                f"{100 * float(off.max()) / sample_time:.3g} %). State the sample "
                "time with more digits, or resample the data to a constant step.",
                channel=column,
                row=first + i,
                time=float(t[first + i]),
            )
