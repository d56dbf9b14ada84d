"""Remarks that a reader of the scores needs, in plain sentences."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from jaxnarx.data import (
    LEVEL_QUANTITIES,
    Channels,
    Dataset,
    dimension,
    fingerprint,
    other_units,
)
from jaxnarx.evaluation.rows import FREE_RUN, POOLED_NAME, Row, nrmse_within
from jaxnarx.evaluation.table import name_data, number
from jaxnarx.formatting import list_names
from jaxnarx.models import Network
from jaxnarx.refinement import stability
from jaxnarx.simulation import Prepared
from jaxnarx.solution import Solution

WITHIN_RECORDS_FACTOR = 3.0
"""Times the NRMSE from which that within records is told beside it."""
OFFSET_ERROR_SHARE = 0.5
"""Share of the free-run error from which its offsets are told."""


def data_notes(
    parts: Mapping[str, Dataset], channels: Channels, modelled: list[str]
) -> list[str]:
    """Findings that need no simulation; the loudest first.

    `channels` are those of the model, `modelled` the names of its outputs.
    """
    notes = _repeated_records(parts) + _other_units(parts)
    if len(parts) > 1 and "test" not in parts:
        notes.append(
            "No test data: the figures come from records that took part in choosing "
            "the model and may flatter it."
        )
    known = {c.name: c.unit for c in channels.all}
    unused = [name for name in channels.output_names if name not in modelled]
    if unused:
        notes.append(f"Outputs that are not modelled: {list_names(unused)}.")
    told: dict[str, list[str]] = {}
    for part, data in parts.items():
        notes += _masked_samples(part, data, list(known))
        extra = [name for name in data.channels.names if name not in known]
        if extra:
            notes.append(f"Extra channels in {part}, ignored: {list_names(extra)}.")
        notes += [
            f"Units differ: the model's {c.name} is in {known[c.name] or 'no unit'}, "
            f"the {name_data(part)}'s in {c.unit or 'no unit'}."
            for c in data.channels.all
            if known.get(c.name, c.unit) != c.unit
        ]
        for note in data.notes:
            told.setdefault(note, []).append(part)
    for note, found in told.items():
        notes.append(f"Of the {name_data(list_names(found))}: {note}.")
    return notes


def _other_units(parts: Mapping[str, Dataset]) -> list[str]:
    """Fault 59: records in another unit than those of all parts."""
    first, *others = parts.values()
    same = [first, *(d for d in others if d.channels.names == first.channels.names)]
    records = tuple(record for data in same for record in data)
    found = other_units(Dataset(records, first.channels, first.sample_time))
    return [f"{finding.message}" for finding in found]


def _masked_samples(part: str, data: Dataset, used: list[str]) -> list[str]:
    """Faults 1 and 18: samples that were missing, or removed as outliers."""
    counts = {
        name: sum(int((~r.valid[:, i]).sum()) for r in data)
        for i, name in enumerate(data.channels.names)
        if name in used
    }
    found = [
        f"{name} {n} ({100 * n / data.samples:.2g} %)"
        for name, n in counts.items()
        if n
    ]
    if not found:
        return []
    return [
        f"Masked in {part} (missing, or removed by a preparation), neither used nor "
        f"scored: {list_names(found)}."
    ]


def score_notes(rows: Iterable[Row]) -> list[str]:
    """Divergence, constant outputs and records without samples, from the scores."""
    rows = list(rows)
    notes = [_divergence(row, rows) for row in rows if _is_pooled_loss(row)]
    for row in rows:
        if row.record != POOLED_NAME and (
            row.mode == rows[-1].mode or row.status == "too short"
        ):
            notes += _edge(row)
    free = [row for row in rows if row.mode == FREE_RUN]
    return notes + _offsets(free) + _levels(free)


def _levels(rows: list[Row]) -> list[str]:
    """Parts whose records differ so much in level that the NRMSE hides the rest."""
    within = nrmse_within(rows)
    return [
        f"{row.output}, {row.part}, free run: NRMSE {row.nrmse:.2g} counts how much "
        f"records differ from each other; by the deviation within records it is "
        f"{within[row.output, row.part]:.2g}."
        for row in rows
        if row.record == POOLED_NAME
        and row.nrmse
        and within.get((row.output, row.part), 0.0) >= WITHIN_RECORDS_FACTOR * row.nrmse
    ]


def _offsets(rows: list[Row]) -> list[str]:
    """Parts whose free-run error is mostly an offset of each record.

    A right model leaves none; slow memory that it lacks, or a sensor that drifts, do.
    """
    total: dict[tuple[str, str], float] = {}
    constant: dict[tuple[str, str], float] = {}
    largest: dict[str, float] = {}
    for row in rows:
        largest[row.output] = max(largest.get(row.output, 0.0), row.rmse or 0.0)
    for row in rows:
        if row.record == POOLED_NAME or row.offset is None or row.rmse is None:
            continue
        key, size = (row.output, row.part), largest[row.output] or 1.0
        total[key] = total.get(key, 0.0) + row.samples * (row.rmse / size) ** 2
        constant[key] = constant.get(key, 0.0) + row.samples * (row.offset / size) ** 2
    return [
        f"{output}, {part}, free run: {constant[key] / value:.0%} of the error's mean "
        "square is an offset of each record: look for slow memory that the model "
        "lacks, or a sensor that drifts."
        for key, value in total.items()
        for output, part in [key]
        if 0 < value < np.inf and constant[key] >= OFFSET_ERROR_SHARE * value
    ]


def _repeated_records(parts: Mapping[str, Dataset]) -> list[str]:
    """Fault 23: data that was learned from proves nothing."""
    seen = {
        part: {fingerprint(r, data.channels.names): r.name for r in data}
        for part, data in parts.items()
    }
    notes = []
    for first, second in _pairs(list(parts)):
        both = [name for key, name in seen[second].items() if key in seen[first]]
        if not both:
            continue
        loud = (
            "VALIDATION DATA EQUALS ESTIMATION DATA"
            if first == "train"
            else "REPEATED DATA"
        )
        notes.append(
            f"{loud}: {len(both)} of {len(parts[second])} {second} records "
            f"({list_names(both)}) are also in {first}; the {second} figures do not "
            "show how the model does on new data."
        )
    return notes


def _pairs(names: list[str]) -> list[tuple[str, str]]:
    """Every pair, the part that was learned from first."""
    order = sorted(names, key=lambda n: (n != "train", n == "test"))
    return [(a, b) for i, a in enumerate(order) for b in order[i + 1 :]]


def _is_pooled_loss(row: Row) -> bool:
    return row.diverged and row.record == POOLED_NAME


def _divergence(row: Row, rows: list[Row]) -> str:
    lost = [
        r.record
        for r in rows
        if (r.part, r.output, r.mode) == (row.part, row.output, row.mode)
        and r.diverged
        and r.record != POOLED_NAME
    ]
    note = f"{row.output}, {row.part}, {row.mode}: {row.status}, records "
    note += f"{list_names(lost)}."
    if row.others is None:
        return note
    others: dict[str, Any] = row.others
    return note + (
        f" The others alone: RMSE {number(others['rmse'])}, NRMSE "
        f"{number(others['nrmse'])}, R2 {number(others['r2'])}, fit "
        f"{number(others['fit'], '.1f')} %, NMSE {number(others['nmse'])}."
    )


def _edge(row: Row) -> list[str]:
    where = f"{row.part} record {row.record}"
    if row.status == "constant output":
        return [
            f"{row.output} is constant in {where}: NRMSE, R2, fit and NMSE have "
            "nothing to compare with and are infinite unless the error is zero."
        ]
    if row.status == "too short":
        return [
            f"{where} is too short for {row.output}, {row.mode}: no sample has a "
            "complete valid history to be predicted from."
        ]
    if row.status == "no samples":
        return [f"{row.output} has no valid sample to score in {where}."]
    return []


EXAMINED_SAMPLES = 2000
"""Samples a report looks at, evenly spaced: it should not take longer than the runs."""


def assess(network: Any, data: Dataset | Prepared, free: Any) -> Any:
    """The `Stability` of a network on `data`; None for what is no `Network`.

    `free` is the free run at hand: what `simulate` returned, else it is run again.
    """
    if not isinstance(network, Network):
        return None
    simulated = free if isinstance(free, Solution) else None
    return stability(network, data, samples=EXAMINED_SAMPLES, simulated=simulated).value


def stability_notes(value: Any, part: str) -> list[str]:
    """Whether and how fast the model forgets its past, or where it does not."""
    return [] if value is None else [f"Stability on {part}: {value.summary}"]


def stability_values(value: Any) -> dict[str, Any] | None:
    """Poles, bounds and the verdict as plain values."""
    if value is None:
        return None
    return {
        "contracts": value.contracts,
        "certified": value.certificate is not None,
        "bounded": value.bounded,
        "time_constant": value.time_constant,
        "summary": value.summary,
        "poles": value.poles,
        "bounds": value.bounds,
    }


LISTED_GAINS = 3
"""Gains that change sign or jump that are told one by one."""
LISTED_TOTALS = 4
"""Outputs whose cycle totals are told."""


def verdict_remarks(report: Any) -> Iterator[str]:
    """Remarks of a report that change no verdict."""
    yield from _wide_intervals(report)
    yield from _gains(report)
    yield from _totals(report)


def _wide_intervals(report: Any) -> Iterator[str]:
    """Prediction intervals that are too wide to be of use."""
    for one in report.coverage:
        # Of training data they hold more: errors are smaller there.
        if one.part == report.main != "train" and one.is_wide:
            unit = f" {one.unit}" if one.unit not in ("", "-", "1") else ""
            yield (
                f"the {one.level:.0%} intervals of {one.output} hold {one.held:.1%} of "
                f"the {one.part} samples and are too wide to be of use: ± "
                f"{number(one.half, '.3g')}{unit}, RMSE {number(one.rmse, '.3g')}{unit}"
                "; a group of the training records that was served badly widens them"
            )


def _gains(report: Any) -> Iterator[str]:
    """Gains that change sign or jump, the commonest first."""
    found = sorted(report.gains, key=lambda one: -one.share)
    yield from map(str, found[:LISTED_GAINS])
    if len(found) > LISTED_GAINS:
        yield f"{len(found) - LISTED_GAINS} more gains change sign or jump"


def _totals(report: Any) -> Iterator[str]:
    """Cycle totals of the main part: the mean over records and their range.

    Neither a network nor a leaderboard knows the totals of groups that were held out,
    so this is no prediction interval.
    """
    found: dict[str, list[float | None]] = {}
    for row in report.rows:
        if (
            (row.part, row.mode)
            == (
                report.main,
                FREE_RUN,
            )
            and row.record != POOLED_NAME
            and dimension(row.unit) not in LEVEL_QUANTITIES
        ):
            found.setdefault(row.output, []).append(row.total_error)
    known = {k: [e for e in errors if e is not None] for k, errors in found.items()}
    worst = sorted(filter(known.get, known), key=lambda k: -max(map(abs, known[k])))
    if report.main == "train" or not worst:
        return
    told = [_total(k, known[k], len(found[k])) for k in worst[:LISTED_TOTALS]]
    told += (
        [f"{len(worst) - LISTED_TOTALS} more outputs"]
        if len(worst) > LISTED_TOTALS
        else []
    )
    yield (
        f"sums over a record of {name_data(report.main)}, simulated minus measured: "
        f"{'; '.join(told)} (seen on these records, no prediction interval)"
    )


def _total(output: str, errors: list[float], records: int) -> str:
    """The errors of an output's sums in the mean and their range, in percent."""
    mean = number(float(np.mean(errors)), "+.3g")
    of = f"{len(errors)} of {records}" if len(errors) < records else f"{records}"
    if len(errors) == 1:
        return f"{output} {mean} % in {of} record{'s' * (records > 1)}"
    low, high = number(min(errors), "+.3g"), number(max(errors), "+.3g")
    return f"{output} {mean} % in the mean, {low} to {high} % over {of} records"
