"""A report as one offline HTML file: it runs, and reads well where scripts do not.

The verdict comes first, then records, the map of the error, scores, what one can try,
and equations, tests and provenance last. Figures are drawn beforehand; scripts put what
runs in their place on a screen (`jaxnarx.shell.report.page`). No address is named, and
the page's policy lets nothing in but its own scripts.

Everything that comes from data is escaped by jinja2 or by the SVG writer, or stands in
JSON and in strings of the model's script without any sign that could end them; the only
text marked safe here is built from such pieces.
"""

import dataclasses
import math
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup, escape

from jaxnarx.evaluation import (
    HOW_ESTIMATED,
    INDEX_EDGES,
    Chart,
    Picture,
    Report,
    Row,
    Section,
    name_data,
    region_sentence,
)
from jaxnarx.files import encodable, write_whole
from jaxnarx.formatting import ratio_text, span_text
from jaxnarx.shell.figures import report as figures
from jaxnarx.shell.figures import residuals
from jaxnarx.shell.figures.leaderboard import error_over_operations
from jaxnarx.shell.figures.partition import partition
from jaxnarx.shell.figures.svg import svg
from jaxnarx.shell.figures.tree import tree
from jaxnarx.shell.report.compiled import CompiledTemplates
from jaxnarx.shell.report.overview import overview
from jaxnarx.shell.report.page import make_page

MAX_RECORDS = 400
"""Records listed per part; a page should stay readable, the JSON holds them all."""

STATIC_POINTS = 600
"""Of a line over time that is drawn beforehand."""

CANDIDATES_SHOWN = 10
"""Candidates of a search that are shown at once; the others are folded away."""

MAX_PANELS = 48
"""Records of an output that are drawn; the worst, the median and the best are among
them."""

POINT_BUDGET = 30_000
"""Points of all lines over time together: about 0.5 MB of SVG."""


def write_report(report: Report, path: str | os.PathLike[str]) -> None:
    """Write the page to `path`, whole or not at all. The folder must exist."""
    write_whole(Path(path), encodable(render(report)).encode("utf-8"))


def render(report: Report) -> str:
    """The page as text."""
    environment = jinja2.Environment(
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
        loader=jinja2.PackageLoader("jaxnarx.shell.report", "templates"),
        bytecode_cache=CompiledTemplates(),
    )
    environment.filters |= {"figure": figure_text, "term": term_html, "span": _span}
    environment.filters |= {"data_of": name_data, "ratio": _ratio, "code": code_html}
    live, findings = make_page(report), report.findings
    page = environment.get_template("report.html.jinja").render(
        report=report,
        running=live,
        needed=_needed_inputs(report),
        jumps=_jumps(report),
        verdict=overview(report),
        findings=findings,
        scores=_scores(report),
        models=_models(report),
        boards=_boards(report),
        pictures=_pictures(report, findings),
        provenance=_flatten(report.provenance),
        max_records=MAX_RECORDS,
        fitted=HOW_ESTIMATED,
    )
    return _insert_contents(page)


def _needed_inputs(report: Report) -> list[str]:
    """Names of the inputs that a file has to have."""
    channels = getattr(report.network, "channels", None)
    return [] if channels is None else list(channels.input_names)


def _jumps(report: Report) -> list[tuple[int, int, int, int] | None]:
    """The stretches with the largest error: record, samples, output."""
    names = {(r.part, r.name): n for n, r in reversed(list(enumerate(report.records)))}
    order = [channel.name for channel in report.outputs]
    step = float(getattr(report.network, "sample_time", 1.0))
    found = []
    for one in report.worst:
        record = names.get((report.main, one.record))
        ends = round(one.start / step), round(one.end / step)
        at = order.index(one.output)
        found.append(None if record is None else (record, *ends, at))
    return found


