"""Figures and files of sweeps: what they show is what the table says."""

import csv
import io

import numpy as np
import pytest

from jaxnarx.errors import SpecError
from jaxnarx.shell.style import svg
from jaxnarx.shell.sweep_figures import heat_map, paired_scatter, strip, sweep_front
from jaxnarx.shell.sweep_files import best_lines, status_lines, sweep_csv
from jaxnarx.sweep import SweepTable, paired_comparison


@pytest.fixture(scope="module")
def table():
    """Errors that halve by training and grow with ridge; every seventh row fails."""
    return SweepTable.from_rows(
        [
            {
                "engine": f"e{n % 3} $x_1$",
                "start": n,
                "ridge": ridge,
                "train": train,
                "status": "diverged" if (7 * n + 3 * k) % 11 == 0 else "ok",
                "error": (n + 1.0) * factor * (1 + ridge),
                "size": 10 * (k + 1),
            }
            for n in range(6)
            for k, ridge in enumerate((0.0, 0.1, 1.0))
            for train, factor in (("none", 1.0), ("joint", 0.5))
        ]
    )


@pytest.fixture(scope="module")
def comparison(table):
    options = {"pair": ["engine", "start", "ridge"], "factor": "train", "by": "error"}
    return paired_comparison(table, **options)


def ends(line):
    """The first point of a line."""
    return np.asarray(line.get_xydata())[0].tolist()


def test_pairs_are_dots_and_the_worst_is_ringed(comparison):
    figure = paired_scatter(comparison, color="engine")
    (axes,) = figure.axes
    *groups, diagonal, ring = axes.get_lines()
    dots = np.concatenate([np.stack(line.get_data(), axis=1) for line in groups])
    expected = np.stack([comparison.before, comparison.after], axis=1)
    assert sorted(dots.tolist()) == sorted(expected.tolist())
    assert len(groups) == 3 and np.array_equal(*diagonal.get_data())
    worst = comparison.worst
    assert ends(ring) == [worst["before"], worst["after"]]
    assert axes.get_xlim() == axes.get_ylim()
    text = svg(figure)
    assert f"{len(comparison.before)} pairs, better in 100 %, ratio 0.5" in text
    assert "e0 $x_1$" in text and "error, joint" in text


def test_groups_are_boxes_and_failures_are_counted(table):
    figure = strip(table, "train", "error")
    (axes,) = figure.axes
    score = np.where(table.okay, table.numbers("error"), np.nan)
    medians = [
        float(np.nanmedian(score[table.column("train") == name]))
        for name in ("none", "joint")
    ]
    lines = [line for line in axes.get_lines() if line.get_linewidth() == 1.6]
    drawn = [ends(line)[1] for line in lines]
    assert drawn == medians
    failed = int(np.sum(~table.okay)) // 2
    assert svg(figure).count(f"{failed} failed") == 2
    assert [t.get_text() for t in axes.get_xticklabels()] == ["none", "joint"]
    with pytest.raises(SpecError, match="no rows"):
        strip(table.where(train="nothing"), "train", "error")


def test_a_heat_map_holds_the_medians(table):
    figure = heat_map(table, "ridge", "train", "error")
    axes, _ = figure.axes
    values = np.asarray(axes.get_images()[0].get_array())
    assert values.shape == (2, 3)
    own = table.where(ridge=0.1, train="joint")
    expected = np.median(own.numbers("error")[own.okay])
    assert values[1, 1] == expected
    assert f"{expected:.3g}" in svg(figure)


def test_an_empty_cell_of_a_heat_map_says_so(table):
    rows = [{**row, "status": "crashed"} for row in table.where(ridge=0.1).rows()]
    rows += list(table.where(ridge=1.0).rows())
    figure = heat_map(SweepTable.from_rows(rows), "ridge", "train", "error")
    assert "6 failed" in svg(figure)


def test_the_front_leaves_failures_out(table):
    figure = sweep_front(table, "error", ["size"], group="train")
    (axes,) = figure.axes
    drawn = np.asarray(axes.get_lines()[0].get_xydata())
    score = table.numbers("error")[table.okay]
    assert drawn[-1, 1] == score.min()


def test_csv_has_no_formulas_and_lists_as_json():
    rows = [{"=name": "=HYPERLINK(1)", "list": ["a", "b"], "x": -1.5, "none": None}]
    header, row = csv.reader(io.StringIO(sweep_csv(SweepTable.from_rows(rows))))
    assert header == ["'=name", "list", "x", "none"]
    assert row == ["'=HYPERLINK(1)", '["a", "b"]', "-1.5", ""]


def test_lines_for_people(table):
    assert status_lines(table)[0].split() == ["ok", str(int(table.okay.sum()))]
    lines = best_lines(table, ["start", "error"], most=2)
    assert [line.split() for line in lines] == [
        ["start", "error"],
        ["0", "1"],
        ["0", "0.5"],
        ["and", "34", "more"],
    ]
