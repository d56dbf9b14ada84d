"""The benchmark of the sweep runs small, and records what it promises."""

import pytest
from smoke import run


@pytest.mark.slow
def test_sweep_without_peers(tmp_path):
    figures = run("sweep.py", results=tmp_path / "results")["sweep"]
    assert [row["lanes"] for row in figures["in turn"]] == [1, 2]
    for row in (*figures["in turn"], *figures["side by side"]):
        assert row["okay"] == row["lanes"]
        assert row["fits_per_s"] > 0 and row["first_call_s"] > 0
    assert figures["seconds_for_1000"] > 0
