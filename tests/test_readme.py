"""The README's Python blocks run as they are printed."""

import re
from pathlib import Path

import jax
import pytest

README = Path(__file__).parents[1] / "README.md"
BLOCKS = re.findall(r"```python\n(.*?)```", README.read_text(), flags=re.DOTALL)


def test_the_readme_has_a_python_block():
    assert BLOCKS


@pytest.mark.parametrize("block", BLOCKS)
def test_a_python_block_runs(block, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    # A user's session has jax's own promotion rules.
    with (
        jax.numpy_dtype_promotion("standard"),
        jax.numpy_rank_promotion("allow"),
    ):
        scope: dict = {}
        exec(compile(block, str(README), "exec"), scope)
    printed = capsys.readouterr().out
    assert "free run" in printed and "diverged" not in printed
    assert (tmp_path / "model.safetensors").stat().st_size > 0
    row = scope["jnx"].report(scope["fit"].value, scope["test"]).pooled("speed")
    # The refined demo network reaches 96.6 %; 90 % leaves room for other rounding.
    assert row.fit > 90
