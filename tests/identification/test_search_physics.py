"""A search with knowledge beside records: signs of gains, operating points."""

import csv
import dataclasses
import io

import numpy as np
import pytest
from search_problems import plant

from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
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
        board.rows[-1], number=99, free_run=None, status="against physics"
    )
    more = Leaderboard((*board.rows, lost), board.group_names)
    told = " ".join(sentences(more, "y"))
    assert f"1 of {len(more)} candidates contradicts physics: vetoed" in told


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


def points(valid: bool = True) -> Dataset:
    """The plant at rest."""
    u = np.linspace(-1.5, 1.5, 7)[:, None]
    y = np.tanh(2.5 * u) / 0.3
    found = Dataset.from_arrays([u], [y], inputs=["u"], outputs="y", sample_time=60.0)
    (record,) = found
    known = np.stack([np.ones(7, bool), np.full(7, valid)], axis=1)
    return dataclasses.replace(
        found, records=(dataclasses.replace(record, valid=known),)
    )


def test_points_at_rest_train_and_are_part_of_what_a_folder_holds(tmp_path):
    plain = identify(plant(), preset="linear", folder=tmp_path / "plain")
    found = identify(plant(), preset="linear", at_rest=points(), folder=tmp_path / "a")
    again = identify(plant(), preset="linear", at_rest=points(), folder=tmp_path / "a")
    boards = [one.stats["leaderboard"] for one in (plain, found, again)]
    assert boards[1] == boards[2] != boards[0]
    # Records judge as before, but for what points have changed.
    for one, other in zip(boards[0], boards[1], strict=True):
        assert len(one.groups) == len(other.groups)
    low, high = (np.asarray(a)[0] for a in (found.value.low, found.value.high))
    assert low == -1.5 and high == 1.5
    lower, gain = np.asarray(found.value.lower)[0], np.asarray(found.value.gain)[1]
    assert lower * gain < np.asarray(found.value.low)[1] <= min(points().records[0].y)
    with pytest.raises(SpecError, match="a search that differs in at_rest"):
        identify(plant(), preset="linear", folder=tmp_path / "a")


def test_points_at_rest_that_tell_nothing_are_refused():
    with pytest.raises(DataError, match="no operating point has 'y'") as caught:
        identify(plant(), preset="linear", at_rest=points(valid=False))
    assert caught.value.channel == "y"
    (record,) = points()
    other = Dataset.from_arrays(
        [record.u], [record.y], inputs=["v"], outputs="y", sample_time=0.1
    )
    with pytest.raises(SpecError, match="at_rest: the data have no channel 'u'"):
        identify(plant(), preset="linear", at_rest=other)
