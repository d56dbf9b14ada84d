"""The page at work in a real browser, from a file: what it does, and that it asks for
nothing and lets nothing in."""

import base64
import dataclasses
import hashlib
import json
import re
import zlib
from pathlib import Path

import common
import numpy as np
import pytest
from browser import Browser, needs_browser
from common import some
from search_fakes import board
from test_html import make

import jaxnarx as jnx
from jaxnarx.data import Channel, Channels, Dataset
from jaxnarx.evaluation import Report, ShownRecord, report
from jaxnarx.identification import describe
from jaxnarx.shell.report.html import render, write_report
from jaxnarx.shell.report.page import make_page
from jaxnarx.shell.report.page.codec import (
    COARSE_LEVELS,
    FINE_LEVELS,
    MIDDLE_LEVELS,
    pack,
)
from jaxnarx.shell.report.page.records import MAX_INDEX_SHOWN, choose_records
from jaxnarx.simulation import simulate

READY = "window.jaxnarx && jaxnarx.page.tried"


RANGE = np.array([-1.5, -0.3, -6.0, -2.0]), np.array([1.2, 0.4, 5.0, 2.5])
"""Ranges that some of the inputs and outputs leave."""


def renamed(data: Dataset, names: list[str]) -> Dataset:
    records = zip(data, names, strict=True)
    return dataclasses.replace(
        data, records=tuple(dataclasses.replace(r, name=n) for r, n in records)
    )


@pytest.fixture(scope="module")
def made() -> Report:
    """Three test records, of which inputs leave the range; a linear model and another
    beside it."""
    low, high = map(common.device, RANGE)
    net = dataclasses.replace(common.named("coupled"), low=low, high=high)
    other = common.named("one model")
    test = renamed(common.dataset((400, 300, 350), seed=3), ["r1", "r2", "r3"])
    train = renamed(common.dataset((400,), seed=9), ["t1"])
    parts = {"train": train, "test": test}
    found = report(net, parts, beside={"another": other}, **common.BRIEF)
    return dataclasses.replace(found, next_command="jaxnarx simulate m new.csv")


