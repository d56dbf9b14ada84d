"""The page: offline, escaped, legible without scripts, written whole."""

import dataclasses
import html.parser
import re

import numpy as np
import pytest

from jaxnarx.data import Channel
from jaxnarx.evaluation import Report, Residuals, Row, Trace
from jaxnarx.refinement._stability import Bound, Place, Poles, Stability
from jaxnarx.shell.report.html import figure_text, render, term_html, write_report

EVIL = "<script>alert(1)</script>"


def row(output, mode, record="pooled", part="test", status="ok", **more):
    figures = dict(rmse=1.5e-7, nrmse=0.2, r2=0.96, fit=80.0, nmse=0.04)
    if status.startswith("diverged"):
        figures = dict.fromkeys(figures)
    counts = dict(samples=100, limited=0, extrapolated=3)
    base = dict(part=part, output=output, unit="ppm", mode=mode, record=record)
    return Row(**(base | figures | counts | {"status": status} | more))  # pyright: ignore


def stability(name, record):
    place = Place(record, 3, 0.3, {name: 1.0})
    bound = Bound(
        "sampled", False, 1.1, 0.9, 2.0, 0.2, {name: (0.0, 1.0)}, place, 50, 90
    )
    poles = Poles(name, 1, 50, 0.5, 0.9, 1.1, 0.02, 0.14)
    return Stability((poles,), (bound,), 0.1)


def make(name="NOx", record="r1", samples=50):
    channel = Channel(name, "ppm" if name == "NOx" else name)
    t = np.arange(samples) * 0.1
    y, off = np.sin(t), np.zeros(samples, bool)
    trace = Trace(channel, record, "worst", 0.1, t, y, y + 0.1, y, off, ~off)
    counts, edges = np.histogram(y, 5)
    rows = [
        row(name, mode, rec) for rec in ("pooled", record) for mode in ("one step",)
    ] + [row(name, "free run", rec) for rec in ("pooled", record)]
    terms = [(f"{name}[t-1]^2*{name}[t]", -2e-5), ("1", 3.0)]
    return Report(
        outputs=(channel,),
        main="test",
        rows=tuple(rows),
        notes=(f"note about {name}",),
        traces=(trace,),
        residuals=(Residuals(channel, 0.0, 1.0, counts, edges, y, y),),
        equations=(
            {"output": name, "model": 0, "region": name, "terms": terms, "latex": name},
            {"output": name, "model": 1, "region": "", "terms": [("1", 4.0)]},
        ),
        selection={name: {"names": [name, "b"], "err": [0.9, 0.05]}},
        history=[{"iteration": 0, "stage": name, "loss": 1.0}],
        partition={
            "scheduling": [name],
            "ranges": [(0.0, 1.0)],
            "after": {
                "regions": [{name: {"below": 0.4}}, {name: {"above": 0.4}}],
                "weights": np.array([[1.0, 0.9, 0.0], [0.0, 0.1, 1.0]]),
            },
        },
        cost={name: {"models": 2, "multiplications": 123456}},
        stability=stability(name, record),
        provenance={"command": name, "versions": {"numpy": np.__version__}},
    )


