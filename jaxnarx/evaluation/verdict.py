"""The verdict of a report: good, usable with limits, or not usable, and why.

All of it rests on the free run, output by output. **Not usable** is a model that

- leaves its bounds in any record (diverges), or
- is no better than the mean of the measurement on records that were not trained on
  (NRMSE of `WORTHLESS` or more), or
- has nothing to be judged by: no valid sample on the main part, or
- comes from a search in which it diverged on the records left out, or was no better
  there than the mean by a standard error.

**Usable with limits** is one that does not, but

- leaves more than a tenth of the variance of an output unexplained on any part (NRMSE
  above `ACCURATE`), or is more than `OVERFITTED` times worse than on its training data;
- is far off in single records: RMSE of `FAR` times the median record's, and above
  `ACCURATE` of the output's spread;
- has a worse free run than a linear model of the same lags, by more than 2 %;
- was held by its feedback bound at `NOTICEABLE` of the samples;
- forgets its past nowhere surely: no contraction at `UNSURE` of the samples, or a local
  model that is unstable by itself at most samples where it leads;
- was judged on data it was made with or on a constant output, or met inputs `REACH` of
  their trained width outside and left its range at `STRAYED` of the samples;
- comes from a search, and is `PROMISED` times worse on test data than on the records
  that were left out there, or no better than the mean in one group of them;
- has prediction intervals that hold less than they claim, beyond chance over records.

Else it is **good**. What a user should look at and what changes no verdict is a
**remark**: prediction intervals that hold more than they claim and are about three
times as wide as the error; steady-state gains that change sign over the data, or jump.
Tests of residuals take no part: with many samples they
find fault with any model, see `Diagnostics`.
"""

import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np

from jaxnarx.data import Channel
from jaxnarx.evaluation._region_errors import RegionError
from jaxnarx.evaluation.baseline import NAME
from jaxnarx.evaluation.coverage import IntervalCoverage
from jaxnarx.evaluation.extrapolation import NOTICEABLE, Outside
from jaxnarx.evaluation.gain_signs import GainFinding
from jaxnarx.evaluation.rows import FREE_RUN, POOLED, Row, nrmse_within
from jaxnarx.evaluation.table import number

GOOD, LIMITED, UNUSABLE = "good", "usable with limits", "not usable"

WORTHLESS, ACCURATE = 1.0, 0.1**0.5
"""NRMSE of the mean, and the one that leaves a tenth of the variance."""
OVERFITTED, SMALL = 2.0, 0.1
"""Factor over the training NRMSE, and the NRMSE up to which it does not matter."""
FAR = 3.0
BETTER = 0.98
"""Share of the error below which another model counts as better."""
UNSURE = 0.1
REACH, STRAYED = 0.1, 0.05
GAINS = 3
"""Gains that change sign or jump that are told one by one."""
PROMISED = 1.5
"""Factor over the NRMSE of records left out."""

REMEDIES = {
    "bounded": "choose terms by simulation error, lower the degree, or let inputs "
    "enter through filters without output lags, which cannot diverge",
    "unstable": "a model that is stable for certain (`jaxnarx identify DESCRIPTION "
    "--preset ecu` takes no other), or terms chosen by simulation error",
    "cover": "train on records that reach as far",
    "richer": "more regions, other lags, filters, or terms chosen by simulation error",
    "simpler": "fewer terms or regions, or more training data",
    "linear": "a lower degree, or terms chosen by simulation error",
    "test": "name test records that take part in no choice",
    "intervals": "more groups of training records, of the kinds that are met in use",
    "records": "look at these records: channels, sensors, operating range",
}
"""What helps, by the name that findings carry."""
SEARCHED = REMEDIES | {
    "bounded": "training records that reach as far, or linear models",
    "unstable": "`--preset ecu`, which takes only models that are stable for certain",
    "richer": "a larger preset, other inputs, or more training records, above all like "
    "those served worst",
    "simpler": "more training records",
    "linear": "a larger preset, or more training records",
}
"""The same where a search has tried what a user could set."""


@dataclasses.dataclass(frozen=True)
class Reason:
    """One reason: what it makes of the model, and a key of `REMEDIES`."""

    level: str
    text: str
    remedy: str