@pytest.fixture(scope="module")
def page(made, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("page") / "report.html"
    write_report(made, path)
    return path


@pytest.fixture(scope="module")
def browser():
    with Browser() as one:
        yield one


@pytest.fixture
def opened(browser, page):
    """The page as it is opened from its file, in a window of 1200 by 900."""
    browser.send(
        "Emulation.setDeviceMetricsOverride",
        **{"width": 1200, "height": 900, "deviceScaleFactor": 1, "mobile": False},
    )
    browser.open(page, ready=READY)
    yield browser
    assert browser.errors() == []
    asked = browser.requests()
    assert asked[0] == page.as_uri()
    assert all(address.startswith("data:image/png") for address in asked[1:])


# what stands in the file ------------------------------------------------------------


def scripts(text: str) -> list[str]:
    return re.findall(r"<script>(.*?)</script>", text, flags=re.S)


def test_the_policy_names_the_scripts_and_nothing_else(page):
    text = page.read_text("utf-8")
    (policy,) = re.findall(r'Content-Security-Policy" content="(.*?)"', text)
    inside = [
        base64.b64encode(hashlib.sha256(s.encode()).digest()).decode()
        for s in scripts(text)
    ]
    assert len(inside) == 3
    allowed = re.findall(r"sha256-([\w+/=]+)", policy)
    assert allowed == inside
    assert policy.startswith("default-src &#39;none&#39;; script-src &#39;sha256-")
    assert "http" not in policy and "*" not in policy
    assert not re.search(r"https?:|@import|<link|<iframe|<object", text)
    assert not re.search(r"\bfetch\(|XMLHttp|WebSocket|\beval\(", text)


def test_a_page_without_records_has_no_script():
    text = render(make())
    assert "<script" not in text
    assert "script-src &#39;none&#39;" in text


def decoded(block: dict, samples: int) -> dict[str, np.ndarray]:
    """What `packed` wrote, read another way."""
    data = np.frombuffer(zlib.decompress(base64.b64decode(block["text"])), np.uint8)
    found = {}
    for n, (name, low, step) in enumerate(block["series"]):
        part = data[2 * samples * n : 2 * samples * (n + 1)].astype(int)
        code = np.cumsum(part[:samples] + 256 * part[samples:]) % 65536
        found[name] = np.where(code == 65535, np.nan, low + step * code)
    return found


def test_series_come_back_within_half_a_level():
    rng = np.random.default_rng(0)
    noise = rng.normal(size=500)
    gaps = np.where(noise > 1, np.nan, noise)
    values = {
        "noise": 1e-300 * noise,
        "large": 8e307 * np.sign(noise),
        "gaps": gaps,
        "same": np.full(500, 0.3),
        "none": np.full(500, np.inf),
    }
    block = pack(
        [(name, FINE_LEVELS, value) for name, value in values.items()], FINE_LEVELS
    )
    found = decoded(block, 500)
    for name in ("noise", "large"):
        off = np.abs(found[name] - values[name])
        assert off.max() <= 0.5001 * np.ptp(values[name]) / FINE_LEVELS, name
    np.testing.assert_allclose(found["gaps"], gaps, atol=0.5001 * np.nanmax(gaps) * 8)
    assert (np.isnan(found["gaps"]) == np.isnan(gaps)).all()
    assert (found["same"] == 0.3).all() and np.isnan(found["none"]).all()


def long(samples: int, seed: int) -> ShownRecord:
    """Noise that does not compress, and one large error."""
    rng = np.random.default_rng(seed)
    y = rng.normal(size=samples)
    run = y[:, None] + 0.1 * rng.normal(size=(samples, 1))
    run[samples // 3] += 5.0 * (1 + seed)
    all_of_it = np.ones((samples, 1), bool)
    index = np.full(samples, 0.5)
    index[7] = 99.0
    signals = {"u": rng.normal(size=samples), "y": y}
    return ShownRecord(
        "test", f"r{seed}", signals, run, all_of_it, ~all_of_it, index=index
    )


def test_records_that_do_not_fit_are_reduced_and_it_is_told():
    records = [long(6000, seed) for seed in range(4)]
    for limit, levels in (
        (10**9, FINE_LEVELS),
        (160_000, MIDDLE_LEVELS),
        (140_000, COARSE_LEVELS),
    ):
        one = choose_records(records, limit)
        assert f"1/{levels:,} of" in one.told and not any(
            r["bins"] for r in one.records
        )
    assert f"1/{MIDDLE_LEVELS:,} in the 1 of 4" in one.told
    few = choose_records(records, 95_000)
    assert sum(len(json.dumps(r)) for r in few.records) < 100_000
    whole = [r["name"] for r in few.records if not r["bins"]]
    assert whole == ["r3"] and "1 of 4 records" in few.told  # the largest error
    one = few.records[0]
    drawn = decoded(one["data"], 2 * one["bins"])
    off = records[0].signals["y"] - records[0].simulated[:, 0]
    assert drawn["r0"].min() == pytest.approx(off.min(), rel=1e-3)
    assert drawn["i"].max() == MAX_INDEX_SHOWN
    first, length = one["first"], one["length"]
    assert first <= 2000 < first + length
    stretch = decoded(one["stretch"], length)
    np.testing.assert_allclose(
        stretch["y0"], records[0].simulated[first : first + length, 0], atol=2e-4
    )


# what it does -----------------------------------------------------------------------


@needs_browser
def test_it_opens_from_its_file_with_the_worst_record(opened, made):
    assert opened.value("location.protocol") == "file:"
    errors = [r.error(0) for r in made.records if r.part == "test"]
    worst = int(np.argmax(errors))
    assert opened.value("jaxnarx.page.number") == worst
    told = opened.value("document.getElementById('record-told').textContent")
    assert f"RMSE {errors[worst]:.4g}"[:9] in told and "outside" not in told
    assert opened.value("document.querySelectorAll('#charts canvas').length") == 3
    assert opened.value(
        "getComputedStyle(document.querySelector('.static')).display"
    ) == ("none")


@needs_browser
def test_samples_in_the_page_are_those_of_the_report(opened, made):
    record = made.records[1]
    got = opened.value(
        "jaxnarx.page.open(1).then(() => { const s = jaxnarx.page.view.shown;"
        "return [[...s.measured[0]], [...s.simulated[1]], [...s.others[1].runs[0]]] })"
    )
    kept = record.signals["y"], record.simulated[:, 1], record.others["another"][:, 0]
    for ours, theirs in zip(kept, got, strict=True):
        theirs = np.array(theirs, float)
        assert np.abs(theirs - ours).max() <= 0.51 * np.ptp(ours) / FINE_LEVELS


def range_of(browser: Browser) -> list[float]:
    """What the three charts show, which is one range."""
    ranges = browser.value(
        "jaxnarx.page.view.charts.map((c) => [c.scales.x.min, c.scales.x.max])"
    )
    assert ranges[0] == ranges[1] == ranges[2]
    return ranges[0]


TICKS = [
    (0.0, 0.0005, "0.0000"),
    (0.0005, 0.0005, "0.0005"),
    (-0.0015, 0.0005, "−0.0015"),
    (12.34567, 0.00001, "12.34567"),
    (0.25, 0.25, "0.25"),
    (1500, 500, "1500"),
    (-0.0, 0.1, "0.0"),
    (2e-9, 1e-9, "2e−9"),
    (3e8, 1e8, "300000000"),
]


@needs_browser
def test_ticks_of_fast_data_are_told_apart(browser, made, tmp_path):
    """At 1e-5 s ticks that were 0.0005 s apart stood as 0, 0.001, 0.001, 0.002."""
    for value, step, text in TICKS:
        assert browser_text(browser, value, step, made, tmp_path) == text
    labels = browser.value("jaxnarx.page.view.charts.map((c) => c.axes[0]._values)")
    for row in labels:
        times = [float(text.replace("−", "-")) for text in row]
        assert len(times) > 3 and np.all(np.diff(times) > 0)
        np.testing.assert_allclose(np.diff(times), times[1] - times[0], rtol=1e-6)
    across = browser.value("jaxnarx.page.view.charts[0].axes[1]._values")
    assert len(set(across)) == len(across)


def browser_text(browser, value, step, made, tmp_path) -> str:
    """What the page of data at 1e-5 s prints at a tick."""
    path = tmp_path / "fast.html"
    if not path.exists():
        network = dataclasses.replace(
            made.network, sample_time=common.device(np.array(1e-5))
        )
        write_report(dataclasses.replace(made, network=network), path)
        browser.open(path, ready=READY)
    return browser.value(f"jaxnarx.tickText({value}, {step})")


@needs_browser
def test_zoom_and_pan_by_mouse_and_keys_are_linked(opened):
    all_of_it = range_of(opened)
    left, top, width, height = opened.box("#chart-main .u-over")
    middle = top + height / 2
    opened.drag((left + 0.25 * width, middle), (left + 0.5 * width, middle))
    near = range_of(opened)
    span = all_of_it[1] - all_of_it[0]
    assert near == pytest.approx([0.25 * span, 0.5 * span], abs=0.01 * span)
    shift = {"modifiers": 8}
    opened.drag((left + 0.5 * width, middle), (left + 0.7 * width, middle), **shift)
    moved = range_of(opened)
    assert moved[0] == pytest.approx(near[0] - 0.05 * span, abs=0.01 * span)
    assert np.ptp(moved) == pytest.approx(np.ptp(near), rel=1e-6)
    opened.value("document.getElementById('charts').focus()")
    opened.key("ArrowRight")
    assert range_of(opened)[0] > moved[0]
    opened.key("-")
    assert np.ptp(range_of(opened)) == pytest.approx(1.6 * np.ptp(near), rel=1e-6)
    opened.key("0")
    assert range_of(opened) == all_of_it
    for click in (1, 2):
        for kind in ("mousePressed", "mouseReleased"):
            opened.mouse(kind, left + 9, middle, clickCount=click)
    assert range_of(opened) == all_of_it


@needs_browser
def test_records_and_outputs_are_switched_and_traces_compared(opened, made):
    names = opened.value(
        "[...document.getElementById('choose-record').options].map((o) => o.text)"
    )
    assert [n.split(" ")[1] for n in names] == ["r1", "r2", "r3", "t1"]
    assert sum(n.endswith(", worst") for n in names) == 1
    before = opened.value("jaxnarx.page.number")
    opened.value("document.getElementById('next').click()")
    opened.wait(f"jaxnarx.page.number === {(before + 1) % 4}")
    switches = (
        "[...document.querySelectorAll('#legend label')].map((l) =>"
        "[l.textContent, l.querySelector('input').checked])"
    )
    opened.value("jaxnarx.page.open(0)")
    told = dict(opened.value(switches))
    assert told == {
        **{"measured": True, "free run": True},
        **{"linear, same lags": False, "another": False},
    }
    drawn = "jaxnarx.page.view.charts[0].series.map((s) => s.label)"
    assert "another" not in opened.value(drawn)
    opened.value("document.querySelectorAll('#legend input')[3].click()")
    assert "another" in opened.value(drawn)
    opened.value("jaxnarx.page.choose(1)")
    run = opened.value("jaxnarx.page.view.charts[0].data.map((d) => d[7])")
    assert run[2] == pytest.approx(made.records[0].simulated[7, 1], rel=1e-3)


@needs_browser
def test_the_map_leads_to_where_the_error_is(opened, made):
    map_ = made.maps[0]
    i, j = (int(k) for k in np.argwhere(map_.samples == map_.samples.max())[0])
    record, sample = map_.places[i, j].tolist()
    across, up = map_.samples.shape
    cells = "document.querySelectorAll('#map [role=gridcell]')"
    assert opened.value(f"{cells}.length") == across * up
    place = (up - 1 - j) * across + i
    label = opened.value(f"{cells}[{place}].getAttribute('aria-label')")
    assert f"{map_.samples[i, j]} samples" in label and "RMSE" in label
    opened.value(f"{cells}[{place}].click()")
    opened.wait(f"jaxnarx.page.view.mark === {sample} * jaxnarx.report.sample_time")
    assert opened.value("jaxnarx.page.number") == record
    low, high = range_of(opened)
    assert low <= 0.1 * sample <= high and high - low < 0.1 * 350
    # The error of the cell's largest sample is the largest of the cell.
    shown = made.records[record]
    off = abs(shown.signals["y"][sample] - shown.simulated[sample, 0])
    assert off >= map_.rms[i, j]
    opened.value(f"{cells}[0].focus()")
    opened.key("ArrowRight")
    opened.key("ArrowDown")
    at = opened.value(f"[...{cells}].indexOf(document.activeElement)")
    assert at == across + 1


@needs_browser
def test_stretches_lead_to_their_time(opened, made):
    buttons = "document.querySelectorAll('[data-jump]')"
    assert opened.value(f"{buttons}.length") == len(made.worst)
    one = made.worst[0]
    opened.value(f"{buttons}[0].click()")
    opened.wait("jaxnarx.page.view.mark !== null")
    low, high = range_of(opened)
    assert low <= one.start and one.end <= high
    names = [r.name for r in made.records]
    assert names[opened.value("jaxnarx.page.number")] == one.record


@needs_browser
def test_the_model_runs_here_as_in_the_report(opened):
    opened.value("jaxnarx.page.open(0)")
    opened.value("document.getElementById('compute-here').click()")
    told = opened.value("document.getElementById('cursor').textContent")
    share = float(re.findall(r"at most ([\d.e−-]+) %", told)[0].replace("−", "-"))
    assert share < 0.05  # of the range: inputs are rounded to 1/65,000


def csv_of(record: ShownRecord, mark: str = ",", point: str = ".") -> str:
    """With units in the names and the time; every digit."""
    length = len(record)
    time = 0.1 * np.arange(length)
    columns = {"time [s]": time, "A [V]": record.signals["a"]}
    columns |= {name: record.signals[name] for name in ("b", "y", "w")}
    lines = [mark.join(columns)]
    lines += [
        mark.join(repr(float(v)).replace(".", point) for v in row)
        for row in zip(*columns.values(), strict=True)
    ]
    return "\n".join(lines)


@needs_browser
@pytest.mark.parametrize(("mark", "point"), [(",", "."), (";", ",")])
def test_a_file_runs_as_simulate_does(opened, made, tmp_path, mark, point):
    record = made.records[1]
    file = tmp_path / "new.csv"
    file.write_text(csv_of(record, mark, point))
    document = opened.send("DOM.getDocument")["root"]["nodeId"]
    node = opened.send("DOM.querySelector", nodeId=document, selector="#file")
    opened.send("DOM.setFileInputFiles", nodeId=node["nodeId"], files=[str(file)])
    opened.wait("jaxnarx.page.files.length === 1 && jaxnarx.page.number === 4")
    got = opened.value("jaxnarx.page.view.shown.simulated.map((v) => [...v])")
    run = np.array(got, float).T
    start = record.start
    expected = record.simulated[start:]
    size = np.abs(expected).max(axis=0)
    assert (np.abs(run[start:] - expected) / size).max() < 1e-9
    told = opened.value("document.getElementById('file-told').textContent")
    assert "300 samples" in told and "begins from the measured outputs" in told
    outside = opened.value("[...jaxnarx.page.view.shown.outside].map((v) => v > 1)")
    (one,) = simulate(
        made.network, renamed(dataset_of(record), ["r"])
    ).value.extrapolated
    assert outside[start:] == one[start:].tolist() and any(outside)


def dataset_of(record: ShownRecord) -> Dataset:
    own = record.signals
    u, y = (np.stack([own[n] for n in names], 1) for names in (("a", "b"), ("y", "w")))
    known = common.CHANNELS
    return Dataset.from_arrays(
        u, y, inputs=known.inputs, outputs=known.outputs, sample_time=0.1
    )


DROP = """(() => {{ const data = new DataTransfer();
data.items.add(new File([{text}], 'new.csv'));
document.dispatchEvent(new DragEvent('drop', {{ dataTransfer: data, bubbles: true,
cancelable: true }})); }})()"""


@needs_browser
def test_a_file_that_is_dropped_and_one_that_is_wrong(opened):
    def told() -> str:
        return opened.value("document.getElementById('file-told').textContent")

    rest = "a,b\n" + "0.5,0.2\n" * 50
    opened.value(DROP.format(text=json.dumps(rest)))
    opened.wait("jaxnarx.page.files.length === 1")
    opened.wait("document.getElementById('file-told').textContent")
    assert "begins from the steady state" in told() and "no column of time" in told()
    run = opened.value("[...jaxnarx.page.view.shown.simulated[0]]")
    assert np.ptp(run) < 1e-5 * max(np.abs(run))  # it is where it rests
    for text, fault in (
        ("a,c\n1,2\n", "no column b"),
        ("1,2\n3,4\n", "has to name the columns"),
        ("a,b\n,1\n,1\n", "a column holds no number"),
        ("", "fewer than two lines"),
    ):
        opened.value(DROP.format(text=json.dumps(text)))
        opened.wait("document.getElementById('file-told').className === 'bad'")
        opened.wait(
            f"document.getElementById('file-told').textContent.includes({fault!r})"
        )
    assert opened.value("jaxnarx.page.files.length") == 1


@needs_browser
def test_an_input_is_moved_and_outputs_follow(opened, made):
    slider = "document.querySelectorAll('#sliders input[type=range]')[0]"
    opened.value(
        f"(() => {{ const s = {slider}; s.value = 700;"
        "s.dispatchEvent(new Event('input', {bubbles: true})); })()"
    )
    port = made.network
    low, high = (float(np.asarray(a)[0]) for a in (port.low, port.high))
    span = high - low
    value = low - 0.2 * span + 1.4 * span * 0.7
    opened.wait("Math.abs(jaxnarx.page.tried.found.to.y.length) === 2")
    opened.wait(f"Math.abs(jaxnarx.page.tried.now[0] - {value}) < 1e-9")
    opened.value("new Promise((done) => setTimeout(done, 100))")
    found = opened.value(
        "(({from, to, outputs}) => ({from: from.y, to: to.y, "
        "now: jaxnarx.page.tried.now,"
        "end: outputs.map((v) => v[v.length - 1]), begin: outputs.map((v) => v[0])}))"
        "(jaxnarx.page.tried.found)"
    )
    u = np.tile(found["now"], (2000, 1))
    data = Dataset.from_arrays(
        u,
        np.zeros((2000, 2)),
        inputs=common.CHANNELS.inputs,
        outputs=common.CHANNELS.outputs,
        sample_time=0.1,
    )
    rest = np.asarray(simulate(made.network, data).value[0])[-1]
    scale = np.abs(rest).max()
    np.testing.assert_allclose(found["to"], rest, atol=1e-5 * scale)
    np.testing.assert_allclose(found["begin"], found["from"], atol=1e-12)
    np.testing.assert_allclose(found["end"], rest, atol=2e-2 * scale)
    table = opened.value("document.getElementById('steady').textContent")
    assert "y [ppm]" in table
    opened.value("document.getElementById('take').click()")
    assert opened.value("jaxnarx.page.tried.start") == found["now"]


@needs_browser
def test_the_surface_is_the_steady_state(opened):
    opened.box("#surface")
    opened.wait("document.getElementById('surface').dataset.done")
    value, rest = opened.value(
        "(() => { const s = jaxnarx.page.surface; const r = jaxnarx.settle(s.program,"
        "s.inputs(20, 9)); return [s.values[9 * 32 + 20], r.y[0]]; })()"
    )
    assert value == pytest.approx(rest, rel=1e-6)
    before = opened.value("[...jaxnarx.page.surface.values.slice(0, 5)]")
    opened.value(
        "(() => { const s = document.getElementById('surface-output'); s.value = 1;"
        "s.dispatchEvent(new Event('change')); })()"
    )
    opened.wait("document.getElementById('surface').dataset.done")
    assert opened.value("[...jaxnarx.page.surface.values.slice(0, 5)]") != before
    opened.value("document.getElementById('surface').focus()")
    opened.key("ArrowUp")
    told = opened.value("document.getElementById('surface-told').textContent")
    assert told.startswith("a ") and "w " in told


# where it does not run --------------------------------------------------------------

SEEN = (
    "(s) => [...document.querySelectorAll(s)].filter((e) => e.checkVisibility()).length"
)


@needs_browser
def test_the_surface_has_ticks_and_a_scale_and_tells_empty_from_restless(opened):
    opened.box("#surface")
    opened.wait("document.getElementById('surface').dataset.done")
    low, high = RANGE[0][0], RANGE[1][0]
    ticks = opened.value(
        "['below', 'left'].map((side) => [...document.querySelectorAll("
        "'#surface-' + side + ' span')].map((s) => s.textContent))"
    )
    assert [len(side) for side in ticks] == [5, 5]
    ends = [float(ticks[0][n].replace("−", "-")) for n in (0, -1)]
    assert ends == pytest.approx([low, high], rel=1e-2)
    values = opened.value("[...jaxnarx.page.surface.values]")
    shown = [
        opened.value(f"document.getElementById('surface-{end}').textContent")
        for end in ("low", "high")
    ]
    told = [float(text.replace("−", "-")) for text in shown]
    assert told == pytest.approx([min(values), max(values)], rel=1e-3)
    words = opened.value(
        "(() => { const s = jaxnarx.page.surface; const n = 40;"
        "const out = [s.words('y', n)]; s.values[n] = NaN; out.push(s.words('y', n));"
        "s.seen[n] = 0; out.push(s.words('y', n)); return out; })()"
    )
    assert words[1].startswith("y does not come to rest")
    assert words[2] == "y not computed yet" and words[0].startswith("y ")


@needs_browser
def test_of_one_input_the_steady_state_is_a_curve(opened):
    opened.box("#surface")
    opened.value(
        "(() => { const s = document.getElementById('surface-second'); s.value = 0;"
        "s.dispatchEvent(new Event('change')); })()"
    )
    opened.wait("document.getElementById('surface').dataset.done")
    assert opened.value("document.getElementById('surface-map').hidden")
    x, y, rest = opened.value(
        "(() => { const s = jaxnarx.page.surface; const [x, y] = s.plot.data;"
        "return [[...x], [...y], jaxnarx.settle(s.program, s.inputs(5, 0)).y[0]]; })()"
    )
    assert len(x) == 32 and np.all(np.diff(x) > 0) and y[5] == pytest.approx(rest)


@needs_browser
def test_the_interval_lies_within_the_axis(browser, tmp_path):
    net = common.named("one model")

    def noisy(lengths, seed):
        data, rng = common.dataset(lengths, seed=seed), np.random.default_rng(seed)
        pairs = zip(data, simulate(net, data).value.outputs, strict=True)
        rows = [
            np.c_[r.u, y + rng.normal(0, 2.0, y.shape), r.y[:, 1:]] for r, y in pairs
        ]
        return common.from_rows(rows)

    net = jnx.confidence.fit_domain(net, noisy((300,), 0))
    net = jnx.confidence.fit_error_model(net, noisy((300, 300), 4))
    path = tmp_path / "interval.html"
    write_report(report(net, noisy((200,), 5), **common.BRIEF), path)
    browser.open(path, ready=READY)
    low, high, ends = browser.value(
        "(() => { const v = jaxnarx.page.view, s = v.shown, y = v.charts[0].scales.y;"
        "const h = s.half[0], m = s.simulated[0]; const fine = [...m.keys()].filter("
        "(t) => Number.isFinite(m[t]) && Number.isFinite(h[t]));"
        "return [y.min, y.max, [Math.min(...fine.map((t) => m[t] - h[t])),"
        "Math.max(...fine.map((t) => m[t] + h[t]))]]; })()"
    )
    assert low <= ends[0] and ends[1] <= high


@needs_browser
def test_a_leaderboard_fits_a_narrow_page(browser, made, tmp_path):
    path = tmp_path / "board.html"
    entry = {"y": describe(board("y"), "y")}
    write_report(dataclasses.replace(made, leaderboard=entry), path)
    size = {"width": 400, "height": 800, "deviceScaleFactor": 1, "mobile": False}
    browser.send("Emulation.setDeviceMetricsOverride", **size)
    browser.open(path, ready=READY)
    seen, wide = browser.value(
        "(() => { const t = document.querySelector('table.board');"
        "return [[...t.querySelectorAll('th')].filter((h) => h.offsetWidth)"
        ".map((h) => h.textContent), [t.scrollWidth, t.parentNode.clientWidth]]; })()"
    )
    assert seen == ["number", "family", "name", "free run", "operations"]
    assert wide[0] <= wide[1]


@needs_browser
def test_contents_lead_to_every_heading(opened):
    links = opened.value(
        "[...document.querySelectorAll('.contents a')].map((a) => [a.textContent,"
        "document.querySelector(a.getAttribute('href')).textContent])"
    )
    assert len(links) > 6 and all(text == title for text, title in links)
    assert "Scores" in dict(links) and "Provenance" in dict(links)


@needs_browser
def test_without_scripts_and_on_paper_the_figures_are_there(browser, page, tmp_path):
    browser.send("Emulation.setScriptExecutionDisabled", value=True)
    try:
        browser.open(page)
        assert browser.value(f"({SEEN})('.static svg')") >= 4
        assert browser.value(f"({SEEN})('.live, [data-jump], #broken')") == 0
    finally:
        browser.send("Emulation.setScriptExecutionDisabled", value=False)
    browser.open(page, ready=READY)
    browser.send("Emulation.setEmulatedMedia", media="print")
    try:
        assert browser.value(f"({SEEN})('.static svg')") >= 4
        assert browser.value(f"({SEEN})('.live')") == 0
    finally:
        browser.send("Emulation.setEmulatedMedia", media="")


@needs_browser
def test_a_phone_shows_all_of_its_width(browser, page):
    browser.send(
        "Emulation.setDeviceMetricsOverride",
        **{"width": 360, "height": 740, "deviceScaleFactor": 2, "mobile": True},
    )
    browser.open(page, ready=READY)
    wide = browser.value("[document.documentElement.scrollWidth, innerWidth]")
    assert wide == [360, 360]
    assert browser.value("jaxnarx.page.view.charts[0].width") <= 360


# hostile names and data -------------------------------------------------------------

CALL = "pwned()"
SHAPES = (
    "<script>{0}</script>",
    "</script><script>{0}</script>",
    "<img src=x onerror={0}>",
    "<svg onload={0}>",
    "\"><img src=x onerror='{0}'>",
    "' onmouseover='{0}' x='",
    "<!--<script>{0}",
    "*/ {0} /*",
    "\\u003c/script>{0}",
    "`${{{0}}}`",
    "'; {0}; '",
    '"; {0}; //',
    "javascript:{0}",
    "{{{{ {0} }}}}",
    "{{% {0} %}}",
    "<style>@import 'x:{0}'</style>",
    "</style><script>{0}</script>",
    "</title><script>{0}</script>",
    "<a href=javascript:{0}>a</a>",
    "\u2028{0}\u2029",
    "]]><script>{0}</script>",
    "</svg><script>{0}</script>",
    "<base href=//x>{0}",
    "<iframe srcdoc='<script>parent.{0}</script>'>",
    "__proto__{0}",
)
PAGES = 4
"""Each with 50 hostile texts: of channels, units, records, notes and commands."""


def hostile(seed: int) -> list[str]:
    """Fifty texts, all different."""
    rng = np.random.default_rng(seed)
    texts = []
    for n in range(50):
        shape = SHAPES[n % len(SHAPES)].format(CALL)
        pad = "".join(rng.choice(list("\"'<>&\\/ {}$;=é"), size=n // 25 + 1))
        texts.append(f"{seed}.{n}{pad}{shape}")
    return texts


def hostile_report(seed: int) -> tuple[Report, list[str]]:
    """Every text stands where the page shows it; numbers are extreme."""
    texts = hostile(seed)
    names, units, notes, records = texts[:4], texts[4:8], texts[8:12], texts[12:]
    ports = [Channel(n, u) for n, u in zip(names, units, strict=True)]
    net = common.named("coupled")
    channels = Channels(tuple(ports[:2]), tuple(ports[2:]))
    net = dataclasses.replace(net, channels=channels)
    rng = np.random.default_rng(seed)
    samples = 30
    values = rng.choice([0.0, -0.0, 1.0, np.nan, 1e308, 5e-324, -1e308], (samples, 4))
    found = [
        ShownRecord(
            "test",
            record,
            dict(zip(names, values.T, strict=True)),
            rng.choice([0.0, 1e308, np.inf, -np.inf, np.nan], (samples, 2)),
            np.ones((samples, 2), bool),
            rng.random((samples, 2)) > 0.5,
            begin=values[:3, 2:],
            start=2,
            index=rng.choice([0.0, 2.0, np.inf, np.nan], samples),
            others={record: values[:, 2:]},
        )
        for record in records
    ]
    base = make(names[2], records[0])
    made = dataclasses.replace(
        base,
        outputs=tuple(ports[2:]),
        rows=tuple(
            dataclasses.replace(r, output=n) for n in names[2:] for r in base.rows
        ),
        notes=tuple(notes),
        provenance={texts[0]: texts[1]},
        **dict.fromkeys(("selection", "history", "partition", "stability")),
        next_command=notes[0],
        network=net,
        records=tuple(found),
    )
    return made, texts


@needs_browser
@pytest.mark.parametrize("seed", some(range(PAGES), 0, 3))
def test_nothing_of_200_hostile_texts_is_executed(browser, tmp_path, seed):
    made, texts = hostile_report(seed)
    path = tmp_path / "hostile.html"
    write_report(made, path)
    browser.send(
        "Page.addScriptToEvaluateOnNewDocument",
        source="window.hits = 0; window.pwned = () => { window.hits += 1; };",
    )
    browser.open(path, ready=READY)
    options = "[...document.getElementById('choose-record').options].map((o) => o.text)"
    shown = browser.value(options)
    assert len(shown) == len(made.records)
    for name, text in zip(texts[12:], shown, strict=True):
        assert " ".join(f"test: {name}".split()) in " ".join(text.split())
    for n in range(0, len(shown), 5):
        browser.value(f"jaxnarx.page.open({n})")
    drop = ",".join(f'"{name.replace(chr(34), chr(34) * 2)}"' for name in texts[:2])
    browser.value(DROP.format(text=json.dumps(f"{drop}\n1,2\n3,4\n5,6\n7,8\n")))
    browser.wait("document.getElementById('file-told').textContent")
    assert browser.value("window.hits") == 0
    assert browser.errors() == []
    asked = browser.requests()
    assert all(a.startswith("data:image/png") for a in asked[1:])
    # Only the elements of the page itself: none came in by a text.
    kinds = browser.value("[...new Set([...document.all].map((e) => e.localName))]")
    assert not {"iframe", "img", "base", "object"} & set(kinds)
    # Links are those of the table of contents, to headings of the page.
    links = browser.value(
        "[...document.querySelectorAll('a')].map((a) => [a.parentNode.className,"
        "a.getAttribute('href'), a.getAttributeNames().length])"
    )
    assert links and all(
        place == "contents" and re.fullmatch(r"#section-\d+", to) and count <= 2
        for place, to, count in links
    )
    assert browser.value("document.scripts.length") == 4


def test_running_tells_what_is_not_there():
    bare = make_page(make())
    assert bare.scripts == () and bare.told == "" and not bare.has_model
