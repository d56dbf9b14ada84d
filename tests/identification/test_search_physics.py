"""Signs of gains in a search: kept, told, and part of what a folder holds."""

import csv
import dataclasses
import io

import numpy as np
import pytest
from search_problems import plant

from jaxnarx.errors import SpecError
from jaxnarx.evaluation import count_wrong_signs
from jaxnarx.identification import Leaderboard, Physics, identify, sentences

RIGHT, WRONG = Physics(increases_with=["u"]), Physics(decreases_with=["u"])
"""What the plant does, and what it does not."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("search")


@pytest.fixture(scope="module")
def fit(folder):
    return identify(plant(), preset="linear", physics={"y": RIGHT}, folder=folder)


def test_right_signs_cost_nothing(fit):
    board = fit.stats["leaderboard"]
    for row in board:
        assert row.unconstrained == pytest.approx(row.free_run)
    told = " ".join(sentences(board, "y"))
    assert "without constraints its error on records left out is the same." in told
    assert "wrong" not in told


def test_wrong_signs_are_kept_too_and_their_price_told():
    """What moves stays right by slow dynamics that take it back at rest."""
    found = identify(plant(), preset="linear", physics={"y": WRONG})
    board = found.stats["leaderboard"]
    chosen = board.choose("y")
    assert chosen.free_run > 1.4 * chosen.unconstrained
    counted = count_wrong_signs(found.value, plant(), {"y": WRONG})
    assert counted["y"].wrong == 0 < counted["y"].known
    price, wrong = [
        s for s in sentences(board, "y") if "without constraints" in s.lower()
    ]
    assert price.endswith("% less.")
    points = sum(map(len, plant()))
    told = f"its gain is wrong by u at {points} of {points} operating points."
    assert wrong.endswith(told)


def test_a_folder_goes_on_with_the_same_physics_alone(fit, folder):
    again = identify(plant(), preset="linear", physics={"y": RIGHT}, folder=folder)
    assert again.stats["leaderboard"] == fit.stats["leaderboard"]
    for other in ({"y": WRONG}, None):
        with pytest.raises(SpecError, match="a search that differs in physics"):
            identify(plant(), preset="linear", physics=other, folder=folder)


def test_vetoes_are_told(fit):
    board = fit.stats["leaderboard"]
    lost = dataclasses.replace(
        board.rows[-1], number=99, free_run=None, status="wrong sign"
    )
    more = Leaderboard((*board.rows, lost), board.group_names)
    told = " ".join(sentences(more, "y"))
    assert f"1 of {len(more)} candidates has gains against physics: vetoed" in told


def test_an_input_that_stands_still_is_told_before_any_work(tmp_path):
    records = [dataclasses.replace(r, u=np.zeros_like(r.u)) for r in plant()]
    still = dataclasses.replace(plant(), records=tuple(records))
    with pytest.raises(SpecError, match="physics of y: u does not move"):
        identify(still, physics={"y": RIGHT}, folder=tmp_path / "search")
    assert not (tmp_path / "search").exists()


def test_the_table_has_the_error_without_constraints(fit):
    table = csv.DictReader(io.StringIO(fit.stats["leaderboard"].to_csv()))
    for row in table:
        assert float(row["unconstrained"]) == pytest.approx(float(row["free_run"]))
