"""Figures: small, deterministic, and safe whatever a channel is called."""

import io
from functools import cache
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.ticker import LogFormatterSciNotation

from jaxnarx.data import Channel
from jaxnarx.evaluation import (
    Curve,
    Intersection,
    ModelComparison,
    Relevance,
    ResponseSurface,
    SizeErrors,
    Text,
    Trace,
)
from jaxnarx.evaluation._error_map import ErrorMap
from jaxnarx.evaluation.comparison import ComparedRecord
from jaxnarx.shell.figures import report as figures
from jaxnarx.shell.figures import style
from jaxnarx.shell.figures.comparison import draw_comparison, draw_errors_by_size
from jaxnarx.shell.figures.draw import draw
from jaxnarx.shell.figures.envelope import envelope
from jaxnarx.shell.figures.partition import partition
from jaxnarx.shell.figures.relevance import relevance
from jaxnarx.shell.figures.steady_states import intersections, response_surface
from jaxnarx.shell.figures.svg import svg
from jaxnarx.shell.figures.tree import branches

EVIL = "<script>alert(1)</script> $x_$ & \x07 転"


def trace(n=400, label="NOx [ppm]"):
    t = np.arange(n) * 0.1
    y = np.sin(t)
    limited = (t > 5) & (t < 6)
    return figures.draw_free_run(
        t, y, y + 0.1, label=label, title=label, one_step=y - 0.02, limited=limited
    )


def entry(label, dims, both=True, kind="centre"):
    """A partition of two models: `describe_partition` makes the like."""
    names = [label, "load", "spark"][:dims]
    extents = {
        "centre": [{"centre": 0.2, "width": 0.2}, {"centre": 1.4, "width": 0.5}],
        "box": [{"below": 0.4}, {"above": 0.4, "below": 0.8}],
    }[kind]
    side: dict = {"regions": [{name: e for name in names} for e in extents]}
    if dims < 3:
        grid = [np.linspace(0, 1, n) for n in (30, 20)[:dims]]
        first = np.meshgrid(*grid, indexing="ij")[0]
        side["weights"] = np.stack([first, 1 - first])
    cloud = np.random.default_rng(1).random((9, dims))
    out = {"scheduling": names, "ranges": [(0, 1)] * dims, "after": side}
    return out | {"cloud": cloud} | ({"before": side} if both else {})


def gated(label):
    """A tree of three leaves: below; above, then two sides of a second gate."""
    gates = [{label: {"above": 0.5}}, {f"{label} - 0.3 load": {"below": 2.0}}]
    path = [[-1, 0], [1, 1], [1, -1]]
    side = {"regions": [], "gates": gates, "path": path}
    return {"scheduling": [label] * 3, "ranges": [(0, 1)] * 3, "after": side}


@cache
def every(label):
    rng = np.random.default_rng(0)
    y = rng.normal(size=50)
    counts, edges = np.histogram(y * 0.1, 9)
    history = [
        {"iteration": i, "stage": s, "horizon": 10 * (s + 1), "loss": 1 / (i + 1)}
        | {"validation": None if i == 0 else 2 / (i + 1), "damping": 1.0}
        for i, s in enumerate([0, 0, 1, 1])
    ]
    criteria = {"AIC": [3.0, 1.0, None], "BIC": [3.0, 2.0, 2.5]}
    names = [label, "b", "c"]
    errors = np.array([[1.0, np.nan], [2.0, -3.0]])
    samples = np.array([[4, 0], [5, 60]])
    cells = errors, abs(errors), samples, np.zeros((2, 2, 2), int)
    return [
        trace(label=label),
        figures.agreement(y, y * 1.1, counts, edges, label=label, unit=label),
        figures.selection_path(names, [0.9, 0.09, 0.01], criteria=criteria),
        figures.selection_path(names[:1], [1.0]),
        figures.refinement(history),
        *(partition(entry(label, dims)) for dims in (1, 2, 3)),
        partition(entry(label, 2, both=False, kind="box")),
        partition(entry(label, 3, kind="box")),
        partition(gated(label)),
        figures.draw_record_panels(records(label)),
        figures.error_map(
            ErrorMap(
                label, label, (label, "b"), (np.arange(3.0), np.arange(3.0)), *cells
            )
        ),
    ]


