"""The rules of a verdict as JUnit XML, which build servers show as test cases."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

from jaxnarx.checks import require
from jaxnarx.errors import printable
from jaxnarx.files import unwritable, write_whole
from jaxnarx.shell.exit_code import required_rules
from jaxnarx.shell.output import run_folder

if TYPE_CHECKING:
    from jaxnarx.evaluation import Report, VerdictRule


@contextmanager
def junit_file(path: str | None, *, force: bool) -> Iterator[Path | None]:
    """The file to write; one that cannot be written is refused before any work."""
    if path is None:
        yield None
        return
    place = Path(path)
    text = f"--junit {path} is a folder; name a file in it, such as verdict.xml"
    require(not place.is_dir(), "junit", text)
    where, marks = str(place.parent), (place.name,)
    with run_folder(where, "", force=force, marks=marks, by="junit") as folder:
        yield folder / place.name


def write_junit(report: "Report", path: Path, required: float | None = None) -> None:
    """Write the rules of the verdict, and of the required fit, whole or not at all."""
    try:
        write_whole(path, junit_xml(report, required))
    except OSError as error:
        raise unwritable(path, error) from error


def junit_xml(report: "Report", required: float | None = None) -> bytes:
    """A test case per rule, output and part: passed, failed, or skipped without a
    value."""
    rules = (*report.verdict.rules, *required_rules(report, required))
    counts = {
        "tests": len(rules),
        "failures": sum(rule.passed is False for rule in rules),
        "errors": 0,
        "skipped": sum(rule.passed is None for rule in rules),
    }
    words = {name: str(count) for name, count in counts.items()}
    root = ET.Element("testsuites")
    suite = ET.SubElement(root, "testsuite", {"name": "jaxnarx report"} | words)
    for rule in rules:
        _add_case(suite, rule)
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8", xml_declaration=True)


def _add_case(suite: ET.Element, rule: "VerdictRule") -> None:
    group = printable(f"jaxnarx.{rule.output or 'model'}")
    name = printable(", ".join(filter(None, (rule.name, rule.where))))
    case = ET.SubElement(suite, "testcase", classname=group, name=name)
    if rule.passed:
        return
    told = {"message": printable(str(rule))}
    if rule.passed is None:
        ET.SubElement(case, "skipped", told)
        return
    told["type"] = rule.reason.level if rule.reason else "rule"
    reason = printable(rule.reason.text if rule.reason else str(rule))
    ET.SubElement(case, "failure", told).text = reason
