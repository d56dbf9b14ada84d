"""Finite records from rows as they came: treatment of NaN and inf."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.checks import choice
from jaxnarx.data.channels import Channels, require_plain
from jaxnarx.data.record import Record, RowSource
from jaxnarx.errors import DataError, SpecError

_LARGEST_VALUE = {"float64": 1e151, "float32": 1e18}
"""Beyond this, or below its inverse, sums of squares soon leave the type, and the ratio
of two channels, the coefficient of a linear term, may as well."""


@dataclasses.dataclass(frozen=True, eq=False)
class Source:
    """Rows of one run as they came, unchecked: what an array, frame or file gives.

    `x` holds inputs, then outputs, in physical units; missing samples are NaN or inf.
    `cuts` are rows (from 0) at which a new segment begins, after a jump in time.
    """

    name: str
    x: Float[np.ndarray, "time signals"]
    place: RowSource = RowSource()
    cuts: Sequence[int] = ()


def unify_types(sources: Sequence[Source]) -> list[Source]:
    """The sources in one type: float32 when all are, else float64."""
    single = all(s.x.dtype == np.float32 for s in sources)
    dtype = np.float32 if single else np.float64
    return [
        Source(s.name, s.x.astype(dtype, copy=False), s.place, s.cuts) for s in sources
    ]


def assemble(
    sources: Sequence[Source],
    channels: Channels,
    sample_time: float,
    missing: str,
) -> tuple[Record, ...]:
    """The records of `sources`, one or (`missing="split"`) more of each.

    `"refuse"` raises DataError on the first missing sample; `"mask"` holds the previous
    valid sample (the next at the beginning) and marks it invalid; `"split"` drops rows
    with a missing sample and begins a new record after them; `"interpolate"` joins
    valid neighbours by a straight line and counts the result as valid, while missing
    samples at either end are masked. A channel without any finite sample in a record is
    a DataError whichever is chosen.
    """
    require_missing(missing)
    if not sources:
        raise SpecError("a dataset needs at least one record", field="u")
    for source in sources:
        require_plain(source.name, "record names", field="names")
        _require_values(source, channels)
    _require_moderate(sources, channels)
    if missing == "refuse":
        _require_finite(sources, channels, sample_time)
    treat = _MISSING_TREATMENTS[missing]
    n_inputs = len(channels.inputs)
    return tuple(
        Record(
            u=x[:, :n_inputs].copy(),
            y=x[:, n_inputs:].copy(),
            valid=valid,
            name=name,
            start_row=row,
        )
        for source in sources
        for x, valid, name, row in treat(source)
    )


def require_missing(missing: object) -> None:
    """SpecError unless `missing` is one of the four treatments."""
    choice(missing, _MISSING_TREATMENTS, "missing")


_Piece = tuple[np.ndarray, np.ndarray, str, int]


def _refuse(source: Source) -> list[_Piece]:
    finite = np.ones(source.x.shape, bool)
    return [(source.x, finite, source.name, source.place.start_row)]


def _mask(source: Source) -> list[_Piece]:
    finite = np.isfinite(source.x)
    return [(hold(source.x, finite), finite, source.name, source.place.start_row)]


def _interpolate(source: Source) -> list[_Piece]:
    finite = np.isfinite(source.x)
    x, valid = hold(source.x, finite), finite.copy()
    for j in np.flatnonzero(~finite.all(axis=0)):
        known = np.flatnonzero(finite[:, j])
        first, last = known[0], known[-1] + 1
        rows = np.arange(first, last)
        x[first:last, j] = np.interp(rows, known, source.x[known, j])
        valid[first:last, j] = True
    return [(x, valid, source.name, source.place.start_row)]


def _split(source: Source) -> list[_Piece]:
    good: np.ndarray = np.asarray(np.isfinite(source.x).all(axis=1))
    begins = good & ~np.concatenate([[False], good[:-1]])
    begins[list(source.cuts)] |= good[list(source.cuts)]
    firsts = np.flatnonzero(begins)
    if not firsts.size:
        raise DataError(
            f"{source.place.lead or source.name + ': '}no row has all channels valid, "
            "so missing='split' leaves nothing. Use missing='mask', or leave out the "
            "channels with most gaps."
        )
    pieces: list[_Piece] = []
    stops = np.append(firsts[1:], len(good))
    for k, (first, bound) in enumerate(zip(firsts, stops, strict=True)):
        stop = first + int(good[first:bound].sum())
        name = f"{source.name}#{k + 1}" if firsts.size > 1 else source.name
        x = source.x[first:stop]
        row = source.place.start_row + int(first)
        pieces.append((x, np.ones(x.shape, bool), name, row))
    return pieces


_MISSING_TREATMENTS: dict[str, Callable[[Source], list[_Piece]]] = {
    "refuse": _refuse,
    "mask": _mask,
    "split": _split,
    "interpolate": _interpolate,
}


def hold(
    x: Float[np.ndarray, "time signals"], finite: Bool[np.ndarray, "time signals"]
) -> Float[np.ndarray, "time signals"]:
    """`x` with every sample that is not `finite` replaced by the last one that is.

    Before the first finite sample the first is used. Every column needs one.
    """
    rows = np.where(finite, np.arange(len(x))[:, None], -1)
    last = np.maximum.accumulate(rows, axis=0)
    last = np.where(last < 0, np.argmax(finite, axis=0)[None], last)
    return np.take_along_axis(x, last, axis=0)


def _require_values(source: Source, channels: Channels):
    lead = source.place.lead or f"{source.name}: "
    if not len(source.x):
        raise DataError(
            f"{lead}channel {channels.names[0]} is empty, as are all others (0 rows). "
            "Leave the record out."
        )
    empty = np.flatnonzero(~np.isfinite(source.x).any(axis=0))
    if empty.size:
        names = ", ".join(channels.names[j] for j in empty)
        raise DataError(
            f"{lead}{names} has no valid sample at all ({len(source.x)} rows of NaN, "
            "inf or nothing). Leave out the channel or the record.",
            channel=channels.names[int(empty[0])],
        )


def _require_moderate(sources, channels):
    """Refuse magnitudes whose squares overflow or vanish in the data's type."""
    tops = [_largest(s.x) for s in sources]
    limit = _LARGEST_VALUE[str(sources[0].x.dtype)]
    for j, name in enumerate(channels.names):
        top = max(t[j] for t in tops)
        if top > limit or 0 < top < 1 / limit:
            raise DataError(
                f"{name} has values up to {top:.3g} in magnitude, whose squares "
                f"{'overflow' if top > 1 else 'underflow'}. Give the channel in "
                "another unit, so that its values are nearer to 1.",
                channel=name,
            )


