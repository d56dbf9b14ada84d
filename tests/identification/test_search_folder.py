"""The folder of a search: whole after every candidate, and of one search only."""

import dataclasses
import json
import math
import subprocess

import numpy as np
import pytest
from identify_problems import engine
from search_fakes import board, fitted, row

from jaxnarx.child_process import python_command, python_environment
from jaxnarx.errors import DataFileError, ModelFileError, SpecError
from jaxnarx.identification import Leaderboard, read_search
from jaxnarx.identification.search_folder import open_search

KEY = {"data": "abc", "outputs": ("y", "w"), "seed": 1}
EMPTY = Leaderboard((), ("day 1", "day 2"), "best")


@pytest.fixture(scope="module")
def network():
    return fitted(engine(1), "y")


def test_a_candidate_comes_back_as_it_was(tmp_path, network):
    folder = open_search(tmp_path / "run", KEY, EMPTY)
    folder = folder.add(row(2), network).add(row(4), None)
    for found in (read_search(tmp_path / "run"), open_search(folder.path, KEY, EMPTY)):
        assert found.leaderboard == Leaderboard(
            (row(2), row(4)), EMPTY.group_names, "best"
        )
        again = found.network(3)
        np.testing.assert_array_equal(
            again.models[0].local.coefficient, network.models[0].local.coefficient
        )
    with pytest.raises(SpecError, match=r"5 \(LOLIMOT: 3 models\) has no model"):
        read_search(folder.path).network(5)
    with pytest.raises(SpecError, match="no candidate 9: numbers go from 3 to 5"):
        read_search(folder.path).row(9)


def test_a_number_tried_again_takes_the_place_of_the_first(tmp_path):
    folder = open_search(tmp_path, KEY, EMPTY).add(row(4), None)
    other = dataclasses.replace(row(4), name="other")
    assert folder.add(other, None).leaderboard.rows == (other,)
    last = dataclasses.replace(row(4), number=9)
    both = folder.add(last, None).add(other, None)
    assert both.leaderboard.rows == (other, last)


def test_another_key_is_refused_by_name(tmp_path):
    open_search(tmp_path, KEY, EMPTY)
    with pytest.raises(SpecError, match="differs in seed, more; .* --force"):
        open_search(tmp_path, KEY | {"seed": 2, "more": 0}, EMPTY)


def test_figures_beyond_all_numbers_are_none_in_the_file(tmp_path):
    wild = dataclasses.replace(row(1), groups=(math.inf, 0.1), one_step=math.nan)
    found = open_search(tmp_path, KEY, EMPTY).add(wild, None).leaderboard.rows[0]
    assert found.groups == (None, 0.1) and found.one_step is None
    assert read_search(tmp_path).leaderboard.rows == (found,)


def test_a_candidate_whose_model_is_gone_is_tried_again(tmp_path, network):
    folder = open_search(tmp_path, KEY, EMPTY).add(row(1), network)
    folder.model_path(2).unlink()
    assert not len(open_search(tmp_path, KEY, EMPTY).leaderboard)
    assert len(read_search(tmp_path).leaderboard) == 1


@pytest.mark.parametrize("damage", ["cut", "empty", "list", "key", "newer"])
def test_a_damaged_record_is_one_sentence(tmp_path, damage):
    for one in board("y"):
        open_search(tmp_path, KEY, EMPTY).add(one, None)
    path = tmp_path / "search.json"
    text = path.read_text()
    told = json.loads(text) | {"format": 99}
    texts = {"cut": text[:-9], "empty": "", "list": "[]", "key": '{"format": 1}'}
    path.write_text(texts.get(damage, json.dumps(told)))
    with pytest.raises((DataFileError, ModelFileError), match="search.json"):
        read_search(tmp_path)
    with pytest.raises((DataFileError, ModelFileError)):
        open_search(tmp_path, KEY, EMPTY)


@pytest.mark.parametrize(
    ("spoilt", "said"),
    [
        ({"number": "1"}, "row 2: .*number is of type str"),
        ({"free_run": [1]}, "row 2: .*free_run is of type list"),
        ({"free_run": 1e300}, "row 2: free_run is 1e.300, but must be from 0"),
        ({"standard_error": -1.0}, "row 2: standard_error is -1.0"),
        ({"one_step": float("nan")}, "row 2: one_step is nan"),
        ({"groups": "ab"}, "row 2: .*groups is of type str"),
        ({"groups": [0.1, "x"]}, "row 2: .*groups is of type list"),
        ({"groups": [0.1]}, "row 2: groups has not one figure for each of 2"),
        ({"family": None}, "row 2: .*family is None"),
        ({"number": 1}, "row 2: number 1 is taken"),
        ({"cost": 1}, "row 2: a candidate has no field cost"),
    ],
)
def test_a_row_that_cannot_be_is_named_with_its_field(tmp_path, spoilt, said):
    open_search(tmp_path, KEY, EMPTY).add(row(0), None).add(row(1), None)
    path = tmp_path / "search.json"
    told = json.loads(path.read_text())
    told["rows"][1] |= spoilt
    path.write_text(json.dumps(told))
    with pytest.raises(DataFileError, match=f"search.json: {said}"):
        read_search(tmp_path)


def test_a_model_of_another_output_is_refused(tmp_path, network):
    folder = open_search(tmp_path, KEY, EMPTY).add(row(1, output="w"), network)
    with pytest.raises(DataFileError, match="candidate 2 is of w, but its model .* y"):
        folder.network(2)


def test_another_process_is_kept_out_until_the_search_is_let_go(tmp_path):
    code = f"""
from pathlib import Path
from jaxnarx.identification import Leaderboard
from jaxnarx.identification.search_folder import open_search
held = open_search(Path({str(tmp_path)!r}), {{}}, Leaderboard(())).added
print("held", flush=True)
input()
"""
    with subprocess.Popen(
        python_command(code),
        env=python_environment(),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"held\n"
        with pytest.raises(SpecError, match="another process searches in"):
            open_search(tmp_path, {}, EMPTY)
        assert not len(read_search(tmp_path).leaderboard)
        other.kill()
    first = open_search(tmp_path, {}, EMPTY)
    assert open_search(tmp_path, {}, EMPTY).lock is first.lock
