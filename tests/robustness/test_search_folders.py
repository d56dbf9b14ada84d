"""Damaged folders of searches: a sentence or the table, at every command."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from battery import mutate
from identify_problems import engine
from search_fakes import NAMES, FakeSearch, board, fitted

from jaxnarx.errors import JaxnarxError
from jaxnarx.identification import Leaderboard
from jaxnarx.identification.search_folder import open_search
from jaxnarx.shell.cli import EXIT_DEFECT, run

pytestmark = pytest.mark.slow

TOKENS = [b"null", b"[1]", b"{}", b"-1", b"9" * 400, b'"x"', b"1e999", b"[" * 2000]
TOKENS += [b"NaN", b"5e-324", b"1e200", b"true", b'"=HYPERLINK(1)"', b'"\\u001b[2J"']
TOML = """
[data]
sample_time = 0.1
[channels.inputs]
a = "V"
[channels.outputs]
y = "ppm"
w = "K"
[records]
train = ["r0.csv", "r1.csv"]
"""
OTHERS = (None, True, -1, 0, 1, 2**31, 10**400, 0.5, -0.5, 5e-324, 1e99, 1e200)
OTHERS += (float("nan"), float("inf"), "", "y", "ok", "diverged", "constant", [], {})
OTHERS += ("\x1b[2J", "=1+1", "\ud800", "x" * 9000, [1.0], [None, None], ["a", "b"])
"""Values that a damaged file may hold in place of others."""


def in_kind(path: Path, rng: np.random.Generator) -> None:
    """One to three values of the file are set to others, which may be of other kinds,
    or go."""
    told = json.loads(path.read_text())
    for _ in range(int(rng.integers(1, 4))):
        tables = [told, *(r for r in told["rows"] if isinstance(r, dict))]
        table = tables[int(rng.integers(len(tables)))]
        name = sorted(table)[int(rng.integers(len(table)))]
        table[name] = OTHERS[int(rng.integers(len(OTHERS)))]
        if rng.random() < 0.1 or not isinstance(told.get("rows"), list):
            del table[name]
            break
    path.write_text(json.dumps(told))


def in_bytes(path: Path, rng: np.random.Generator) -> None:
    path.write_bytes(mutate(path.read_bytes(), rng, TOKENS))


def in_words(path: Path, rng: np.random.Generator) -> None:
    """A text of the file is set to another."""
    text = path.read_text()
    at = [m for m in re.finditer(r'"[^"]*"', text)]
    one = at[int(rng.integers(len(at)))]
    other = [t for t in OTHERS if isinstance(t, str)]
    word = json.dumps(other[int(rng.integers(len(other)))])
    path.write_text(text[: one.start()] + word + text[one.end() :])


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Path:
    """The folder of an engine, and in `s` a finished search of two outputs."""
    home = tmp_path_factory.mktemp("engine")
    rng = np.random.default_rng(0)
    for n in range(2):
        u = rng.standard_normal(60)
        y = np.convolve(u, [0, 1.0, 0.5])[:60] + 0.1 * rng.standard_normal(60)
        lines = (f"{a:.5f},{b:.5f},{b * b:.5f}" for a, b in zip(u, y, strict=True))
        (home / f"r{n}.csv").write_text("a,y,w\n" + "\n".join(lines) + "\n")
    (home / "engine.toml").write_text(TOML)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(home)
        patch.setattr("jaxnarx.identification.verb.search", FakeSearch())
        assert run(["identify", "engine.toml", "--out", "s"]) == 0
    return home


COMMANDS = (
    ["leaderboard", "s"],
    ["leaderboard", "s", "--csv"],
    ["choose", "s", "2", "--out", "t"],
    ["choose", "s", "1", "8", "--out", "t"],
    ["identify", "engine.toml", "--out", "s"],
)


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
@pytest.mark.parametrize("damage", [in_kind, in_bytes, in_words])
def test_a_command_on_a_damaged_search(
    damage, command, battery, sound, tmp_path, monkeypatch, capsys
):
    home = tmp_path / "home"
    monkeypatch.setattr("jaxnarx.identification.verb.search", FakeSearch())
    whole = command[0] == "leaderboard"
    if not whole:
        battery = type(battery)(
            battery.seed, max(battery.cases // 20, 1), battery.first
        )

    def attempt(rng):
        shutil.rmtree(home, ignore_errors=True)
        shutil.copytree(sound, home)
        monkeypatch.chdir(home)
        damage(home / "s" / "search.json", rng)
        code = run(command)
        out, err = capsys.readouterr()
        assert code != EXIT_DEFECT, err[-400:]
        assert code in (0, 1) or err.startswith("jaxnarx: "), err
        for text in (out, err):
            assert all(c.isprintable() or c == "\n" for c in text)
        if command[-1] == "--csv":
            # No formula; a difference that is negative is a plain number.
            assert not re.search(r"(^|,)([=+@]|-(?![\d.e-]+(,|$)))", out, re.MULTILINE)

    battery.run(attempt, seconds=60, megabytes=600)


@pytest.mark.parametrize("damage", [in_kind, in_bytes, in_words])
def test_a_search_goes_on_where_the_damage_allows(damage, battery, tmp_path):
    """The folder itself: opened with all it holds, or refused by an error of ours."""
    key = {"data": "abc", "outputs": ["y"]}
    network = fitted(engine(1), "y")
    sound = tmp_path / "sound"
    store = open_search(sound, key, Leaderboard((), NAMES))
    for row in board("y"):
        store = store.add(row, network if row.eligible else None)

    def attempt(rng):
        place = tmp_path / "x"
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(sound, place)
        damage(place / "search.json", rng)
        found = open_search(place, key, Leaderboard((), NAMES))
        numbers = [row.number for row in found.leaderboard]
        after = found.add(board("y").rows[0], None)
        assert len(set(numbers)) == len(numbers)
        for output in after.leaderboard.outputs:
            str(after.leaderboard)
            if (chosen := after.leaderboard.choose(output)) is not None:
                with_model = after.model_path(chosen.number).is_file()
                assert (
                    not with_model
                    or chosen.output != "y"
                    or after.network(chosen.number)
                )
        try:
            open_search(place, key, Leaderboard((), NAMES))
        except JaxnarxError as error:
            raise AssertionError(f"written, but not read again: {error}") from error

    battery.run(attempt, seconds=20)
