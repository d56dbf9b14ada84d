"""The verdict of a report: good, usable with limits, or not usable, and why.

All of it rests on the free run, output by output. **Not usable** is a model that

- leaves its bounds in any record (diverges), or
- is no better than the mean of the measurement on records that were not trained on
  (NRMSE of 1 or more, `WORTHLESS_NRMSE`), or
- has nothing to be judged by: no valid sample on the main part, or
- comes from a search in which it diverged on the records left out, or was no better
  there than the mean by a standard error.

**Usable with limits** is one that does not, but

- leaves more than a tenth of the variance of an output unexplained on any part (NRMSE
  above 0.32, `ACCURATE_NRMSE`), or is more than twice (`OVERFIT_FACTOR`) as bad as on
  its training data;
- is far off in single records: RMSE of 3 times (`FAR_RECORD_FACTOR`) the median
  record's, and above 0.32 (`ACCURATE_NRMSE`) of the output's spread;
- has a worse free run than a linear model of the same lags, by more than 2 %;
- was held by its feedback bound at 1 % (`NOTICEABLE_OUTSIDE_SHARE`) of the samples;
- may not forget its past: no contraction at 10 % (`UNSURE_SAMPLE_SHARE`) of the
  samples, or a local model that is unstable by itself at most samples where it leads;
- was judged on data it was made with or on a constant output, or met inputs 10 %
  (`OUTSIDE_WIDTH_SHARE`) of their trained width outside and left its range at 5 %
  (`OUTSIDE_SAMPLE_SHARE`) of the samples;
- comes from a search, and is 1.5 times (`HELD_OUT_FACTOR`) as bad on test data as on
  the records held out there, or no better than the mean in one group of them;
- has prediction intervals that hold less than they claim, beyond chance over records.

Else it is **good**. A finding that changes no verdict, but that a user should look at,
is a **remark**: prediction intervals that hold more than they claim and are about three
times as wide as the error; steady-state gains that change sign over the data, or jump;
the errors of cycle totals. Tests of residuals take no part: with many samples they find
fault with any model, see `Diagnostics`.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np

from jaxnarx.data import Channel
from jaxnarx.evaluation._region_errors import RegionError
from jaxnarx.evaluation.baseline import BASELINE_NAME
from jaxnarx.evaluation.coverage import IntervalCoverage
from jaxnarx.evaluation.extrapolation import NOTICEABLE_OUTSIDE_SHARE, Outside
from jaxnarx.evaluation.gain_signs import GainFinding
from jaxnarx.evaluation.remarks import verdict_remarks
from jaxnarx.evaluation.rows import FREE_RUN, POOLED_NAME, Row, nrmse_within
from jaxnarx.evaluation.table import number
from jaxnarx.evaluation.verdict import (
    AT_LEAST,
    AT_MOST,
    BELOW,
    GOOD,
    LIMITED,
    UNUSABLE,
    Verdict,
    VerdictRule,
)

WORTHLESS_NRMSE, ACCURATE_NRMSE = 1.0, 0.1**0.5
"""NRMSE of the mean, and the one that leaves a tenth of the variance."""
OVERFIT_FACTOR, SMALL_NRMSE = 2.0, 0.1
"""Factor over the training NRMSE, and the NRMSE up to which it does not matter."""
FAR_RECORD_FACTOR = 3.0
"""Factor over the median record's RMSE from which a record is far off."""
BETTER_ERROR_SHARE = 0.98
"""Share of the error below which another model counts as better."""
UNSURE_SAMPLE_SHARE = 0.1
"""Share of the samples without contraction that limits the use of a model."""
OUTSIDE_WIDTH_SHARE, OUTSIDE_SAMPLE_SHARE = 0.1, 0.05
"""Distance of an input beyond its trained range, in that of its width, and share of the
samples outside, that limit the use of a model together."""
UNSTABLE_SAMPLE_SHARE = 0.5
"""Share of the samples that a local model leads from which it counts as unstable."""
HELD_OUT_FACTOR = 1.5
"""Factor over the NRMSE of records left out."""