def figure_text(value: float | int | None, digits: int = 4) -> Markup:
    """A number for people: true minus, powers of ten raised, infinity as its sign;
    whole numbers as they are."""
    if value is None:
        return Markup("–")
    if isinstance(value, int):
        return Markup(str(value).replace("-", "−"))
    if not math.isfinite(value):
        return Markup("∞" if value > 0 else "−∞") if value == value else Markup("–")
    mantissa, _, exponent = f"{value:.{digits}g}".partition("e")
    text = mantissa.replace("-", "−")
    if exponent:
        text += f"&thinsp;·&thinsp;10<sup>{str(int(exponent)).replace('-', '−')}</sup>"
    return Markup(text)


def _ratio(value: float | None) -> Markup:
    """An NRMSE: `1.00` for 1."""
    if value is not None and f"{value:.3g}" in map(str, range(1, 100)):
        return Markup(ratio_text(value))
    return figure_text(value, 3)


def _span(stretch: Any) -> tuple[str, str]:
    """Begin and end of a stretch of time."""
    return span_text(stretch.start, stretch.end)


def code_html(text: str) -> Markup:
    """A text whose words between backquotes are code."""
    return Markup(re.sub(r"`([^`]*)`", r"<code>\1</code>", str(escape(text))))


def term_html(name: str) -> Markup:
    """`speed[t-1]^2*load[t]` set with lags as subscripts and powers raised."""
    text = str(escape(name))
    text = re.sub(
        r"\[t(?:\s*-\s*(\d+))?\]",
        lambda m: f"<sub>t{'−' + m[1] if m[1] else ''}</sub>",
        text,
    )
    text = re.sub(r"(?<=</sub>)\^(\d+)", r"<sup>\1</sup>", text)
    return Markup(text.replace("</sub>*", "</sub> · ").replace("</sup>*", "</sup> · "))


def _scores(report: Report) -> dict[str, Any]:
    """Rows by part, output and record, modes side by side; pooled rows apart."""
    table: dict[tuple[str, str, str], list[Row]] = {}
    for row in report.rows:
        table.setdefault((row.part, row.output, row.record), []).append(row)
    lines = list(table.values())
    order = [channel.name for channel in report.outputs]
    pooled = [g for g in lines if g[0].record == "pooled"]
    pooled.sort(key=lambda group: order.index(group[0].output))
    single = [g for g in lines if g[0].record != "pooled"]
    by_part = {p: [g for g in single if g[0].part == p] for p in report.parts}
    return {"pooled": pooled, "records": by_part}


def _boards(report: Report) -> list[dict[str, Any]]:
    """The leaderboard of every output: its words, its first rows and all of them."""
    boards = []
    for output, entry in (report.leaderboard or {}).items():
        region = region_sentence(report.regions, output, report.main)
        boards.append(
            {
                "output": output,
                "text": [*entry["text"], *([region] if region else [])],
                "top": [
                    row
                    for row in entry["rows"]
                    if row["rank"] <= CANDIDATES_SHOWN
                    or row["used"]
                    or row in _linear(entry)
                ],
                "rows": entry["rows"],
                "groups": list(entry["rows"][0]["groups"]) if entry["rows"] else [],
            }
        )
    return boards