@dataclasses.dataclass(frozen=True)
class Verdict:
    """`level` is `"good"`, `"usable with limits"` or `"not usable"`; worst reason
    first."""

    level: str
    findings: tuple[Reason, ...]
    praise: str = ""
    remarks: tuple[str, ...] = ()
    """What to look at, whatever the level."""
    searched: bool = False
    """Whether the model comes from a search."""

    @property
    def usable(self) -> bool:
        """Whether nothing speaks against all use."""
        return self.level != UNUSABLE

    @property
    def remedy(self) -> str:
        """The key of `REMEDIES` for the worst reason; empty where there is none."""
        return self.findings[0].remedy if self.findings else ""

    @property
    def sentence(self) -> str:
        """The verdict with its worst reasons and what would help."""
        head = self.level.capitalize()
        if not self.findings:
            return f"{head}: {self.praise}."
        told = [f.text for f in self.findings[:2]]
        rest = len(self.findings) - len(told)
        more = f"; and {rest} more" if rest else ""
        return f"{head}: {'; '.join(told)}{more}. What helps: {self.helps}."

    @property
    def helps(self) -> str:
        """The measure that helps against the worst reason; empty where there is
        none."""
        known = SEARCHED if self.searched else REMEDIES
        return known[self.remedy] if self.findings else ""

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        found = [dataclasses.asdict(f) for f in self.findings]
        told = {"level": self.level, "sentence": self.sentence, "findings": found}
        return told | {"remarks": list(self.remarks)}


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
    def pooled(self, output: str) -> Row: ...


def judge(report: Scored) -> Verdict:
    """The verdict by the rules above."""
    rows = [r for r in report.rows if r.mode == FREE_RUN]
    findings = [*_runs(report, rows), *_errors(report, rows), *_records(rows)]
    findings += [*_compare_with_linear(report), *_memory(report), *_data(report, rows)]
    findings += [*_left_out(report, rows), *_intervals(report)]
    findings.sort(key=lambda f: f.level != UNUSABLE)
    level = findings[0].level if findings else GOOD
    searched = bool(report.leaderboard)
    remarks = (*_remarks(report), *_gain_remarks(report))
    return Verdict(level, tuple(findings), _praise(report), remarks, searched)


def _praise(report: Scored) -> str:
    shares = [report.pooled(c.name).r2 for c in report.outputs]
    least = min((s for s in shares if s is not None), default=0.0)
    names = ", ".join(c.name for c in report.outputs)
    every = "at least " if len(shares) > 1 else ""
    return (
        f"the free run on {report.main} explains {every}{100 * least:.3g} % of the "
        f"variance of {names} and stays within its bounds"
    )


def _pooled(rows: Iterable[Row]) -> list[Row]:
    return [r for r in rows if r.record == POOLED]


def _runs(report: Scored, rows: list[Row]) -> Iterator[Reason]:
    """Divergence, nothing to judge, limits that act."""
    for row in sorted(_pooled(rows), key=lambda r: r.part != report.main):
        share = row.share_outside
        where = f"{row.output} on {row.part}"
        if row.diverged:
            lost = [
                r
                for r in rows
                if (r.part, r.output) == (row.part, row.output)
                and r.diverged
                and r.record != POOLED
            ]
            share = max((r.share_outside for r in lost), default=0.0)
            names = ", ".join(r.record for r in lost[:3]) or "all records"
            names += f" and {len(lost) - 3} more" if len(lost) > 3 else ""
            strayed = share >= STRAYED
            text = f"the free run of {where} diverges in {names}"
            if strayed:
                text += f", {share:.0%} of it outside the trained range"
            yield Reason(UNUSABLE, text, "cover" if strayed else "bounded")
        elif row.part == report.main and row.status == "no samples":
            yield Reason(UNUSABLE, f"{where} has no valid sample to score", "records")
        elif row.part == report.main and row.status == "constant output":
            yield Reason(LIMITED, f"{where} is constant: no judgement of it", "test")
        elif row.limited >= NOTICEABLE * max(row.samples, 1):
            held = row.limited / row.samples
            text = f"the feedback bound holds {where} at {held:.0%} of the samples"
            yield Reason(LIMITED, text, "cover" if share >= STRAYED else "bounded")