def records(label, count=5):
    """Traces of that many records, the first of them diverged."""
    t = np.arange(50) * 0.1
    channel, off = Channel("NOx", "ppm"), np.zeros(50, bool)
    return [
        Trace(channel, label, "", n or None, t, np.sin(t), np.cos(t), None, off, ~off)
        for n in map(float, range(count))
    ]


def test_every_record_has_a_panel_and_says_its_error():
    titles = [one.title for one in figures.draw_record_panels(records("r")).charts]
    assert titles[:2] == ["r: diverged", "r: RMSE 1"] and len(titles) == 5


def test_one_step_does_not_cover_the_measurement():
    curves = [m for m in trace().charts[0].marks if isinstance(m, Curve)]
    assert [one.name for one in curves] == ["one step", "measured", "free run"]


@pytest.mark.parametrize("i", range(13))
def test_figures_draw_any_channel_name_as_text(i):
    picture = every(EVIL)[i]
    page = svg(picture, "f1-", EVIL.replace("\x07", ""))
    assert "<script" not in page and "http" not in page
    ElementTree.fromstring(page)
    if i not in (4,):
        assert "&lt;script&gt;alert(1)&lt;/script" in page.split(">", 1)[1]
    drawn = draw(picture)
    for axes, ends in zip(drawn.axes, picture.ranges(), strict=False):
        np.testing.assert_allclose((axes.get_xlim(), axes.get_ylim()), ends)


def test_a_figure_is_laid_out_as_savefig_does_and_keeps_its_engine(monkeypatch):
    monkeypatch.setattr(style, "LAYOUT_ENGINE", "constrained")
    figure, other, stream = draw(trace()), draw(trace()), io.StringIO()
    engine, canvas = figure.get_layout_engine(), figure.canvas
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with style.use_style():
        other.savefig(stream, format="svg", dpi=200, metadata=nothing)
    assert style.svg(figure) == stream.getvalue()
    assert figure.get_layout_engine() is engine is not None
    assert figure.canvas is canvas


@pytest.mark.parametrize("limits", [(1e-5, 2), (0.3, 3), (2, 7)])
def test_powers_label_where_matplotlib_does_without_mathematics(limits):
    with style.use_style():
        _, (axes,) = style.canvas()
    axes.set(xscale="log", xlim=limits)
    for own, theirs, places in (
        (style.Powers(), LogFormatterSciNotation(), axes.xaxis.get_majorticklocs()),
        (
            style.Powers(labelOnlyBase=False),
            LogFormatterSciNotation(labelOnlyBase=False),
            axes.xaxis.get_minorticklocs(),
        ),
    ):
        for formatter in (own, theirs):
            formatter.set_axis(axes.xaxis)
            formatter.set_locs(places)
        texts = [own(x) for x in places]
        assert [bool(text) for text in texts] == [bool(theirs(x)) for x in places]
        assert not any(set(text) & set("$\\{}^") for text in texts)
    plain = style.Powers()
    plain.set_axis(axes.xaxis)
    assert plain(1e-3) == "10⁻³"


def test_svg_is_deterministic_and_its_text_is_text():
    first, second = style.svg(draw(trace())), style.svg(draw(trace()))
    assert first == second
    assert "NOx [ppm]" in first and "dc:date" not in first


def test_identifiers_of_inline_figures_do_not_meet():
    import re

    a, b = (svg(trace(), p, "t") for p in ("a-", "b-"))
    ids = [set(re.findall(r' id="([^"]+)"', s)) for s in (a, b)]
    assert ids[0] and not ids[0] & ids[1]
    used = set(re.findall(r"(?:url\(|href=\")#([^)\"]+)", a))
    assert used and used <= ids[0]


