"""The verdict: one case for every rule, and what a sentence says."""

import dataclasses
import json
import types

import pytest
from verdict_problems import made, row

from jaxnarx.evaluation._region_errors import RegionError
from jaxnarx.evaluation.baseline import BASELINE_NAME
from jaxnarx.evaluation.coverage import IntervalCoverage
from jaxnarx.evaluation.extrapolation import Outside
from jaxnarx.evaluation.verdict import REMEDIES

FINE = (row("train"), row("test"))


def stable(fails=0.0, unstable=0.0):
    """What the verdict reads of a `Stability`."""
    pole = types.SimpleNamespace(
        output="T", model=2, samples=90, unstable=unstable, median=1.017
    )
    bound = types.SimpleNamespace(fails=fails)
    return types.SimpleNamespace(poles=[pole], bound=bound, contracts=not fails)


def test_a_good_model_is_called_good_with_its_figure():
    verdict = made(*FINE, stability=stable(fails=0.01)).verdict
    assert verdict.level == "good" and verdict.usable and verdict.remedy == ""
    assert "explains 99 % of the variance of T" in verdict.sentence


def test_divergence_in_any_record_makes_it_unusable_and_names_the_record():
    lost = row("test", "r3", status="diverged")
    pooled = row("test", status="diverged (1 of 6)")
    verdict = made(row("train"), pooled, lost).verdict
    assert verdict.level == "not usable" and not verdict.usable
    assert verdict.remedy == "bounded" and "diverges in r3" in verdict.sentence
    # Where the record lies outside, the model is not what has to change.
    far = dataclasses.replace(lost, extrapolated=600)
    verdict = made(row("train"), pooled, far).verdict
    assert verdict.remedy == "cover"
    assert "60% of it outside the trained range" in verdict.sentence
    trained = row("train", status="diverged (1 of 2)")
    assert not made(trained, row("test")).verdict.usable


def test_no_better_than_the_mean_is_unusable():
    verdict = made(row("train"), row("test", nrmse=1.08)).verdict
    assert verdict.level == "not usable"
    assert "no better than the mean (NRMSE 1.08)" in verdict.sentence


def test_a_training_record_that_is_far_off_is_named_with_its_offset():
    """Test NRMSE .29 beside .80 in training: one record is 72 K off."""
    records = [row("train", f"d{k}", nrmse=0.28) for k in range(4)]
    records += [row("train", "d9", nrmse=1.5, offset=72.0)]
    rows = [row("train", nrmse=0.8), *records, row("test", nrmse=0.29)]
    rows += [row("test", "t0", nrmse=0.29)]
    verdict = made(*rows).verdict
    assert verdict.level == "usable with limits"
    text = " ".join(f.text for f in verdict.findings)
    assert "64% of the variance of T on train" in text
    assert "off in train record d9" in text and "+72 K" in text


def far_apart(nrmse: float):
    """Two test records at levels far apart: pooled 3e-5, `nrmse` in each."""
    records = [row("test", f"t{k}", rmse=1.0, nrmse=nrmse) for k in range(2)]
    return made(row("train"), row("test", rmse=1.0, nrmse=3e-5), *records)


LIMITS = {
    "level only": (far_apart(1.2), "within a record"),
    "half unexplained": (made(row("test", nrmse=0.7)), "49%"),
    "overfitted": (made(row("train", nrmse=0.05), row("test", nrmse=0.25)), "5 times"),
    "held": (made(row("train"), row("test", limited=20)), "feedback bound"),
    "no contraction": (made(*FINE, stability=stable(fails=1.0)), "at 100% of"),
    "unstable region": (made(*FINE, stability=stable(unstable=1.0)), "pole 1.017"),
    "learned": (made(*FINE, notes=("X DATA EQUALS ESTIMATION DATA",)), "trained on"),
    "no test": (made(row("train"), row("validate"), main="validate"), "no test data"),
    "constant": (made(row("train"), row("test", status="constant output")), "constant"),
    "linear": (
        made(*FINE, beside={BASELINE_NAME: (row("test", nrmse=0.05),)}),
        "linear model",
    ),
    "strayed": (
        made(
            row("train"),
            row("test", extrapolated=230),
            outside=(Outside("test", "load", "%", 10.0, 110.0, (10.0, 90.0), 0.23),),
        ),
        "beyond by up to 25 %",
    ),
}


@pytest.mark.parametrize("kind", LIMITS)
def test_limits(kind):
    report, words = LIMITS[kind]
    (found,) = report.verdict.findings
    assert report.verdict.level == "usable with limits"
    assert words in found.text and found.remedy in REMEDIES
    assert words in report.verdict.sentence


def test_an_unstable_region_is_named_with_the_preset_that_refuses_it():
    region = RegionError("T", 2, "speed above 3000", 0.2, 0.5, 3.0)
    board = {"T": {"rows": []}}
    report = made(*FINE, stability=stable(unstable=1.0), regions=(region,))
    text = report.verdict.findings[0].text
    assert text.endswith("where it leads (speed above 3000; pole 1.017)")
    assert "--preset ecu" in report.verdict.helps
    assert (
        "--preset ecu" in dataclasses.replace(report, leaderboard=board).verdict.helps
    )