class Names(html.parser.HTMLParser):
    """Collects tags, identifiers and every address the page names."""

    def __init__(self):
        super().__init__()
        self.tags, self.ids, self.addresses = [], [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        for key, value in attrs:
            if key == "id":
                self.ids.append(value)
            if key in ("href", "src", "xlink:href"):
                self.addresses.append(value)


def parsed(page):
    names = Names()
    names.feed(page)
    return names


def test_channel_names_are_escaped_everywhere_also_inside_figures():
    page = render(make(EVIL, record=EVIL))
    names = parsed(page)
    assert "script" not in names.tags and "<script" not in page
    svgs = re.findall(r"<svg.*?</svg>", page, flags=re.S)
    assert len(svgs) == 5
    assert any("&lt;script&gt;alert(1)" in s.split(">", 1)[1] for s in svgs)
    assert page.count("&lt;script&gt;") > 15


def test_the_page_is_offline():
    page = render(make())
    names = parsed(page)
    pixels = r"data:image/png;base64,[\w+/=\s]+"  # any letters, so // as well
    assert not re.search(r"https?:|//[a-z]", re.sub(pixels, "", page))
    assert not {"script", "link", "iframe", "img", "object"} & set(names.tags)
    assert all(a.startswith(("#", "data:image/png")) for a in names.addresses)
    assert len(names.ids) == len(set(names.ids))
    local = [a[1:] for a in names.addresses if a.startswith("#")]
    assert set(local) <= set(names.ids)


def test_every_section_is_there_and_optional_ones_may_be_absent():
    full = render(make())
    bare = render(
        dataclasses.replace(
            make(),
            selection=None,
            history=None,
            partition=None,
            cost=None,
            stability=None,
            equations=(),
            notes=(),
        )
    )
    for title in ("Scores", "Where it can be trusted", "Provenance", "Residuals"):
        assert title in full and title in bare
    for title in (
        "The equations",
        "How the terms",
        "Refinement of",
        "Operating",
        "What a sample costs",
        "Stability",
    ):
        assert title in full and title not in bare


def test_divergence_is_said_and_no_figure_is_made_up():
    base = make()
    status = "diverged (1 of 2)"
    others = dict(rmse=1.0, nrmse=0.123, r2=0.9, fit=70.0, nmse=0.1)
    rows = [r for r in base.rows if r.mode == "one step"] + [
        row("NOx", "free run", status=status, others=others),
        row("NOx", "free run", "r1", status="diverged"),
    ]
    page = render(dataclasses.replace(base, rows=tuple(rows)))
    assert "✕" in page and "Not usable: " in page
    assert "the free run of NOx on test diverges in r1" in page
    assert status in page and "NRMSE 0.123" in page
    assert not re.search(r"\bnan\b", page, flags=re.I)


def test_numbers_and_terms_are_set_for_people():
    assert figure_text(-1.5e-7) == "−1.5&thinsp;·&thinsp;10<sup>−7</sup>"
    assert figure_text(float("-inf")) == "−∞" and figure_text(None) == "–"
    got = term_html("a<b[t-1]^2*u[t]")
    assert got == "a&lt;b<sub>t−1</sub><sup>2</sup> · u<sub>t</sub>"


def test_regions_read_as_sentences():
    regions = [
        {"speed[t]": {"above": 1250.0, "below": 1450.0}},
        {"speed[t] - 0.3 load[t-1]": {"above": 2.0}, "load[t]": {"below": 1.0}},
        {"load[t]": {"centre": 3.0, "width": 0.5}},
    ]
    equations = tuple(
        {"output": "NOx", "model": m, "region": region, "terms": [("1", 1.0)]}
        for m, region in enumerate(regions)
    )
    page = render(dataclasses.replace(make(), equations=equations))
    speed, load = "speed<sub>t</sub>", "load<sub>t</sub>"
    assert re.findall(r"<dd>(.*?)</dd>", page)[:3] == [
        f"{speed} from 1250 to 1450",
        f"{speed} - 0.3 load<sub>t−1</sub> above 2, {load} below 1",
        f"{load} about 3 ± 0.5",
    ]


def test_a_tree_has_its_map_and_its_list_of_gates():
    regions = [{EVIL: {"below": 0.4}}, {EVIL: {"above": 0.4}}]
    side = {"regions": regions, "gates": [{EVIL: {"above": 0.4}}], "path": [[-1], [1]]}
    entry = {"scheduling": [EVIL], "ranges": [(0.0, 1.0)], "after": side}
    listed = render(dataclasses.replace(make(), partition={"NOx": entry}))
    drawn = side | {"weights": np.array([[1.0, 0.2], [0.0, 0.8]])}
    both = entry | {"after": drawn, "before": drawn}
    page = render(dataclasses.replace(make(), partition={"NOx": both}))
    assert "<script" not in page and "NOx tree" in page and "NOx tree" not in listed
    for condition in ("&lt; 0.4", "&gt; 0.4"):
        gate = "&lt;script&gt;alert(1)&lt;/script&gt; " + condition
        assert listed.count(gate) == 1 and page.count(gate) == 2


def test_the_file_is_whole_small_and_the_same_each_time(tmp_path):
    path = tmp_path / "r.html"
    big = make(samples=100_000)
    write_report(big, path)
    first = path.read_bytes()
    big.to_html(path)
    assert path.read_bytes() == first and len(first) < 500_000
    assert [p.name for p in tmp_path.iterdir()] == ["r.html"]


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "r.html"
    path.write_text("old")

    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr("os.replace", fail)
    with pytest.raises(OSError, match="disk full"):
        write_report(make(), path)
    assert path.read_text() == "old"


def test_provenance_is_in_words():
    look = {"dead_time": {"u": 2, "v": 0}, "memory": 40, "few_levels": [], "every": 1}
    told = {"seen in the data": {"y": look}, "versions": {"numpy": "2", "jax": "1"}}
    page = render(dataclasses.replace(make(), provenance=told))
    assert "<dt>seen in the data, y</dt>" in page
    words = "dead time in samples: u 2, v 0; memory in samples: 40; inputs of few"
    assert words in page and "numpy 2; jax 1" in page


def test_a_ratio_of_one_is_no_number_of_a_candidate():
    base = make()
    rows = [dataclasses.replace(r, nrmse=1.0) for r in base.rows]
    page = render(dataclasses.replace(base, rows=tuple(rows)))
    assert '<div class="big">1.00</div>' in page and "<td>1.00</td>" in page


def test_templates_are_compiled_once_and_a_spoilt_cache_is_no_matter(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first = render(make())
    kept = sorted((tmp_path / "jaxnarx" / "pages").iterdir())
    assert len(kept) > 5
    times = [path.stat().st_mtime_ns for path in kept]
    assert render(make()) == first
    assert [path.stat().st_mtime_ns for path in kept] == times
    kept[0].write_bytes(kept[0].read_bytes()[:40])
    kept[1].unlink()
    kept[1].mkdir()  # can be neither read nor written
    assert render(make()) == first
    monkeypatch.setenv("XDG_CACHE_HOME", str(kept[0]))  # a file
    assert render(make()) == first