@runtime_checkable
class Scored(Protocol):
    """The figures that a verdict rests on; a `Report` has them, and tells what these
    are."""

    @property
    def outputs(self) -> tuple[Channel, ...]: ...
    @property
    def main(self) -> str: ...
    @property
    def rows(self) -> tuple[Row, ...]: ...
    @property
    def notes(self) -> tuple[str, ...]: ...
    @property
    def stability(self) -> Any: ...
    @property
    def outside(self) -> tuple[Outside, ...]: ...
    @property
    def beside(self) -> Mapping[str, tuple[Row, ...]]: ...
    @property
    def regions(self) -> tuple[RegionError, ...]: ...
    @property
    def coverage(self) -> tuple[IntervalCoverage, ...]: ...
    @property
    def gains(self) -> tuple[GainFinding, ...]: ...
    @property
    def leaderboard(self) -> Mapping[str, Any] | None: ...
    def pooled_row(self, output: str) -> Row: ...


def judge(report: Scored) -> Verdict:
    """The verdict by the rules above."""
    rows = [r for r in report.rows if r.mode == FREE_RUN]
    rules = [*_runs(report, rows), *_errors(report, rows), *_records(rows)]
    rules += [*_compare_with_linear(report), *_memory(report), *_data(report, rows)]
    rules += [*_held_out_rules(report, rows), *_intervals(report)]
    findings = [rule.reason for rule in rules if rule.reason is not None]
    findings.sort(key=lambda f: f.level != UNUSABLE)
    return Verdict(
        level=findings[0].level if findings else GOOD,
        findings=tuple(findings),
        praise=_praise(report),
        remarks=tuple(verdict_remarks(report)),
        searched=bool(report.leaderboard),
        rules=tuple(rules),
    )


def _praise(report: Scored) -> str:
    shares = [report.pooled_row(c.name).r2 for c in report.outputs]
    least = min((s for s in shares if s is not None), default=0.0)
    names = ", ".join(c.name for c in report.outputs)
    every = "at least " if len(shares) > 1 else ""
    return (
        f"the free run on {report.main} explains {every}{100 * least:.3g} % of the "
        f"variance of {names} and stays within its bounds"
    )


def _pooled_rows(rows: Iterable[Row]) -> list[Row]:
    return [r for r in rows if r.record == POOLED_NAME]


def _main_first(report: Scored, rows: list[Row]) -> list[Row]:
    """Pooled rows, those of the main part first."""
    return sorted(_pooled_rows(rows), key=lambda r: r.part != report.main)


def _runs(report: Scored, rows: list[Row]) -> Iterator[VerdictRule]:
    """Divergence, nothing to judge, limits that act."""
    for row in _main_first(report, rows):
        share, where = row.share_outside, f"{row.output} on {row.part}"
        yield _bound_rule(row, rows)
        if row.diverged:
            continue
        if row.part == report.main:
            yield (rule := _judgeable(row))
            if not rule.passed:
                continue
        held = row.limited / max(row.samples, 1)
        text = f"the feedback bound holds {where} at {held:.0%} of the samples"
        helps = "cover" if share >= OUTSIDE_SAMPLE_SHARE else "bounded"
        rule = VerdictRule(
            "feedback bound",
            row.output,
            row.part,
            held,
            BELOW,
            NOTICEABLE_OUTSIDE_SHARE,
        )
        yield rule.explain(LIMITED, text, helps)


def _judgeable(row: Row) -> VerdictRule:
    """Whether the main part has samples of an output that moves."""
    where, constant = f"{row.output} on {row.part}", row.status == "constant output"
    samples = float(0 if constant else row.samples)
    rule = VerdictRule(
        "samples to judge by", row.output, row.part, samples, AT_LEAST, 1.0
    )
    if constant:
        text = f"{where} is constant: no judgement of it"
        return rule.explain(LIMITED, text, "test")
    if not rule.passed:
        text = f"{where} has no valid sample to score"
        return rule.explain(UNUSABLE, text, "records")
    return rule