def test_a_little_more_range_or_error_is_no_limit():
    near = Outside("test", "load", "%", 10.0, 94.0, (10.0, 90.0), 0.23)
    strayed = row("test", extrapolated=230)
    assert made(row("train"), strayed, outside=(near,)).verdict.level == "good"
    small = made(row("train", nrmse=0.01), row("test", nrmse=0.06))
    assert small.verdict.level == "good"


def intervals(held, half=9.0, chance=0.04, part="test"):
    return (IntervalCoverage(part, "T", "K", 0.9, held, half, 1000, 5.0, chance),)


def test_intervals_that_hold_less_than_they_claim_are_a_limit():
    verdict = made(*FINE, coverage=intervals(0.829)).verdict
    assert verdict.level == "usable with limits" and verdict.remedy == "intervals"
    assert "90% intervals of T hold 82.9% of the test samples" in verdict.sentence
    # So few records say less, and so does another part.
    assert made(*FINE, coverage=intervals(0.829, chance=0.08)).verdict.level == "good"
    assert made(*FINE, coverage=intervals(0.88, chance=0.0)).verdict.level == "good"
    assert made(*FINE, coverage=intervals(0.5, part="train")).verdict.level == "good"


def test_intervals_three_times_as_wide_as_the_error_are_a_remark():
    """36.8 degC beside an RMSE of 12.4: 2.97 times."""
    broad = intervals(1.0, half=36.8 / 12.4 * 5)
    report = made(*FINE, coverage=broad)
    assert report.verdict.level == "good" and not report.verdict.findings
    (remark,) = report.verdict.remarks
    assert "± 14.8 K, RMSE 5 K" in remark and remark in report.summary.also
    assert report.to_dict()["verdict"]["remarks"] == [remark]
    assert "  also " in report.table
    for fine in (intervals(0.95), intervals(0.89, half=20.0)):
        assert not made(*FINE, coverage=fine).verdict.remarks
    trained = intervals(1.0, half=30.0, part="train")
    report = made(row("train"), main="train", coverage=trained)
    assert not report.verdict.remarks


def test_the_worst_reason_comes_first_and_others_are_counted():
    rows = [row("train", nrmse=0.7), row("test", nrmse=1.2, limited=30)]
    verdict = made(*rows, stability=stable(fails=0.5)).verdict
    assert verdict.findings[0].level == "not usable"
    assert f"and {len(verdict.findings) - 2} more" in verdict.sentence


def test_table_and_json_begin_with_it():
    report = made(*FINE)
    assert report.table.startswith("Good: ")
    found = report.to_dict()
    assert next(iter(found)) == "verdict" and found["verdict"]["level"] == "good"


# models of a search ---------------------------------------------------------------


def searched(error, worst=0.2, diverged=0, spread=None):
    """The leaderboard of a model with this error on records left out."""
    used = {"used": True, "free_run": error, "diverged": diverged}
    used |= {"worst_group": "day 2", "worst_group_error": worst}
    used |= {"standard_error": spread}
    other = used | {"used": False, "free_run": 5.0}
    return {"T": {"rows": [other, used]}}


def test_a_model_that_diverges_on_records_left_out_is_unusable():
    verdict = made(*FINE, leaderboard=searched(None, diverged=2)).verdict
    assert verdict.level == "not usable" and verdict.remedy == "bounded"
    assert "records left out of training diverges in 2 of them" in verdict.sentence
    assert "linear models" in verdict.sentence  # not what a user would set by hand


def test_no_better_than_the_mean_on_records_left_out():
    verdict = made(*FINE, leaderboard=searched(1.2)).verdict
    assert verdict.level == "not usable" and "larger preset" in verdict.sentence
    verdict = made(*FINE, leaderboard=searched(0.97, spread=0.05)).verdict
    assert "the mean (NRMSE 0.97 ± 0.05)" in verdict.sentence and not verdict.usable
    assert made(*FINE, leaderboard=searched(0.9, spread=0.05)).verdict.usable
    verdict = made(*FINE, leaderboard=searched(0.2, worst=1.4)).verdict
    assert verdict.level == "usable with limits" and verdict.remedy == "records"
    assert "no better than the mean in day 2 (NRMSE 1.4)" in verdict.sentence


def test_test_data_that_are_worse_than_promised_are_told():
    rows = (row("train", nrmse=0.25), row("test", nrmse=0.3))
    assert made(*rows, leaderboard=searched(0.29)).verdict.level == "good"
    verdict = made(*rows, leaderboard=searched(0.1)).verdict
    assert "T on test is 3 times that on records left out" in verdict.sentence
    assert verdict.remedy == "cover"


def test_without_test_data_the_records_left_out_judge():
    train = row("train", nrmse=0.2)
    verdict = made(train, main="train", leaderboard=searched(0.25)).verdict
    assert [f.remedy for f in verdict.findings] == ["test"]
    assert "NRMSE on records left out: T 0.25" in verdict.sentence
    verdict = made(train, main="train", leaderboard=searched(0.5)).verdict
    assert any("leaves 25% of the variance" in f.text for f in verdict.findings)