def _linear(entry: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The best linear candidates."""
    return [row for row in entry["rows"] if row["linear"]][:2]


def _models(report: Report) -> list[dict[str, Any]]:
    """The local models of every output, and coefficients by term and model."""
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for equation in report.equations:
        groups.setdefault(str(equation["output"]), []).append(equation)
    out = []
    for output, equations in groups.items():
        columns = [{str(n): float(c) for n, c in e["terms"]} for e in equations]
        names = dict.fromkeys(name for column in columns for name in column)
        out.append(
            {
                "output": output,
                "adds": output in _adding_outputs(report.network),
                "regions": [_region_text(e.get("region", "")) for e in equations],
                "numbers": [e.get("model", i + 1) for i, e in enumerate(equations)],
                "terms": [(n, [c.get(n) for c in columns]) for n in names],
                "latex": [str(e.get("latex", "")) for e in equations],
            }
        )
    return out


def _adding_outputs(network: Any) -> set[str]:
    """Outputs whose local models add up instead of sharing a weight of one."""
    pairs = zip(
        getattr(network, "computed_names", ()),
        getattr(network, "models", ()),
        strict=False,
    )
    return {name for name, m in pairs if not getattr(m.validity, "sums_to_one", True)}


def _region_text(value: object) -> str:
    """A region as a sentence fragment, whatever form the network gives it."""
    if value is None:
        return ""
    if isinstance(value, Mapping) and set(value) == {"centre", "width"}:
        return f"about {_region_text(value['centre'])} ± {_region_text(value['width'])}"
    if isinstance(value, Mapping) and value and set(value) <= {"above", "below"}:
        if len(value) == 2:
            return (
                f"from {_region_text(value['above'])} to {_region_text(value['below'])}"
            )
        return " ".join(
            f"{side} {_region_text(level)}" for side, level in value.items()
        )
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_region_text(item)}" for key, item in value.items())
    if isinstance(value, list | tuple | np.ndarray):
        return "(" + ", ".join(_region_text(item) for item in value) + ")"
    if isinstance(value, float | np.floating):
        return f"{value:.4g}"
    return str(value)


def _pictures(
    report: Report, findings: Mapping[str, Section]
) -> dict[str, list[tuple[str, Markup]]]:
    """(title, safe SVG text) of every figure by section; a trace holds its title."""
    ranked = [trace for trace in report.traces if trace.rank]
    lines = (4 if not report.coverage else 6) * max(len(ranked), 1)
    points = min(max(POINT_BUDGET // lines, 200), STATIC_POINTS)
    drawn: dict[str, list[tuple[str, Picture]]] = {
        "leaderboard": [
            (output, error_over_operations(entry))
            for output, entry in (report.leaderboard or {}).items()
        ],
        "traces": [("", _trace(t, points)) for t in ranked],
        "records": [
            (
                f"{c.name}, every record",
                figures.draw_record_panels(own[:MAX_PANELS]),
            )
            for c in report.outputs
            for own in [[t for t in report.traces if t.output.name == c.name]]
            if len(own) > 1
        ],
        "domain": [
            (e.output, figures.error_by_index(e, INDEX_EDGES))
            for e in (report.domain.errors if report.domain else ())
        ],
        "maps": [(m.output, figures.error_map(m)) for m in report.maps],
        "residuals": [(r.output.name, _agreement(r)) for r in report.residuals],
        "selection": [
            (title, _selection(item))
            for title, item in _pair_outputs(report.selection, "names")
        ],
        "history": [],
        "diagnostics": [],
        "partition": [
            picture
            for title, item in _pair_outputs(report.partition, "scheduling")
            for picture in _partition(title, item)
        ],
    }
    for kind, sections in (("section", report.sections), ("finding", findings)):
        for name, section in sections.items():
            drawn[f"{kind}-{name}"] = [_title_picture(one) for one in section.charts]
    if report.diagnostics is not None:
        drawn["diagnostics"] = residuals.figures(report.diagnostics.outputs)
    if report.history:
        drawn["history"] = [("", figures.refinement(list(report.history)))]
    return {
        section: [
            (
                title,
                Markup(svg(figure, f"{section}{i}-", f"{section} {title}".strip())),
            )
            for i, (title, figure) in enumerate(items)
        ]
        for section, items in drawn.items()
    }


def _title_picture(one: Chart | Picture) -> tuple[str, Picture]:
    """A chart alone has its title above the figure."""
    if isinstance(one, Picture):
        return "", one
    return one.title, Picture((dataclasses.replace(one, title=""),))


def _caption(trace: Any) -> str:
    how = "diverged" if trace.rmse is None else f"RMSE {trace.rmse:.4g}"
    stated = trace.rmse is not None and trace.output.unit not in ("", "-", "1")
    unit = f" {trace.output.unit}" if stated else ""
    return f"{trace.output.name}, {trace.rank} record, {trace.record}: {how}{unit}"


def _trace(trace: Any, points: int) -> Picture:
    return figures.draw_free_run(
        trace.time,
        trace.measured,
        trace.simulated,
        label=trace.output.label,
        title=_caption(trace),
        one_step=trace.one_step,
        limited=trace.limited,
        scored=trace.scored,
        lower=trace.lower,
        upper=trace.upper,
        points=points,
    )


def _agreement(item: Any) -> Picture:
    return figures.agreement(
        item.measured,
        item.simulated,
        item.counts,
        item.edges,
        label=item.output.label,
        unit=item.output.unit,
    )


def _selection(item: Mapping[str, Any]) -> Picture:
    return figures.selection_path(
        [str(n) for n in item["names"]],
        item["err"],
        item.get("cumulative"),
        criteria=item.get("criteria"),
    )


def _partition(title: str, item: Mapping[str, Any]) -> list[tuple[str, Picture]]:
    """The regions and, of a tree that is not the whole picture already, its gates."""
    drawn = [(title, partition(item))]
    if "gates" in item["after"] and "weights" in item["after"]:
        drawn.append((f"{title} tree".strip(), tree(item)))
    return drawn


def _pair_outputs(
    value: Mapping[str, Any] | None, key: str
) -> list[tuple[str, Mapping[str, Any]]]:
    """(output, entry) pairs; a flat entry, known by `key`, stands for all outputs."""
    if not value:
        return []
    return [("", value)] if key in value else list(value.items())


PROFILE_WORDS = {
    "dead_time": "dead time in samples:",
    "rise": "rise time in samples:",
    "memory": "memory in samples:",
    "few_levels": "inputs of few values:",
    "every": "of the samples used every",
}
"""What a search has seen in the data, in words."""


def _flatten(value: Mapping[str, Any]) -> list[tuple[str, str]]:
    """A line for every entry, and for every part of one that has parts."""
    rows = []
    for key, item in value.items():
        parts = item if isinstance(item, Mapping) else {}
        if parts and all(isinstance(part, Mapping) for part in parts.values()):
            rows += [
                (f"{key}, {name}", _pairs_text(part)) for name, part in parts.items()
            ]
        else:
            rows.append((key, _pairs_text(parts) if parts else _region_text(item)))
    return rows


def _pairs_text(item: Mapping[str, Any]) -> str:
    """`dead time in samples: speed 2, load 0; memory in samples: 40`."""
    known = {
        PROFILE_WORDS.get(key, key): _region_text(part) for key, part in item.items()
    }
    return "; ".join(f"{key} {words or 'none'}" for key, words in known.items())


CONTENTS_MARK = "<!-- contents -->"
"""Where the table of contents stands."""


def _insert_contents(page: str) -> str:
    """The page with a link to every heading behind the first lines.

    Headings are texts of the templates and titles of sections, escaped by jinja2.
    """
    top, mark, body = page.partition(CONTENTS_MARK)
    if not mark:
        return page
    body, script, scripts = body.partition("<script")
    titles: list[str] = []

    def number_title(found: re.Match[str]) -> str:
        titles.append(found[1])
        return f'<h2 id="section-{len(titles)}">{found[1]}</h2>'

    body = re.sub(r"<h2>([^<]*)</h2>", number_title, body)
    links = [
        f'<a href="#section-{n}"{LIVE_CLASS if title == TRY_TITLE else ""}>{title}</a>'
        for n, title in enumerate(titles, 1)
    ]
    contents = f'<nav class="contents" aria-label="Contents">{" ".join(links)}</nav>'
    return top + contents + body + script + scripts


TRY_TITLE, LIVE_CLASS = "Try the model", ' class="live"'
"""The section that needs scripts, and how it is hidden without them."""