def _bound_rule(row: Row, rows: list[Row]) -> VerdictRule:
    """Whether the free run of a part stays within its bounds in all records."""
    lost = [
        r
        for r in rows
        if (r.part, r.output) == (row.part, row.output)
        and r.diverged
        and r.record != POOLED_NAME
    ]
    share = max((r.share_outside for r in lost), default=0.0)
    names = ", ".join(r.record for r in lost[:3]) or "all records"
    names += f" and {len(lost) - 3} more" if len(lost) > 3 else ""
    strayed = share >= OUTSIDE_SAMPLE_SHARE
    text = f"the free run of {row.output} on {row.part} diverges in {names}"
    if strayed:
        text += f", {share:.0%} of it outside the trained range"
    found = float(max(len(lost), 1) if row.diverged else 0)
    rule = VerdictRule("diverged records", row.output, row.part, found, AT_MOST, 0.0)
    return rule.explain(UNUSABLE, text, "cover" if strayed else "bounded")


def _errors(report: Scored, rows: list[Row]) -> Iterator[VerdictRule]:
    """Errors of whole parts, by themselves and beside that of training."""
    trained = {r.output: r.nrmse for r in _pooled_rows(rows) if r.part == "train"}
    within = nrmse_within(rows)
    for row in _main_first(report, rows):
        place, learned = (row.output, row.part), row.part == "train"
        where = f"{row.output} on {row.part}"
        error = row.nrmse if row.status == "ok" else None
        worthless = not learned and error is not None and error >= WORTHLESS_NRMSE
        if not learned:
            text = f"the free run of {where} is no better than the mean"
            rule = VerdictRule(
                "better than the mean", *place, error, BELOW, WORTHLESS_NRMSE
            )
            yield rule.explain(UNUSABLE, f"{text} ({_nrmse(error)})", "richer")
        rule = VerdictRule("accuracy", *place, error, AT_MOST, ACCURATE_NRMSE)
        text = _unexplained_share(where, error)
        yield rule if worthless else rule.explain(LIMITED, text, "richer")
        if learned:
            continue
        inside = None if error is None else within.get(place)
        text = f"within a record the free run of {where} is no better than its mean"
        rule = VerdictRule(
            "better than the mean in records", *place, inside, BELOW, WORTHLESS_NRMSE
        )
        text += f" ({_nrmse(inside)})"
        yield rule if worthless else rule.explain(LIMITED, text, "richer")
        own = trained.get(row.output)
        if own is None:
            continue
        times = error / own if error is not None and own else np.inf
        text = f"the error of {where} is {times:.2g} times that of training"
        most = max(SMALL_NRMSE, OVERFIT_FACTOR * own)
        rule = VerdictRule("overfitting", *place, error, AT_MOST, most)
        yield rule.explain(LIMITED, text, "simpler")


def _unexplained_share(where: str, nrmse: float | None) -> str:
    """The share of the variance that the free run leaves; above one no share is
    told."""
    text = f"the free run of {where} is worse than the mean"
    if nrmse is not None and nrmse < WORTHLESS_NRMSE:
        text = f"the free run leaves {nrmse**2:.0%} of the variance of {where}"
    return f"{text} ({_nrmse(nrmse)})"


def _nrmse(value: float | None) -> str:
    return f"NRMSE {number(value, '.3g')}"


