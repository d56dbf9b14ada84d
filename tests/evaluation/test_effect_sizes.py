"""What a free run is worth beside others, and the first lines of a report."""

import dataclasses

import numpy as np
import pytest
from common import Part, network
from test_verdict import FINE, made, row

from jaxnarx.data import Channel
from jaxnarx.evaluation.domain_errors import INDEX_EDGES, DomainErrors, ErrorByIndex
from jaxnarx.evaluation.effect_sizes import effects
from jaxnarx.evaluation.rows import ScoredSamples
from jaxnarx.models import hold_to_range

OUTPUT = Channel("T", "K")


def samples(error, record="r1", count=10, diverged=False):
    """A record whose error is the same at every sample that counts."""
    y = np.arange(float(count))[:, None]
    scored = np.ones((count, 1), bool)
    scored[0] = False
    wrong = np.where(scored, y - error, 1e9)
    off = ~scored & False
    return ScoredSamples(
        record, y, wrong, scored, off, off, off[:, 0], diverged, short=False
    )


def test_factors_are_those_of_pooled_errors_and_records_are_counted():
    own = [samples(1.0), samples(3.0, "r2", count=28)]
    other = [samples(2.0), samples(2.0, "r2", count=28)]
    found = effects("test", list(FINE), [own], {"other": [(OUTPUT, other)]}, None)
    (one,) = found[0].beside
    # 9 samples of 1 and 27 of 3^2 against 36 of 2^2.
    assert one.factor == pytest.approx(np.sqrt((9 + 27 * 9) / (36 * 4)))
    assert (one.better, one.records) == (1, 2)
    assert "1.3 times the error of other (smaller in 1 of 2 records)" in str(found[0])
    assert found[0].explained == 0.99 and found[0].trained == pytest.approx(1.0)


def test_what_diverges_or_has_another_output_is_not_compared():
    own = [samples(1.0)]
    others = {
        "lost": [(OUTPUT, [samples(2.0, diverged=True)])],
        "perfect": [(OUTPUT, [samples(0.0)])],
        "of another output": [(Channel("p"), own)],
    }
    (one,) = effects("train", [row("train")], [own], others, None)
    assert one.beside == () and one.trained is None and one.outside is None
    bad = row("test", status="diverged (1 of 1)")
    (one,) = effects("test", [bad], [own], {}, None)
    assert str(one) == "T: no figure"


def test_errors_beyond_the_square_root_of_all_numbers_are_compared():
    """Defect 47: squares of such errors overflowed."""
    other = {"huge": [(OUTPUT, [samples(4e200)])], "more": [(OUTPUT, [samples(1e-3)])]}
    (found,) = effects("test", list(FINE), [[samples(2e200)]], other, None)
    assert [b.factor for b in found.beside] == pytest.approx([0.5, 2e203])
    bins = len(INDEX_EDGES) - 1
    far = ErrorByIndex("T", "K", np.full(bins, 3e200), np.full(bins, 100))
    assert far.inside == pytest.approx(3e200) == far.outside
    sentence = made(
        dataclasses.replace(row("train"), nrmse=1e180), row("test")
    ).verdict.sentence
    assert "worse than the mean (NRMSE 1e+180)" in sentence


def test_beyond_the_domain_the_error_is_told_as_a_multiple():
    bins = len(INDEX_EDGES) - 1
    rms, count = np.full(bins, 2.0), np.full(bins, 100)
    rms[INDEX_EDGES.index(1.0) :] = 5.0
    known = DomainErrors({"test": 0.2}, (), (ErrorByIndex("T", "K", rms, count),))
    (one,) = effects("test", list(FINE), [[samples(1.0)]], {}, known)
    assert one.outside == pytest.approx(2.5)
    assert "outside of its domain 2.5 times that inside" in str(one)


# the first lines --------------------------------------------------------------------


def test_the_first_lines_say_whether_why_where_and_what_helps():
    lines = made(row("train"), row("test", nrmse=0.4)).summary.lines()
    text = "\n".join(lines)
    assert lines[0].startswith("Usable with limits: it can be used")
    order = [text.index(f"  {word} ") for word in ("why", "where", "helps")]
    assert order == sorted(order) and "16% of the variance of T on test" in text
    good = made(*FINE).summary
    assert good.helps == "" and good.why[0].startswith("the free run on test explains")
    assert "100 % of the test samples" in good.where[-1]
    bad = made(row("train"), row("test", nrmse=1.2)).summary
    assert bad.lines()[0] == "Not usable: do not rely on its free run."


def test_the_worst_record_is_told_and_a_diverged_one_first():
    records = [row("test", "r1", nrmse=0.05), row("test", "r2", nrmse=0.2)]
    told = made(*FINE, *records).summary.worst_record
    assert told == "record: T in r2: RMSE 10 K, 2 times that of all records"
    lost = row("test", "r3", status="diverged")
    told = made(*FINE, *records, lost).summary.worst_record
    assert told == "record: T diverges in r3"
    assert made(*FINE, records[0]).summary.worst_record == ""


def test_ranges_and_what_lies_beyond_come_from_the_network():
    net = network([Part([[((0, 1), 0.5)]])])
    where = made(*FINE, network=net).summary.where
    assert (
        where[0] == "trained for a -20 to 20 V, b -5 to 5. Beyond that it extrapolates."
    )
    held = hold_to_range(net, 0.02, outside="hold")
    told = made(*FINE, network=held).summary.where[0]
    assert told.endswith("Beyond that inputs are held at its edge.")
    domain = DomainErrors({"test": 0.25}, (), ())
    assert "75 % of the test" in made(*FINE, domain=domain).summary.where[-1]


def test_lines_are_short_and_hold_no_control_character():
    name = "r\x1b[31m\n" + "long " * 40
    lost = row("test", name, status="diverged")
    pooled = row("test", status="diverged (1 of 2)")
    lines = made(row("train"), pooled, lost).summary.lines()
    assert max(map(len, lines)) <= 88 and all(line.isprintable() for line in lines)


def test_many_reasons_are_counted():
    summary = made(*FINE).summary
    many = dataclasses.replace(summary, more=3)
    assert "         and 3 more" in many.lines()
