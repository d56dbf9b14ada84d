"""Check of single samples and channels: constant, copied, stuck, outlying, missing."""

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float, Int, Shaped

from jaxnarx.data.dataset import Dataset
from jaxnarx.data.findings import Finding
from jaxnarx.data.record import Record
from jaxnarx.data.scaling import scaling_unit

_SHOWN_ROWS = 20
_MIN_RUN = 20
"""Shortest run of equal values, in samples, that is called stuck."""

_BLOCK_ROWS = 1 << 15
"""Rows looked at together: few enough for the processor's cache."""


def blocks(record: Record) -> Iterator[tuple[int, Float[np.ndarray, "rows signals"]]]:
    """Every `_BLOCK_ROWS` rows of all signals, with the number of the first."""
    for first in range(0, len(record), _BLOCK_ROWS):
        rows = slice(first, first + _BLOCK_ROWS)
        yield first, np.concatenate([record.u[rows], record.y[rows]], axis=1)


def _limits(data: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest value of every signal in every record."""

    def each(of) -> np.ndarray:
        return np.stack([np.concatenate([of(r.u), of(r.y)]) for r in data])

    return each(lambda x: x.min(axis=0)), each(lambda x: x.max(axis=0))


def seconds(
    rows: Sequence[tuple[int, int]], record: Record, sample_time: float
) -> tuple[tuple[float, float], ...]:
    """Times [s] from the record's beginning of spans of rows as its source counts."""
    return tuple(
        (
            round((a - record.start_row) * sample_time, 9),
            round((b - record.start_row) * sample_time, 9),
        )
        for a, b in rows
    )


def spans(
    record: Record, pairs: Int[np.ndarray, "spans 2"]
) -> tuple[tuple[int, int], ...]:
    """The first 20 of (first, stop) data rows as (first, last) rows of the source."""
    row = record.start_row
    return tuple((int(a) + row, int(b) - 1 + row) for a, b in pairs[:_SHOWN_ROWS])


def constant(data: Dataset) -> Iterator[Finding]:
    """Channels that never change, in all records or within each (inputs, outputs), or
    in one (outputs)."""
    channels = data.channels
    low, high = _limits(data)
    for j, name in enumerate(channels.names):
        output = j >= len(channels.inputs)
        seen = [i for i, r in enumerate(data) if r.valid[:, j].any()]
        if not seen:
            yield Finding(
                "error",
                "gaps",
                f"{name} has no valid sample: all of it is masked. Leave it out, or "
                "mask less.",
                channel=name,
            )
        elif low[seen, j].min() == high[seen, j].max():
            yield Finding(
                "error" if output else "warning",
                "constant",
                f"{'output' if output else 'input'} {name} is constant at "
                f"{low[seen[0], j]:.6g} in all records. "
                + (
                    "Nothing can be identified from it: leave it out."
                    if output
                    else "Its terms are passed over: leave it out or excite it."
                ),
                channel=name,
            )
        elif np.array_equal(low[seen, j], high[seen, j]):
            yield _levels_only(name, low[seen, j], output)
        elif output:
            for i in (i for i in seen if low[i, j] == high[i, j]):
                record = data.records[i]
                yield Finding(
                    "note",
                    "constant",
                    f"output {name} is constant at {low[i, j]:.6g} in {record.name}. "
                    "Its NRMSE and fit there are inf unless the error is zero.",
                    channel=name,
                    record=record.name,
                )


def _levels_only(name: str, levels: Float[np.ndarray, " records"], output: bool):
    own = np.unique(levels)
    return Finding(
        "note",
        "constant",
        f"{'output' if output else 'input'} {name} is constant within each record, at "
        f"{len(own)} levels from {own[0]:.6g} to {own[-1]:.6g}. Only its static effect "
        "can be told, and only as finely as these levels lie: no dead time, no memory.",
        channel=name,
    )


def precision(data: Dataset) -> Iterator[Finding]:
    """A note where everything will be computed with seven digits."""
    if data.records[0].u.dtype == np.float32:
        yield Finding(
            "note",
            "precision",
            "the data are float32, so everything runs in float32: seven digits, of "
            "which a long free run loses some. Convert the files or arrays to float64 "
            "to run in it.",
        )


def duplicates(data: Dataset) -> Iterator[Finding]:
    """Pairs of channels that are equal, or equal up to scale and offset."""
    unit = scaling_unit(*(limit.T for limit in _limits(data)))
    mean, gram = _moments(data, unit)
    size = np.sqrt(np.diag(gram))
    safe = np.where(size > 0, size, 1)
    close = np.abs(gram / safe[:, None] / safe[None]) > 1 - 1e-9
    names = data.channels.names
    for i, j in itertools.combinations(range(len(names)), 2):
        if not (close[i, j] and size[i] > 0 and size[j] > 0):
            continue
        gain = gram[i, j] / gram[i, i]
        offset = mean[j] - gain * mean[i]
        worst = max(_misfit(r.signals / unit, i, j, gain, offset) for r in data)
        if worst > 1e-4 * size[j] / np.sqrt(data.samples):
            continue
        equal = all(np.array_equal(r.signal(i), r.signal(j)) for r in data)
        how = "equals" if equal else f"is {gain * (unit[j] / unit[i]):.6g} times"
        use = f"Selection uses {names[i]} and passes {names[j]} over: leave one out."
        plus = (
            ""
            if equal or abs(offset) < 1e-9 * safe[j]
            else f" plus {offset * unit[j]:.6g}"
        )
        if plus:
            use = "Leave one out."
        yield Finding(
            "warning",
            "duplicate",
            f"{names[j]} {how} {names[i]}{plus}. {use}",
            channel=names[j],
        )


def _moments(data, unit):
    """Means of all signals in their units, and the products of what is left."""
    count = data.samples
    sums = [(x / unit).sum(axis=0) for r in data for _, x in blocks(r)]
    mean = np.sum(sums, axis=0) / count
    gram = np.zeros((len(data.channels.names),) * 2)
    for record in data:
        for _, x in blocks(record):
            x = x / unit - mean
            gram += x.T @ x
    return mean, gram


def _misfit(x, i, j, gain, offset):
    return float(np.abs(x[:, j] - gain * x[:, i] - offset).max())


def stuck(data: Dataset) -> Iterator[Finding]:
    """Long runs of equal values: at the channel's limits (saturated) or elsewhere.

    A run at a limit counts when it has 20 samples and five times the length that runs
    of this channel between its limits usually have (95 of 100), so channels that move
    in steps by design are not reported, and neither are those of two levels. A channel
    that is at one limit more than half of the time is noted, not warned of: it may be a
    switch. Elsewhere only outputs count, as inputs may rest, and only runs that are
    also a tenth of their record.
    """
    limits = _limits(data)
    low, high = limits[0].min(axis=0), limits[1].max(axis=0)
    for j, channel in enumerate(data.channels.all):
        runs = [_runs(r.signal(j)) for r in data]
        values = [r.signal(j)[p[:, 0]] for r, p in zip(data, runs, strict=True)]
        lengths = np.concatenate([p[:, 1] - p[:, 0] for p in runs])
        value = np.concatenate(values)
        between = (value != low[j]) & (value != high[j])
        if not between.any():
            continue
        shortest = max(_MIN_RUN, 5 * float(np.percentile(lengths[between], 95)))
        places = [(low[j], "minimum"), (high[j], "maximum"), (None, "")]
        is_input = j < len(data.channels.inputs)
        for limit, word in places[:2] if is_input else places:
            share = lengths[value == limit].sum() / lengths.sum() if word else 0.0
            for record, pairs, v in zip(data, runs, values, strict=True):
                at = (v == limit) if word else (v != low[j]) & (v != high[j])
                long = _length(pairs) >= (
                    shortest if word else max(shortest, len(record) / 10)
                )
                found = _measured_runs(record, j, pairs[at & long])
                if len(found):
                    yield _stuck_finding(data, record, channel.name, found, word, share)


def _length(pairs):
    return pairs[:, 1] - pairs[:, 0]


def _runs(x: Shaped[np.ndarray, " time"]) -> Int[np.ndarray, "runs 2"]:
    """(first, stop) of every maximal run of equal values."""
    firsts = np.flatnonzero(np.concatenate([[True], x[1:] != x[:-1]]))
    return np.stack([firsts, np.append(firsts[1:], len(x))], axis=1)


def _measured_runs(record, j, pairs):
    """The runs that were measured, rather than held over missing samples."""
    keep = [record.valid[a:b, j].mean() > 0.5 for a, b in pairs]
    return pairs[np.array(keep, bool)]


def _stuck_finding(data, record, name, pairs, word, share) -> Finding:
    rows = spans(record, pairs)
    times = seconds(rows, record, data.sample_time)
    listed = ", ".join(f"{a:.6g} to {b:.6g} s" for a, b in times[:5])
    kind = "saturated" if word else "stuck"
    at = f"stays at its {word}" if word else "does not move"
    often = f" It is there {100 * share:.0f} % of the time." if share > 0.5 else ""
    return Finding(
        "note" if share > 0.5 else "warning",
        kind,
        f"{name} {at} for {len(pairs)} long run(s) in {record.name}: {listed}"
        f"{', ...' if len(pairs) > 5 else ''}.{often} If the sensor was "
        f"{'at its limit' if word else 'frozen'}, mask these samples.",
        channel=name,
        record=record.name,
        rows=rows,
        times=times,
    )


def spikes(data: Dataset) -> Iterator[Finding]:
    """Single samples or pairs far from their neighbours (Hampel's identifier).

    A sample is listed when it differs from the median of the 15 samples around it by
    more than 10 times their scaled median absolute deviation, and by more than 5 % of
    the channel's range between its 0.5 and 99.5 percentiles. Nothing is removed.

    Hampel 1974; Pearson 2002, "Outliers in process modeling and identification".
    """
    names = data.channels.names
    spread = _spread(data)
    for record in data:
        if len(record) < 15:
            continue
        for j in range(len(names)):
            x = record.signal(j)
            far = _outlying_rows(x, 0.05 * spread[j])
            rows = _hampel(x, far[record.valid[far, j]], spread[j])
            if rows.size:
                pairs = np.stack([rows, rows + 1], axis=1)
                where = spans(record, pairs)
                times = seconds(where, record, data.sample_time)
                listed = ", ".join(f"{t[0]:.6g}" for t in times[:5])
                yield Finding(
                    "warning",
                    "spikes",
                    f"{names[j]} has {rows.size} outlying sample(s) in {record.name}, "
                    f"at t = {listed}{', ...' if rows.size > 5 else ''} s. They are "
                    "kept; if they are faults of the measurement, set them to NaN.",
                    channel=names[j],
                    record=record.name,
                    rows=where,
                    times=times,
                )


def _spread(data: Dataset) -> Float[np.ndarray, " signals"]:
    """Range of each channel between its 0.5 and 99.5 percentiles, from 20,000 rows."""
    step = max(1, data.samples // 20_000)
    x = np.concatenate([np.concatenate([r.u[::step], r.y[::step]], 1) for r in data])
    low, high = np.percentile(x, [0.5, 99.5], axis=0)
    return high - low


def _outlying_rows(
    x: Float[np.ndarray, " time"], limit: float
) -> Int[np.ndarray, " rows"]:
    """Rows that are further than `limit` from the running median of five."""
    p = np.concatenate([x[:2], x, x[-2:]])
    found = [
        first + np.flatnonzero(np.abs(part[2:-2] - _median5(part)) > limit)
        for first in range(0, len(x), _BLOCK_ROWS)
        for part in [p[first : first + _BLOCK_ROWS + 4]]
    ]
    return np.concatenate(found)


def _median5(p: Float[np.ndarray, " more"]) -> Float[np.ndarray, " time"]:
    """Running median of five by comparisons: far faster than sorting windows.

    Two samples at either end are there for their neighbours.
    """
    a, b, c, d, e = (p[k : len(p) - 4 + k] for k in range(5))
    low, high = np.minimum(a, b), np.maximum(a, b)
    low2, high2 = np.minimum(d, e), np.maximum(d, e)
    # the least and the greatest of four cannot be the median of five
    f, g = np.maximum(low, low2), np.minimum(high, high2)
    return np.maximum(np.minimum(f, g), np.minimum(np.maximum(f, g), c))


def _hampel(x, candidates, spread):
    """The candidate rows that are outlying within their own window."""
    centre = np.clip(candidates, 7, len(x) - 8)
    window = x[centre[:, None] + np.arange(-7, 8)[None]]
    middle = np.median(window, axis=1)
    scale = 1.4826 * np.median(np.abs(window - middle[:, None]), axis=1)
    off = np.abs(x[candidates] - middle)
    return candidates[(off > 10 * scale) & (off > 0.05 * spread)]


def gaps(data: Dataset) -> Iterator[Finding]:
    """Masked samples, counted per channel and record."""
    for record in data:
        for j in np.flatnonzero(~record.valid.all(axis=0)):
            bad = ~record.valid[:, j]
            pairs = _runs(bad)
            pairs = pairs[bad[pairs[:, 0]]]
            rows = spans(record, pairs)
            share = bad.mean()
            name = data.channels.names[j]
            yield Finding(
                "warning" if share > 0.1 else "note",
                "missing",
                f"{name} has {bad.sum()} missing sample(s) in {len(pairs)} gap(s) in "
                f"{record.name} ({100 * share:.2g} %). Rows that reach into a gap are "
                "not used.",
                channel=name,
                record=record.name,
                rows=rows,
                times=seconds(rows, record, data.sample_time),
            )


HUGE_OFFSET_DEVIATIONS = 1e3
"""Mean in standard deviations from which a channel is named: cubic terms then cancel to
1e-9 of themselves, quadratic ones to 1e-6."""


def offsets(data: Dataset) -> Iterator[Finding]:
    """Channels whose mean is huge beside what they move."""
    for j, name in enumerate(data.channels.names):
        x = np.concatenate([r.signal(j)[r.valid[:, j]] for r in data])
        if not x.size or x.min() == x.max():
            continue
        unit = scaling_unit(x)
        mean, spread = float((x / unit).mean() * unit), float((x / unit).std() * unit)
        if abs(mean) <= HUGE_OFFSET_DEVIATIONS * spread:
            continue
        ratio = abs(mean) / spread if spread > 0 else np.inf
        yield Finding(
            "warning",
            "offset",
            f"{name} moves by {spread:.3g} (standard deviation) around {mean:.6g}, "
            f"{ratio:.1e} times as much. Its products are taken into a model after "
            "their parts, and their sum loses digits: take the offset off, or measure "
            "the difference.",
            channel=name,
        )