def _records(rows: list[Row]) -> Iterator[VerdictRule]:
    """Single records that are far off, whatever their part."""
    for output in dict.fromkeys(r.output for r in rows):
        own = [r for r in rows if r.output == output]
        spread = {
            r.part: r.rmse / r.nrmse
            for r in _pooled_rows(own)
            if r.rmse is not None and r.nrmse
        }
        single = [
            (r.rmse, r)
            for r in own
            if r.record != POOLED_NAME and r.rmse is not None and r.samples
        ]
        if len(single) < 3:
            continue
        usual = float(np.median([error for error, _ in single]))
        parts = {r.part for r in own}
        most = {
            p: max(FAR_RECORD_FACTOR * usual, ACCURATE_NRMSE * spread.get(p, np.inf))
            for p in parts
        }
        far = [(error, r) for error, r in single if error > most[r.part]]
        error, row = max(far or single, key=lambda pair: pair[0])
        unit = f" {row.unit}" if row.unit not in ("", "-", "1") else ""
        text = f"{output} is off in {row.part} record {row.record}: RMSE "
        text += f"{number(error, '.3g')}{unit}, median record {number(usual, '.3g')}"
        if row.offset is not None:
            text += f", mean of measured minus simulated {row.offset:+.3g}{unit}"
        if len(far) > 1:
            text += f"; {len(far) - 1} more such"
        rule = VerdictRule(
            "worst record, RMSE", output, "", error, AT_MOST, most[row.part]
        )
        yield rule.explain(LIMITED, text, "records")


def _compare_with_linear(report: Scored) -> Iterator[VerdictRule]:
    """A linear model that does better."""
    for row in report.beside.get(BASELINE_NAME, ()):
        if row.nrmse is None:
            continue
        own, name = report.pooled_row(row.output).nrmse, "beside a linear model"
        text = f"a linear model of the same lags does better on {row.output}"
        text += f" ({_nrmse(row.nrmse)}, this one {number(own, '.3g')})"
        rule = VerdictRule(
            name, row.output, report.main, own, AT_MOST, row.nrmse / BETTER_ERROR_SHARE
        )
        yield rule.explain(LIMITED, text, "linear")


def _memory(report: Scored) -> Iterator[VerdictRule]:
    """Poles and the contraction bound."""
    found = report.stability
    if found is None:
        return
    for row in found.poles:
        if row.model is None or not row.samples:
            continue
        text = f"local model {row.model} of {row.output} alone is unstable where it"
        text += f" leads ({_region(report, row)}pole {row.median:.4g})"
        where, share = f"local model {row.model}", float(row.unstable)
        rule = VerdictRule(
            "share unstable", row.output, where, share, AT_MOST, UNSTABLE_SAMPLE_SHARE
        )
        yield rule.explain(LIMITED, text, "unstable")
    share = 0.0 if found.contracts else float(found.bound.fails)
    text = f"nothing shows that it forgets its past at {share:.0%} of the samples"
    rule = VerdictRule(
        "share without contraction", "", report.main, share, BELOW, UNSURE_SAMPLE_SHARE
    )
    yield rule.explain(LIMITED, text, "unstable")


def _region(report: Scored, row: Any) -> str:
    """The region in which a local model leads, if that is known."""
    for one in report.regions:
        if (one.output, one.model) == (row.output, row.model) and one.region:
            return f"{one.region}; "
    return ""


def _data(report: Scored, rows: list[Row]) -> Iterator[VerdictRule]:
    """The data that the figures were measured on."""
    repeated = float(sum("EQUALS ESTIMATION" in note for note in report.notes))
    text = "it was judged on records that it was trained on"
    rule = VerdictRule(
        "parts that repeat training data", "", "", repeated, AT_MOST, 0.0
    )
    yield rule.explain(LIMITED, text, "test")
    apart = float(report.main not in ("train", "validate"))
    text = f"there are no test data: {report.main} took part in making it"
    text += _held_out_error(report)
    rule = VerdictRule("independent parts", "", report.main, apart, AT_LEAST, 1.0)
    yield rule if repeated else rule.explain(LIMITED, text, "test")
    main = [r for r in _pooled_rows(rows) if r.part == report.main]
    share = max((r.share_outside for r in main), default=0.0)
    far = [
        o
        for o in report.outside
        if o.part == report.main and o.beyond >= OUTSIDE_WIDTH_SHARE
    ]
    text = f"{share:.0%} of the {report.main} samples lie outside the trained range"
    text += f" ({far[0]})" if far else ""
    share = share if far else 0.0
    rule = VerdictRule(
        "share beyond trained range",
        "",
        report.main,
        share,
        BELOW,
        OUTSIDE_SAMPLE_SHARE,
    )
    yield rule.explain(LIMITED, text, "cover")


