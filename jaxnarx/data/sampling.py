"""The sample time a time column states, and whether the column keeps to it."""

import re

import numpy as np
from jaxtyping import Float

from jaxnarx.checks import choice
from jaxnarx.data.record import RowSource
from jaxnarx.errors import DataError, SpecError

MAX_JITTER = 0.01
"""Largest deviation of a time step that still counts as uniform, as a fraction."""

GAP_FACTOR = 1.5
"""A step longer than this many sample times is a gap between samples."""


TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0}
"""Units of time [s] that a column of numbers may be in."""

_UNIT_PATTERN = re.compile(r"(?:^|[\s\[(_/.])(s|ms|us|µs|min|h|sec|msec)[\])]?$")
_UNIT_SPELLINGS = {"µs": "us", "sec": "s", "msec": "ms"}


STATIC_ADVICE = (
    "Operating points without time take any sample time, such as 1, and a model "
    "without lags: jaxnarx identify engine.toml --input-lags 0 --output-lags "
    "--partition tree."
)
"""Advice for data that are no time series."""


def require_time_unit(unit: object) -> None:
    """SpecError unless `unit` is one of TIME_UNITS or None."""
    if unit is not None:
        choice(unit, TIME_UNITS, "time_unit")


def time_unit_in(*texts: str) -> str | None:
    """The unit that a file states, beside the column's name or in it ("t [ms]")."""
    for text in texts:
        found = _UNIT_PATTERN.search(text.strip())
        if found:
            return _UNIT_SPELLINGS.get(found[1], found[1])
    return None


def positive_sample_time(value: object) -> float:
    """`value` as a sample time [s]; SpecError unless positive, finite and a number."""
    is_number = isinstance(value, int | float | np.integer | np.floating)
    if not is_number or isinstance(value, bool) or not 1e-30 < value < 1e30:  # type: ignore[operator]
        raise SpecError(
            "sample_time must be a positive finite number of seconds, "
            f"got {value!r}; for 10 Hz give sample_time=0.1",
            field="sample_time",
        )
    return float(value)  # type: ignore[arg-type]


def find_sampling(
    t: Float[np.ndarray, " time"],
    *,
    column: str,
    place: RowSource,
    sample_time: float | None = None,
    split: bool = False,
    unit: str | None = None,
) -> tuple[float, list[int]]:
    """Sample time [s] and the rows at which a new segment begins after a gap.

    `t` [s] must increase. Without `sample_time` every step must be within 1 % of the
    mean step, which is returned, rounded to nine digits. With it, the
    stamps need only lie within half a step of the stated grid, which forgives stamps
    that were rounded. Where stamps stay late after a step longer than 1.5 sample times
    there is a gap: refused, or with `split` the beginning of a new segment. Where the
    next steps make up for it, it is jitter. Without `unit`, in which the stamps were
    written, those that look like milliseconds are refused.
    """
    _require_increasing(t, column, place)
    steps = np.diff(t)
    usual = float(np.median(steps)) if sample_time is None else sample_time
    gaps = _gaps(t, steps, usual)
    inside = np.delete(steps, gaps)
    if sample_time is not None:
        _require_same_step(float(inside.mean()), sample_time, column, place)
    elif unit is None:
        _require_seconds(t, usual, column, place)
    if gaps.size and not split:
        raise _jump(t, gaps, column, place)
    cuts = [int(i) + 1 for i in gaps]
    if sample_time is None:
        _require_uniform(steps, gaps, column, place)
        return float(f"{inside.mean():.9g}"), cuts
    _require_grid(t, cuts, sample_time, column, place)
    return sample_time, cuts


def _gaps(t, steps, usual: float):
    """Steps after which the stamps stay at least half a sample late.

    Medians over up to five stamps before and after tell lateness, so that a single late
    stamp is no gap.
    """
    long = np.flatnonzero(steps > GAP_FACTOR * usual)
    if long.size > 0.1 * steps.size:
        return long[:0]  # not gaps in a raster: there is no raster
    big = steps[long] > 2 * usual
    gaps = long[:0]
    for some in (long[big], long[~big]):  # those near a big one are judged without it
        late = np.cumsum(np.delete(steps, gaps) - usual)
        at = some - np.searchsorted(gaps, some)
        late = np.concatenate([np.full(4, np.nan), [0], late, np.full(4, np.nan)])
        near = at[:, None] + np.arange(5)
        after, before = late[near + 5], late[near]
        shift = np.nanmedian(after, axis=1) - np.nanmedian(before, axis=1)
        gaps = np.sort(np.append(gaps, some[shift > 0.5 * usual]))
    return gaps


def _require_seconds(t, usual: float, column, place):
    """Refuse stamps that make better sense in milliseconds; nothing says what is."""
    whole = usual >= 1 and not np.any(t % 1)
    if usual < _SLOW_SECONDS and not (whole and t[-1] - t[0] > _LONG_SECONDS):
        return
    raise DataError(
        f"{place.lead}time column {column!r} advances by {usual:.6g} a row to "
        f"{t[-1] - t[0]:.6g} in all, which looks like milliseconds. State "
        'time_unit="ms", or time_unit="s" if they are seconds.',
        channel=column,
    )


_SLOW_SECONDS, _LONG_SECONDS = 20.0, 3 * 86_400.0
"""Numbers of seconds between samples, and in one run, that are seldom meant."""


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
        advice = "Correct sample_time, or leave it out to take it from the column."
        if abs(1e-3 * step - sample_time) < 0.1 * sample_time:
            advice = 'It seems to be in milliseconds: state time_unit="ms".'
        raise DataError(
            f"{place.lead}time column {column!r} advances by {step:.6g} s a row, but "
            f"sample_time is {sample_time:.6g} s. {advice}",
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
        late = t[first:stop] - sample_time * np.arange(stop - first)
        off = np.abs(late - np.median(late))  # the first stamp is no better than others
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
