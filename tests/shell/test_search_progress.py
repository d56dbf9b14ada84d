"""What a search tells while it runs."""

import dataclasses
import time

from search_fakes import row

from jaxnarx.identification.candidates import Trying
from jaxnarx.shell.search.progress import _CandidateLines


def test_lines_have_one_head_and_tell_the_best_and_the_time_left():
    said: list[str] = []
    lines = _CandidateLines(said.append)
    lines({"verb": "select", "candidates": 3})
    assert not said and lines.now == "looking at the data"
    one = row(1)
    lines({"row": one, "chosen": None, "left": None})
    assert len(said) == 2 and lines.now == "y"
    best = dataclasses.replace(one, free_run=0.125)
    lines({"row": best, "chosen": best, "left": 200.0})
    assert len(said) == 3
    assert "so far 0.125" in lines.now and lines.now.endswith("about 3 min 20 s left")


def test_where_no_line_is_written_one_says_what_is_tried():
    said: list[str] = []
    event = {"output": "torque", "number": 12, "chosen": row(1)}
    with _CandidateLines(said.append).tell_while_silent(0.02) as lines:
        lines(event | {"trying": Trying("LOLIMOT", "3 models", 2, 4)})
        end = time.monotonic() + 5
        while not any("torque" in line for line in said) and time.monotonic() < end:
            time.sleep(0.01)
    told = "torque, candidate 12: LOLIMOT, 3 models (group 2 of 4 left out), so far"
    assert told in said[-1]