def _intervals(report: Scored) -> Iterator[VerdictRule]:
    """Prediction intervals that hold less than they claim."""
    for one in report.coverage:
        if one.part == report.main:
            text = f"the {one.level:.0%} intervals of {one.output} hold {one.held:.1%} "
            text += f"of the {one.part} samples: they are too narrow"
            name = f"share in {one.level:.0%} intervals"
            rule = VerdictRule(
                name, one.output, one.part, one.held, AT_LEAST, one.least
            )
            yield rule.explain(LIMITED, text, "intervals")


def _rows_in_use(report: Scored) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """The row of the leaderboard that the model of each output is."""
    for output, entry in (report.leaderboard or {}).items():
        for row in entry["rows"]:
            if row["used"]:
                yield output, row


def _promised(row: Mapping[str, Any]) -> float | None:
    """The error on records left out: by nested cross-validation, where it is known."""
    return row.get("promised", row["free_run"])


def _held_out_error(report: Scored) -> str:
    """The error on records left out, where there are no test data."""
    told = [
        f"{output} {_promised(row):.3g}"
        for output, row in _rows_in_use(report)
        if _promised(row) is not None
    ]
    return f"; NRMSE on records left out: {', '.join(told)}" if told else ""


def _held_out_rules(report: Scored, rows: list[Row]) -> Iterator[VerdictRule]:
    """The free run over records that the search left out."""
    tested = {r.output: r.nrmse for r in _pooled_rows(rows) if r.part == "test"}
    for output, row in _rows_in_use(report):
        error, worst = _promised(row), row["worst_group_error"]
        place = output, "held out"
        where = f"the free run of {output} on records left out of training"
        lost = 0 if error is not None else max(row["diverged"], 1)
        text = f"{where} diverges in {lost} of them"
        rule = VerdictRule("diverged records", *place, float(lost), AT_MOST, 0.0)
        yield rule.explain(UNUSABLE, text, "bounded")
        if error is None:
            continue
        test, spread = tested.get(output), row["standard_error"] or 0.0
        more = f" ± {spread:.2g}" if spread else ""
        text = f"{where} is no better than the mean"
        mean = VerdictRule(
            "better than the mean", *place, error + spread, BELOW, WORTHLESS_NRMSE
        )
        yield mean.explain(UNUSABLE, f"{text} ({_nrmse(error)}{more})", "richer")
        group = VerdictRule("worst group", *place, worst, BELOW, WORTHLESS_NRMSE)
        text = f"{text} in {row['worst_group']} ({_nrmse(worst)})"
        yield group.explain(LIMITED, text, "records") if mean.passed else group
        if test is None:
            rule = VerdictRule("accuracy", *place, error, AT_MOST, ACCURATE_NRMSE)
            text = f"{where} leaves {error**2:.0%} of the variance ({_nrmse(error)})"
            told = not mean.passed or group.passed is False
            yield rule if told else rule.explain(LIMITED, text, "richer")
        elif error:
            most = max(SMALL_NRMSE, HELD_OUT_FACTOR * error)
            text = f"the error of {output} on test is {test / error:.2g} times that on "
            text += "records left out of training"
            rule = VerdictRule("beside held out", output, "test", test, AT_MOST, most)
            yield rule.explain(LIMITED, text, "cover")
