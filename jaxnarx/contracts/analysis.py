"""The contract of an analysis of reports, `ANALYSES.register(name, function)`."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np

from jaxnarx.contracts.life import plant, pool
from jaxnarx.evaluation import ANALYSES, Analysis, FreeRun, Section, report
from jaxnarx.identification import run_method
from jaxnarx.models import Network
from jaxnarx.settings import Identification


def _network() -> Network:
    method = Identification(pool=pool(), refine=None)
    return run_method(plant(), method, None, None).value


def _run() -> FreeRun:
    return FreeRun.of(_network(), plant(), "test")


def says_something_or_nothing(analysis: Analysis) -> None:
    """It makes a `Section` of a free run, whose rows have a cell for every column, or
    None; a second call gives the same."""
    first, again = analysis(_run()), analysis(_run())
    assert first is None or isinstance(first, Section)
    assert str(first) == str(again)
    if first is not None:
        assert all(len(row) == len(first.header) for row in first.rows)


def survives_what_diverges(analysis: Analysis) -> None:
    """A run in which every record diverges, and one without a sample that counts, give
    a section or None, and no error."""
    run = _run()
    for change in (_diverge, _mask):
        samples = [[change(one) for one in records] for records in run.samples]
        found = analysis(dataclasses.replace(run, samples=samples))
        assert found is None or isinstance(found, Section)


def _diverge(one: Any) -> Any:
    predicted = np.full(one.predicted.shape, np.inf)
    return dataclasses.replace(one, predicted=predicted, diverged=True)


def _mask(one: Any) -> Any:
    return dataclasses.replace(one, scored=np.zeros(one.scored.shape, bool))


def is_in_text_json_and_page(analysis: Analysis, folder: Path) -> None:
    """Its section stands in the report's text, in `report.json` and on its page."""
    name = next(n for n, one in ANALYSES.added.items() if one is analysis)
    found = report(_network(), {"test": plant()}, stability=False, diagnostics=False)
    section = found.sections.get(name)
    if section is None:
        return
    assert section.title in str(found)
    assert json.loads(json.dumps(found.to_dict()))["sections"][name]["title"]
    found.to_html(folder / "report.html")
    assert section.title in (folder / "report.html").read_text(encoding="utf-8")


CHECKS = says_something_or_nothing, survives_what_diverges, is_in_text_json_and_page
"""Every check of a kind over every extension of it, see `jaxnarx.contracts`."""