def _errors(report: Scored, rows: list[Row]) -> Iterator[Reason]:
    """Errors of whole parts, by themselves and beside that of training."""
    trained = {r.output: r.nrmse for r in _pooled(rows) if r.part == "train"}
    within = nrmse_within(rows)
    for row in sorted(_pooled(rows), key=lambda r: r.part != report.main):
        if row.nrmse is None or row.status != "ok":
            continue
        where, learned = f"{row.output} on {row.part}", row.part == "train"
        own = trained.get(row.output)
        if row.nrmse >= WORTHLESS and not learned:
            text = f"the free run of {where} is no better than the mean"
            yield Reason(UNUSABLE, f"{text} ({_nrmse(row.nrmse)})", "richer")
        elif row.nrmse > ACCURATE:
            yield Reason(LIMITED, _unexplained_share(where, row.nrmse), "richer")
        inside = within.get((row.output, row.part), 0.0)
        if inside >= WORTHLESS > row.nrmse and not learned:
            text = f"within a record the free run of {where} is no better than its mean"
            yield Reason(LIMITED, f"{text} ({_nrmse(inside)})", "richer")
        if learned or own is None or row.nrmse <= max(SMALL, OVERFITTED * own):
            continue
        text = f"the error of {where} is {row.nrmse / own:.2g} times that of training"
        yield Reason(LIMITED, text, "simpler")


def _unexplained_share(where: str, nrmse: float) -> str:
    """The share of the variance that the free run leaves; above one no share is
    told."""
    text = f"the free run of {where} is worse than the mean"
    if nrmse < WORTHLESS:
        text = f"the free run leaves {nrmse**2:.0%} of the variance of {where}"
    return f"{text} ({_nrmse(nrmse)})"


def _nrmse(value: float) -> str:
    return f"NRMSE {value:.3g}"


def _records(rows: list[Row]) -> Iterator[Reason]:
    """Single records that are far off, whatever their part."""
    for output in dict.fromkeys(r.output for r in rows):
        own = [r for r in rows if r.output == output]
        spread = {
            r.part: r.rmse / r.nrmse
            for r in _pooled(own)
            if r.rmse is not None and r.nrmse
        }
        single = [(r.rmse, r) for r in own if r.record != POOLED and r.rmse is not None]
        if len(single) < 3:
            continue
        usual = float(np.median([error for error, _ in single]))
        far = [
            (error, r)
            for error, r in single
            if error > max(FAR * usual, ACCURATE * spread.get(r.part, np.inf))
        ]
        for error, row in sorted(far, key=lambda pair: -pair[0])[:1]:
            unit = f" {row.unit}" if row.unit not in ("", "-", "1") else ""
            text = f"{output} is off in {row.part} record {row.record}: RMSE "
            text += f"{number(error, '.3g')}{unit}, median record "
            text += f"{number(usual, '.3g')}"
            if row.offset is not None:
                text += f", mean of measured minus simulated {row.offset:+.3g}{unit}"
            if len(far) > 1:
                text += f"; {len(far) - 1} more such"
            yield Reason(LIMITED, text, "records")


def _compare_with_linear(report: Scored) -> Iterator[Reason]:
    """A linear model that does better."""
    for row in report.beside.get(NAME, ()):
        own = report.pooled(row.output).nrmse
        if own is not None and row.nrmse is not None and row.nrmse < BETTER * own:
            text = f"a linear model of the same lags does better on {row.output}"
            text += f" ({_nrmse(row.nrmse)}, this one {own:.3g})"
            yield Reason(LIMITED, text, "linear")


def _memory(report: Scored) -> Iterator[Reason]:
    """The reasons from poles and the contraction bound."""
    found = report.stability
    if found is None:
        return
    for row in found.poles:
        if row.model is not None and row.samples and row.unstable > 0.5:
            text = f"local model {row.model} of {row.output} alone is unstable where it"
            text += f" leads ({_region(report, row)}pole {row.median:.4g})"
            yield Reason(LIMITED, text, "unstable")
    if not found.contracts and found.bound.fails >= UNSURE:
        text = f"nothing shows that it forgets its past at {found.bound.fails:.0%} of "
        yield Reason(LIMITED, text + "the samples", "unstable")


