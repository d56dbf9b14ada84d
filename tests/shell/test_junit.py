"""Rules of a verdict as JUnit XML: what it counts, escapes and refuses."""

import os
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from verdict_problems import made, row

from jaxnarx.errors import DataFileError, SpecError
from jaxnarx.shell.junit import junit_file, junit_xml, write_junit

GOOD = made(row("train"), row("test"))
POOR = made(row("train"), row("test", nrmse=0.7))
LOST = made(row("train"), row("test", status="diverged (1 of 1)"))


def suite(report, required=None) -> ET.Element:
    (found,) = ET.fromstring(junit_xml(report, required))
    return found


@pytest.mark.parametrize("report", [GOOD, POOR, LOST])
def test_a_case_for_every_rule_and_counts_that_agree(report):
    found, rules = suite(report), report.verdict.rules
    names = [(case.get("classname"), case.get("name")) for case in found]
    assert len(set(names)) == len(names) == len(rules) == int(found.get("tests", 0))
    for kind, passed in {"failure": False, "skipped": None}.items():
        count = sum(rule.passed is passed for rule in rules)
        attribute = "failures" if kind == "failure" else kind
        assert len(found.findall(f"testcase/{kind}")) == count
        assert found.get(attribute) == str(count)
    assert found.get("errors") == "0"


def test_a_failure_carries_value_limit_and_reason():
    first = suite(POOR).findall("testcase/failure")[0]
    assert first.get("message") == ("accuracy, T, test: 0.7, must be at most 0.316228")
    assert first.get("type") == "usable with limits"
    assert "leaves 49% of the variance of T on test" in (first.text or "")
    assert not suite(GOOD).findall("testcase/failure")
    (case,) = [c for c in suite(POOR) if c.get("name") == "accuracy, test"]
    assert case.get("classname") == "jaxnarx.T"


def test_the_required_fit_is_a_case_too():
    found = suite(GOOD, 95.0).findall("testcase/failure")
    assert [f.get("message") for f in found] == [
        "required fit %, T, test: 90, must be at least 95"
    ]
    assert not suite(GOOD, 90.0).findall("testcase/failure")
    missing = suite(LOST, 90.0).findall("testcase/skipped")[-1]
    assert "no value" in (missing.get("message") or "")


def test_names_from_data_end_no_element():
    name = "a<b>&\"'\x01\x1b[31m\udc80]]>"
    lost = row("test", name, status="diverged")
    report = made(row("test", status="diverged (1 of 1)"), lost)
    text = suite(report).findall("testcase/failure")[0].text or ""
    assert "a<b>&\"'\\x01\\x1b[31m\\udc80]]>" in text


def test_it_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    path = tmp_path / "new" / "verdict.xml"
    with junit_file(str(path), force=False) as place:
        assert place == path
        write_junit(GOOD, path)
    assert path.read_bytes() == junit_xml(GOOD)
    assert os.listdir(path.parent) == ["verdict.xml"]

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", fail)
    with pytest.raises(DataFileError, match="Free some space and give the same comm"):
        write_junit(POOR, path)
    assert path.read_bytes() == junit_xml(GOOD)
    assert os.listdir(path.parent) == ["verdict.xml"]


def test_what_cannot_be_written_is_refused_before_any_work(tmp_path):
    path = tmp_path / "verdict.xml"

    def enter(place: Path, force=False):
        with junit_file(str(place), force=force) as found:
            return found

    path.write_text("old")
    with pytest.raises(
        SpecError, match="another --junit, or overwrite it with --force"
    ):
        enter(path)
    assert enter(path, force=True) == path and path.read_text() == "old"
    with pytest.raises(DataFileError, match="Choose another --junit"):
        enter(path / "inside.xml")
    with pytest.raises(SpecError, match="is a folder; name a file in it"):
        enter(tmp_path)
    with junit_file(None, force=False) as found:
        assert found is None


def test_a_folder_made_for_it_goes_when_the_report_fails(tmp_path):
    path = tmp_path / "new" / "verdict.xml"
    with pytest.raises(ZeroDivisionError):
        with junit_file(str(path), force=False):
            raise ZeroDivisionError
    assert not path.parent.exists()
