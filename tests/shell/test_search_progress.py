"""What a search tells while it runs."""

import dataclasses

from search_fakes import row

from jaxnarx.shell.search.progress import _CandidateLines


def test_lines_have_one_head_and_tell_the_best_and_the_time_left():
    said: list[str] = []
    lines = _CandidateLines(said.append)
    lines({"verb": "select", "candidates": 3})
    assert not said and not lines.now
    one = row(1)
    lines({"row": one, "chosen": None, "left": None})
    assert len(said) == 2 and lines.now == "y"
    best = dataclasses.replace(one, free_run=0.125)
    lines({"row": best, "chosen": best, "left": 200.0})
    assert len(said) == 3
    assert "so far 0.125" in lines.now and lines.now.endswith("about 3 min 20 s left")
