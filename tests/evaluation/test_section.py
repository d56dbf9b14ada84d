"""An analysis of one's own stands in a report's text, JSON and page."""

import json

import numpy as np
import pytest
from problems import data, fitted

import jaxnarx as jnx
from jaxnarx.evaluation import ANALYSES, Chart, Curve, FreeRun, Section


@pytest.fixture
def register():
    """Registers an analysis under its function's name, and forgets it again."""
    names = []

    def keep(analysis):
        names.append(analysis.__name__)
        return ANALYSES.register(analysis.__name__, analysis)

    yield keep
    for name in names:
        del ANALYSES[name]


def largest(run):
    """The largest error of every output."""
    rows = []
    for o, channel in enumerate(run.outputs):
        errors = np.concatenate(run.errors(o))
        rows.append((channel.name, float(np.nanmax(np.abs(errors))), None))
    x = np.arange(3.0)
    chart = Chart((Curve("a", x, x), Curve("<b>", x, x**2)), "time", "<y>", "A chart")
    return Section(
        "Largest <errors>",
        ("It is & stays small.",),
        ("output", "largest", "nothing"),
        tuple(rows),
        (chart,),
        "A note.",
        {"limit": np.inf},
    )


def broken(run):
    raise ZeroDivisionError("no way")


def silent(run):
    return None


def test_it_is_in_text_json_and_page(register, tmp_path):
    for analysis in (largest, broken, silent):
        register(analysis)
    network, records = fitted("tiny", "global").value, data()
    found = jnx.report(network, records, stability=False, diagnostics=False)
    assert list(found.sections) == ["largest", "broken"]
    (channel,) = network.output_channels
    row = found.pooled_row(channel.name)
    run = jnx.simulate(network, records).value
    error = [
        np.abs(r.y[:, 0] - y[:, 0])[s[:, 0]]
        for r, y, s in zip(records, run.outputs, run.scored, strict=True)
    ]
    worst = max(e.max() for e in error)
    text = str(found)
    assert "Largest <errors>" in text and "It is & stays small." in text
    assert f"{worst:.4g}" in text
    assert "The analysis 'broken' failed: ZeroDivisionError: no way" in text
    told = json.loads(json.dumps(found.to_dict()))["sections"]
    assert told["largest"]["title"] == "Largest <errors>"
    assert told["largest"]["limit"] == "inf"
    (line,) = told["largest"]["table"]
    assert line == {"output": channel.name, "largest": worst, "nothing": None}
    assert row.rmse is not None and row.rmse <= worst
    found.to_html(tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count("Largest &lt;errors&gt;") == 2  # heading, and link to it
    assert "<errors>" not in page and "A note." in page
    assert page.count('aria-label="section-largest A chart"') == 1


def test_without_analyses_a_report_has_no_sections():
    network, records = fitted("tiny", "global").value, data()
    found = jnx.report(network, records, stability=False, diagnostics=False)
    assert found.sections == {} and found.to_dict()["sections"] == {}


def test_errors_are_measured_minus_simulated_where_samples_count():
    network, records = fitted("tiny", "global").value, data()
    run = FreeRun.of(network, records)
    simulated = jnx.simulate(network, records).value
    assert len(run.errors(0)) == len(records)
    pairs = zip(records, simulated.outputs, simulated.scored, strict=True)
    for own, (record, y, scored) in zip(run.errors(0), pairs, strict=True):
        np.testing.assert_array_equal(np.isfinite(own), scored[:, 0])
        error = (record.y[:, 0] - y[:, 0])[scored[:, 0]]
        np.testing.assert_allclose(own[scored[:, 0]], error)