def test_a_linear_model_must_be_clearly_better():
    def beside(nrmse):
        return made(
            *FINE, beside={BASELINE_NAME: (row("test", nrmse=nrmse),)}
        ).verdict.level

    assert beside(0.099) == "good" and beside(0.097) == "usable with limits"


# rules ----------------------------------------------------------------------------

FAILED = {
    "level only": ("better than the mean in records", 1.2, "below", 1.0),
    "half unexplained": ("accuracy", 0.7, "at most", 0.1**0.5),
    "overfitted": ("overfitting", 0.25, "at most", 0.1),
    "held": ("feedback bound", 0.02, "below", 0.01),
    "no contraction": ("share without contraction", 1.0, "below", 0.1),
    "unstable region": ("share unstable", 1.0, "at most", 0.5),
    "learned": ("parts that repeat training data", 1.0, "at most", 0.0),
    "no test": ("independent parts", 0.0, "at least", 1.0),
    "constant": ("samples to judge by", 0.0, "at least", 1.0),
    "linear": ("beside a linear model", 0.1, "at most", 0.05 / 0.98),
    "strayed": ("share beyond trained range", 0.23, "below", 0.05),
}


@pytest.mark.parametrize("kind", LIMITS)
def test_a_reason_has_a_rule_with_value_and_limit(kind):
    verdict = LIMITS[kind][0].verdict
    (rule,) = [rule for rule in verdict.rules if rule.passed is False]
    name, value, sense, limit = FAILED[kind]
    assert (rule.name, rule.sense) == (name, sense)
    assert (rule.value, rule.limit) == pytest.approx((value, limit), rel=1e-3)
    assert rule.reason == verdict.findings[0]
    assert f"must be {sense}" in str(rule)


def kept(value: float, sense: str, limit: float) -> bool:
    """Slow and obvious."""
    order = {"below": [-1], "at most": [-1, 0], "at least": [0, 1]}
    return (value > limit) - (value < limit) in order[sense]


def test_rules_are_told_apart_and_agree_with_the_verdict():
    rows = [row("train", f"d{k}", nrmse=0.28) for k in range(3)]
    rows += [row("train", nrmse=0.3), row("test", nrmse=1.2, limited=30)]
    rows += [row("test", "t0", nrmse=1.3)]
    found = made(
        *rows,
        stability=stable(fails=0.05),
        coverage=intervals(0.5),
        leaderboard=searched(0.1, worst=1.5),
    ).verdict
    assert found.level == "not usable"
    places = [(rule.name, rule.output, rule.where) for rule in found.rules]
    assert len(set(places)) == len(places) > 12
    for rule in found.rules:
        assert rule.value is not None
        assert rule.passed == kept(rule.value, rule.sense, rule.limit)
        assert rule.reason is None or not rule.passed
    told = [rule.reason for rule in found.rules if rule.reason]
    assert sorted(map(str, told)) == sorted(map(str, found.findings))
    # The mean has said so of the test part: no second reason, yet no pass.
    (same,) = [r for r in found.rules if (r.name, r.where) == ("accuracy", "test")]
    assert same.passed is False and same.reason is None
    assert all(rule.passed is not False for rule in made(*FINE).verdict.rules)


def test_what_could_not_be_measured_neither_passes_nor_fails():
    lost = row("test", status="diverged (1 of 1)")
    report = made(row("train"), lost, row("test", "r0", status="diverged"))
    rules = {r.name: r for r in report.verdict.rules if r.where == "test"}
    assert rules["diverged records"].passed is False
    for name in ("accuracy", "better than the mean", "overfitting"):
        assert rules[name].value is None and rules[name].passed is None
    nan = dataclasses.replace(rules["accuracy"], value=float("nan"))
    assert nan.passed is None and nan.to_dict()["value"] is None


def test_json_has_the_rules_beside_the_keys_it_had():
    found = made(row("train"), row("test", nrmse=0.7)).to_dict()["verdict"]
    assert list(found) == ["level", "sentence", "findings", "remarks", "rules"]
    assert set(found["findings"][0]) == {"level", "text", "remedy"}
    (failed,) = [rule for rule in found["rules"] if rule["passed"] is False][:1]
    assert list(failed) == "name output where value sense limit passed".split()
    json.dumps(found, allow_nan=False)


@pytest.mark.parametrize("status", ["no samples", "too short"])
def test_a_main_part_without_samples_is_no_good_model(status):
    found = made(row("test", status=status, samples=0, nrmse=0.0)).verdict
    assert not found.usable
    assert found.findings[0].text == "T on test has no valid sample to score"
    (rule,) = [one for one in found.rules if one.name == "samples to judge by"]
    assert rule.passed is False and rule.reason == found.findings[0]


def test_a_record_without_samples_is_no_worst_record():
    rows = [row("test")] + [row("test", f"r{n}") for n in range(3)]
    short = row("test", "r9", status="too short", samples=0, nrmse=float("inf"))
    assert made(*rows, short).verdict.findings == made(*rows).verdict.findings