@pytest.mark.parametrize("n", [1, 2, 1500, 1501, 100_000])
def test_envelope_is_short_and_keeps_every_peak(n):
    rng = np.random.default_rng(n)
    t, y = np.arange(n) * 0.01, rng.normal(size=n)
    time, value = envelope(t, y)
    assert len(value) <= 1500 and np.all(np.diff(time) >= 0)
    assert value.max() == y.max() and value.min() == y.min()


def test_a_long_record_stays_a_small_figure():
    assert len(svg(trace(200_000), "f", "t")) < 60_000


def test_a_tree_lists_both_sides_of_every_gate():
    value = gated("speed")["after"]
    rows = branches(value["gates"], np.array(value["path"]))
    assert [(r.text, r.depth, r.parent, r.leaf) for r in rows] == [
        ("speed < 0.5", 0, -1, 0),
        ("speed > 0.5", 0, -1, -1),
        # The second gate opens below: its first model lies there.
        ("speed - 0.3 load < 2", 1, 1, 1),
        ("speed - 0.3 load > 2", 1, 1, 2),
    ]


def test_models_are_named_at_their_centre_or_inside_their_region():
    def numbers(picture):
        texts = [m for m in picture.charts[-1].marks if isinstance(m, Text)]
        return {m.text: (m.x, m.y) for m in texts}

    named = numbers(partition(entry("a", 2)))
    assert named["1"] == (0.2, 0.2)
    # The other's centre is out of sight: where it leads, below 0.5 of the first.
    assert named["2"][0] < 0.5
    named = numbers(partition(entry("a", 2, kind="box")))
    assert named["1"][0] > 0.6 and named["2"][0] < 0.4


def test_save_writes_whole_files(tmp_path):
    for name in ("a.svg", "a.png"):
        style.save(draw(trace()), tmp_path / name)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.png", "a.svg"]
    with pytest.raises(ValueError, match="saved as"):
        style.save(draw(trace()), tmp_path / "a.pdf")


def test_branches_of_a_sum_tell_shares():
    gates = [{"share": {"above": 0.25}}, {"speed[t]": {"above": 2000.0}}]
    rows = branches(gates, np.array([[-1, 0], [1, -1], [1, 1]]))
    told = [(row.text, row.depth, row.leaf) for row in rows]
    assert told == [
        ("75% of the sum", 0, 0),
        ("25% of the sum", 0, -1),
        ("speed[t] < 2000", 1, 1),
        ("speed[t] > 2000", 1, 2),
    ]


@cache
def of_models(label):
    """Figures of what a model says of its inputs, every name the label."""
    y, u = Channel(label, label[:20]), Channel(f"{label}u", label[:20])
    x, at = np.linspace(0, 1, 5), {u.name: 0.5, label: 1.0}
    error = np.array([[2.0], [np.inf]])
    worth = Relevance((y,), (u, y), np.ones(1), error, np.ones((2, 1)), "mean")
    cut = Intersection(y, u, at, (0.5, 0.5), x, x, x - 1, x + 1, 2 * x)
    surface = ResponseSurface(y, (u, y), at, x, x, np.outer(x, x), np.outer(x, 2 * x))
    record = ComparedRecord(label, label, x, x, {label: x}, {label: None})
    counts, errors = np.arange(1, 6), {label: x + 1}
    sizes = SizeErrors(y, counts, counts, errors, errors, 3)
    return [
        relevance(worth),
        intersections([cut]),
        response_surface(surface),
        draw_comparison(ModelComparison(y, {}, (record,)), [record]),
        draw_errors_by_size(sizes),
    ]


@pytest.mark.parametrize("i", range(5))
def test_figures_of_models_draw_any_channel_name_as_text(i):
    text = style.svg(of_models(EVIL)[i])
    assert "<script" not in text and "&lt;script" in text