def _region(report: Scored, row: Any) -> str:
    """The region in which a local model leads, if that is known."""
    for one in report.regions:
        if (one.output, one.model) == (row.output, row.model) and one.region:
            return f"{one.region}; "
    return ""


def _data(report: Scored, rows: list[Row]) -> Iterator[Reason]:
    """The data that the figures were measured on, in words."""
    if any("EQUALS ESTIMATION" in note for note in report.notes):
        text = "it was judged on records that it was trained on"
        yield Reason(LIMITED, text, "test")
    elif report.main in ("train", "validate"):
        text = f"there are no test data: {report.main} took part in making it"
        yield Reason(LIMITED, text + _held_out_error(report), "test")
    main = [r for r in _pooled(rows) if r.part == report.main]
    share = max((r.share_outside for r in main), default=0.0)
    far = [o for o in report.outside if o.part == report.main and o.beyond >= REACH]
    if share >= STRAYED and far:
        text = f"{share:.0%} of the {report.main} samples lie outside the trained range"
        yield Reason(LIMITED, f"{text} ({far[0]})", "cover")


def _intervals(report: Scored) -> Iterator[Reason]:
    """Prediction intervals that hold less than they claim."""
    for one in report.coverage:
        if one.part == report.main and one.is_narrow:
            text = f"the {one.level:.0%} intervals of {one.output} hold {one.held:.1%} "
            text += f"of the {one.part} samples: they are too narrow"
            yield Reason(LIMITED, text, "intervals")


def _remarks(report: Scored) -> Iterator[str]:
    """Remarks on what to look at and what says nothing against the model."""
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


def _gain_remarks(report: Scored) -> Iterator[str]:
    """Gains that change sign or jump, the commonest first."""
    found = sorted(report.gains, key=lambda one: -one.share)
    yield from map(str, found[:GAINS])
    if len(found) > GAINS:
        yield f"{len(found) - GAINS} more gains change sign or jump"


def _in_use(report: Scored) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """The row of the leaderboard that the model of each output is."""
    for output, entry in (report.leaderboard or {}).items():
        for row in entry["rows"]:
            if row["used"]:
                yield output, row


def _held_out_error(report: Scored) -> str:
    """The error on records left out, where there are no test data."""
    told = [
        f"{output} {row['free_run']:.3g}"
        for output, row in _in_use(report)
        if row["free_run"] is not None
    ]
    return f"; NRMSE on records left out: {', '.join(told)}" if told else ""


def _left_out(report: Scored, rows: list[Row]) -> Iterator[Reason]:
    """The free run over records that the search left out."""
    tested = {r.output: r.nrmse for r in _pooled(rows) if r.part == "test"}
    for output, row in _in_use(report):
        error, worst = row["free_run"], row["worst_group_error"]
        where = f"the free run of {output} on records left out of training"
        if error is None:
            text = f"{where} diverges in {max(row['diverged'], 1)} of them"
            yield Reason(UNUSABLE, text, "bounded")
            continue
        test = tested.get(output)
        spread = row["standard_error"] or 0.0
        if error + spread >= WORTHLESS:
            more = f" ± {spread:.2g}" if spread else ""
            text = f"{where} is no better than the mean ({_nrmse(error)}{more})"
            yield Reason(UNUSABLE, text, "richer")
        elif worst is not None and worst >= WORTHLESS:
            text = f"{where} is no better than the mean in {row['worst_group']}"
            yield Reason(LIMITED, f"{text} ({_nrmse(worst)})", "records")
        elif error > ACCURATE and test is None:
            text = f"{where} leaves {error**2:.0%} of the variance ({_nrmse(error)})"
            yield Reason(LIMITED, text, "richer")
        if test is not None and error and test > max(SMALL, PROMISED * error):
            text = f"the error of {output} on test is {test / error:.2g} times that on "
            yield Reason(LIMITED, text + "records left out of training", "cover")
