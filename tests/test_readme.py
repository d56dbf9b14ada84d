"""The README's commands and Python blocks, as they are printed."""

import re
import shlex
from pathlib import Path

import jax
import numpy as np
import pytest

from jaxnarx.shell.cli import run
from jaxnarx.shell.commands.parse import parse

README = Path(__file__).parents[1] / "README.md"


def blocks(language: str) -> list[str]:
    text = README.read_text()
    return re.findall(rf"```{language}\n(.*?)```", text, flags=re.DOTALL)


def engine(rows: int, seed: int) -> np.ndarray:
    """Speed, fuel and NOx: first order, its gain growing with the fuel."""
    rng = np.random.default_rng(seed)
    speed = np.repeat(rng.uniform(1000, 3000, rows // 20 + 1), 20)[:rows]
    fuel = np.repeat(rng.uniform(20, 80, rows // 15 + 1), 15)[:rows]
    nox = np.zeros(rows)
    for t in range(1, rows):
        gain = 0.02 * fuel[t - 1] ** 2 + 0.01 * speed[t - 1]
        nox[t] = 0.8 * nox[t - 1] + 0.2 * gain
    return np.stack([speed, fuel, nox + 0.2 * rng.standard_normal(rows)], axis=1)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder of 25 records over three days, and the description as printed."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("JAXNARX_DATA", raising=False)
    (tmp_path / "runs").mkdir()
    days = [1] * 15 + [2] * 5 + [3] * 5
    for n, day in enumerate(days):
        path = tmp_path / "runs" / f"day{day}_{n:02d}.csv"
        header = {"header": "speed,fuel,NOx", "comments": "", "delimiter": ","}
        np.savetxt(path, engine(105, n), **header)
    (description,) = blocks("toml")
    (tmp_path / "engine.toml").write_text(description)
    return tmp_path


def test_the_two_commands_are_one_line_each():
    first, second = (block.splitlines() for block in blocks("sh"))
    assert len(first) == len(second) == 1
    assert first[0].endswith("jaxnarx demo") and "pytest" in second[0]


def test_the_commands_parse():
    (console,) = blocks("console")
    commands = [shlex.split(line.removeprefix("$ ")) for line in console.splitlines()]
    assert [words[1] for words in commands] == [
        *(
            "describe",
            "check",
            "identify",
            "leaderboard",
            "choose",
            "simulate",
            "report",
        )
    ]
    for words in commands:
        parse(words[1:])


def test_the_python_block_works_on_a_folder_of_25_records(folder, capsys):
    (block,) = blocks("python")
    # A user's session has jax's own promotion rules.
    with (
        jax.numpy_dtype_promotion("standard"),
        jax.numpy_rank_promotion("allow"),
    ):
        scope: dict = {}
        exec(compile(block, str(README), "exec"), scope)
    printed = capsys.readouterr().out
    assert "Good: " in printed and "diverged" not in printed
    assert (folder / "model.safetensors").stat().st_size > 0
    data = scope["data"]
    assert [len(part) for part in (data.train, data.validate, data.test)] == [15, 5, 5]
    assert data.test.names == [f"day3_{n:02d}" for n in range(20, 25)]


@pytest.mark.slow
def test_the_console_commands_work_on_it_too(folder, capsys):
    (console,) = blocks("console")
    described, check, identify, *_ = [
        shlex.split(line)[2:] for line in console.splitlines()
    ]
    # Of candidates with hidden states, which take the longest, the smallest alone.
    small = "--preset", "quick", "--candidates", "20", "--states", "1"
    # engine.toml is there: the README's own; these files have no column of times
    assert run([*described, "--out", "found.toml", "--sample-time", "0.1"]) == 0
    assert run(check) == 0 and run([*identify, *small]) == 0
    assert (folder / "runs/engine-quick/report.html").is_file()
    assert "free run on test" in capsys.readouterr().out
    assert run(["leaderboard", "runs/engine-quick"]) == 0
    assert "one step" in capsys.readouterr().out