def _largest(x):
    """Largest finite magnitude of every column."""
    finite = np.isfinite(x)
    return np.maximum(
        np.max(x, axis=0, where=finite, initial=0),
        -np.min(x, axis=0, where=finite, initial=0),
    )


def _require_finite(sources, channels, sample_time):
    dirty = [s for s in sources if not np.isfinite(s.x).all()]
    if not dirty:
        return
    x, place = dirty[0].x, dirty[0].place
    counts = (~np.isfinite(x)).sum(axis=0)
    j = int(np.argmax(counts > 0))
    row = int(np.argmax(~np.isfinite(x[:, j])))
    others = [
        f"{channels.names[k]} ({counts[k]})" for k in np.flatnonzero(counts) if k != j
    ]
    several = place.lead or (f"{dirty[0].name}: " if len(sources) > 1 else "")
    also = f" Also missing: {', '.join(others)}." if others else ""
    more = f" {len(dirty) - 1} more record(s) have gaps." if dirty[1:] else ""
    time = row * sample_time
    raise DataError(
        f"{several}{channels.names[j]} has {_kinds(x[:, j])}, first at "
        f"{place.row(row)} (t = {time:.6g} s).{also}{more} "
        "Use missing='mask', 'split' or 'interpolate'.",
        channel=channels.names[j],
        row=row,
        time=time,
    )


def _kinds(x):
    """Counts of NaN and inf, `"37 NaN and 1 inf"`."""
    counts = {"NaN": int(np.isnan(x).sum()), "inf": int(np.isinf(x).sum())}
    return " and ".join(f"{n} {kind}" for kind, n in counts.items() if n)
