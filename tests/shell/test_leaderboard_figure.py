"""The figure of candidates, and their lines of text."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from search_fakes import board, row

import jaxnarx as jnx
from jaxnarx.errors import SpecError
from jaxnarx.evaluation import Chart
from jaxnarx.identification import Leaderboard, describe
from jaxnarx.shell.figures.leaderboard import error_over_operations
from jaxnarx.shell.search.leaderboard import live_head, live_line, table


def drawn(found: Leaderboard) -> tuple[Chart, dict[str, Any]]:
    (chart,) = error_over_operations(describe(found, "y")).charts
    return chart, {getattr(one, "name", ""): one for one in chart.legend_marks}


def test_families_the_front_and_the_one_in_use_are_shown():
    chart, named = drawn(board("y"))
    families = {"constant", "ARX", "polynomial", "shared feedback", "LOLIMOT"}
    assert families <= set(named)
    assert "in use: 3" in named and "diverges: vetoed" in named
    assert chart.log == "xy"
    front = named["no cheaper one is better"]
    assert list(front.x) == [1, 3, 9, 20]  # no operation stands at one
    assert named["in use: 3"].x == [9.0]
    errors = np.concatenate([np.atleast_1d(named[f].y) for f in families])
    assert named["diverges: vetoed"].y[0] > errors.max()


def test_few_errors_alike_need_no_logarithm():
    chart, _ = drawn(Leaderboard((row(2), row(3)), ("day 1", "day 2")))
    assert chart.log == "x"


@pytest.mark.parametrize("status", ["diverged", "skipped"])
def test_nothing_to_choose_from_is_drawn_all_the_same(status):
    lost = dataclasses.replace(row(1), free_run=None, status=status)
    chart, _ = drawn(Leaderboard((lost,), ("day 1", "day 2")))
    names = [getattr(mark, "name", "") for mark in chart.marks]
    assert ("diverges: vetoed" in names) == (status == "diverged")


def test_a_line_for_each_candidate_and_a_table():
    head, line = live_head(), live_line(row(3), best=True)
    assert line.endswith("* 2 regions") and "0.195 ± 0.020" in line
    assert head.index("free run") + 8 == line.index("0.195 ± 0.020") + 13
    why = dataclasses.replace(row(4), status="skipped", detail="out of time")
    assert live_line(why, best=False).endswith("3 models (out of time)")
    lines = table(board("y"), "y").split("\n")
    assert len(lines) == 6 and lines[2].startswith("*    2       3  polynomial")
    assert "worst group" in lines[0] and lines[-1].split()[3] == "diverged"


def test_the_short_table_keeps_the_used_and_the_linear():
    lines = table(board("y"), "y", top=1).split("\n")
    assert [s.removeprefix("*").split()[1] for s in lines[1:-1]] == ["4", "3", "2", "1"]
    assert lines[-1].strip() == "and 1 more"


def test_errors_stand_over_parameters_too():
    found = board("y")
    (axes,) = jnx.plot.leaderboard(found, by="parameters").axes
    assert axes.get_xlabel().startswith("parameters")
    by_label = {line.get_label(): line for line in axes.lines}
    chosen = found.choose("y")
    assert chosen is not None
    at = by_label[f"in use: {chosen.number}"].get_xdata()
    assert list(np.asarray(at)) == [chosen.parameters]
    assert "no cheaper one is better" not in by_label  # that is about operations
    with pytest.raises(SpecError, match="by must be one of"):
        jnx.plot.leaderboard(found, by="seconds")


def test_plot_draws_the_output_that_is_asked_for():
    from jaxnarx.shell.plot import leaderboard

    figure = leaderboard(board("y", "w"), output="w")
    legend = figure.axes[0].get_legend()
    assert legend is not None
    assert "in use: 8" in [text.get_text() for text in legend.get_texts()]
