"""`identify` without a method, `leaderboard` and `choose`, around a made-up search.

One run of two outputs serves most tests.
"""

import csv
import json
import os
import shlex
import shutil
import signal
from pathlib import Path

import numpy as np
import pytest
from search_fakes import KINDS, NAMES, FakeSearch, row

from jaxnarx.errors import DataError
from jaxnarx.identification import Leaderboard, Physics
from jaxnarx.shell import interrupt
from jaxnarx.shell.cli import run
from jaxnarx.shell.search.leaderboard import table

FILES = {"leaderboard.csv", "model.safetensors", "report.html", "report.json"}
pytestmark = pytest.mark.usefixtures("remembered")
KEPT = {"candidates", "made_from.json", "search.json"}
LINE = "identify engine.toml --budget 10m"
TOML = """
[data]
sample_time = 0.1
[channels.inputs]
a = "V"
b = "V"
[channels.outputs]
y = "ppm"
w = "K"
[records]
train = ["r0.csv", "r1.csv"]
validate = ["r2.csv"]
test = ["r3.csv"]
"""


def write(path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, (12, 2)), 6, axis=0)
    y = np.zeros((72, 2))
    for t in range(1, 72):
        y[t] = [0.7 * y[t - 1, 0] + u[t - 1, 0], 0.5 * y[t - 1, 1] + u[t - 1, 1]]
    y += 0.05 * rng.standard_normal(y.shape) + 3
    text = "\n".join(",".join(f"{x:.6g}" for x in r) for r in np.hstack([u, y]))
    path.write_text("a,b,y,w\n" + text + "\n")


@pytest.fixture(scope="module")
def home(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("home")
    for k in range(4):
        write(folder / f"r{k}.csv", k)
    (folder / "engine.toml").write_text(TOML)
    return folder


@pytest.fixture(scope="module")
def patched():
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("JAXNARX_DATA", raising=False)
        yield patch


def searching(patch: pytest.MonkeyPatch, **how) -> FakeSearch:
    fake = FakeSearch(**how)
    patch.setattr("jaxnarx.identification.verb.search", fake)
    return fake


def typed(capsys, line: str) -> tuple[int, str, str]:
    capsys.readouterr()
    code = run(shlex.split(line))
    told = capsys.readouterr()
    assert "Traceback" not in told.err
    return code, told.out, told.err


@pytest.fixture(scope="module")
def done(home, patched, printed) -> tuple[Path, str]:
    """The folder of a finished search of both outputs, and what was printed."""
    patched.chdir(home)
    fake = searching(patched)
    code = run(shlex.split(LINE))
    assert code == 0 and len(fake.tried) == 2 * len(KINDS)
    assert fake.options == {
        "preset": "good",
        "budget": 600.0,
        "candidates": None,
        "groups": ["", "", "validation"],
    }
    return home / "runs/engine-good", printed()


@pytest.fixture(scope="module")
def printed():
    """What is printed from now on, for a fixture of a module."""
    import io
    import sys

    with pytest.MonkeyPatch.context() as patch:
        stream = io.StringIO()
        patch.setattr(sys, "stdout", stream)
        yield stream.getvalue


@pytest.fixture
def copy(done, tmp_path, monkeypatch) -> Path:
    """A folder of its own with records and the finished search."""
    shutil.copytree(done[0].parents[1], tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_what_spoils_any_model_is_told_before_the_search(tmp_path, monkeypatch, capsys):
    """A constant input, three records of 15 samples, no units."""
    monkeypatch.chdir(tmp_path)
    searching(monkeypatch, error=DataError("searched"))
    for n in range(4):
        write(tmp_path / f"r{n}.csv", n)
        lines = (tmp_path / f"r{n}.csv").read_text().splitlines()
        rows = [f"1,{line.partition(',')[2]}" for line in lines[1:]]
        rows = rows if n == 3 else rows[:15]
        (tmp_path / f"r{n}.csv").write_text("\n".join([lines[0], *rows]) + "\n")
    (tmp_path / "engine.toml").write_text(TOML.replace('"V"', '""'))
    code, text, told = typed(capsys, LINE)
    assert code == 3 and "searched" in told
    assert "no unit is stated for a, b" in text
    assert "input a is constant at 1 in all records" in text
    assert "r0 has 15 rows, none after lag 20" in text and "jaxnarx check" in text


# a finished search ----------------------------------------------------------------


def test_a_run_writes_model_report_and_table(done):
    folder, _ = done
    assert set(os.listdir(folder)) == FILES | KEPT
    from jaxnarx.models import load

    assert load(folder / "model.safetensors").output_names == ["y", "w"]
    with open(folder / "leaderboard.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * len(KINDS) and rows[0]["family"] == "shared feedback"
    assert [r["family"] for r in rows if r["chosen"] == "1"] == ["polynomial"] * 2


def test_it_tells_every_candidate_the_choice_and_why(done):
    text = done[1]
    assert "validation (r2) join them as a group of their own" in text
    lines = text.split("\n")
    live = [s for s in lines if s.split()[1:3] == ["y", "polynomial"]]
    assert len(live) == 1 and "0.200 ± 0.020" in live[0] and " * degree 2" in live[0]
    assert "y: 3 (polynomial: degree 2), free run 0.200 ± 0.020 on records" in text
    assert "the cheapest to compute within one standard error of the best" in text
    assert "The best itself, 4 (shared feedback: 2 regions), takes 2.2 times" in text
    assert "The best linear model, 2 (ARX: order 1), has 1.50 times the error" in text
    assert "1 of 5 candidates diverges on records left out: vetoed" in text
    assert "On test: RMSE pooled" in text
    # What was written comes before the candidates, whose words are explained.
    assert text.index("; wrote ") < text.index("y: free run on records left out")
    assert "All candidates: jaxnarx leaderboard runs/engine-good\n" in text
    assert "above best: difference to the first" in text
    assert "The exported model takes " in text and " operations a sample" in text
    assert "\nGood: " in text and "why    the free run on test" in text
    following = shlex.split(text.split("Next: ")[1])
    assert following[:3] == [
        "jaxnarx",
        "simulate",
        "runs/engine-good/model.safetensors",
    ]


def test_the_report_holds_the_leaderboard_and_its_figure(done):
    folder, _ = done
    found = json.loads((folder / "report.json").read_text())
    assert set(found["leaderboard"]) == {"y", "w"}
    first = found["leaderboard"]["w"]
    assert first["chosen"] == first["used"] == 8 and first["pareto"] == [6, 7, 8, 9]
    assert first["rows"][1]["groups"] == {"day 1": 0.18, "day 2": 0.22}
    assert found["provenance"]["seen in the data"] == {
        "y": {"memory": 9},
        "w": {"memory": 9},
    }
    names = "first linear candidate", "first nonlinear candidate of another family"
    assert set(names) < set(found["beside"])
    assert found["next_command"] == done[1].split("Next: ")[1].strip()
    page = (folder / "report.html").read_text()
    section = page[page.index(">Leaderboard</h2>") : page.rindex(">The equations")]
    assert section.count("<svg") == 2 and "diverges: vetoed" in section
    assert section.count('class="used"') == 4  # in the short table and the long one
    assert "What is" not in section and "within one standard error" in section


def test_the_same_command_has_nothing_left_to_do(copy, capsys, monkeypatch):
    fake = searching(monkeypatch)
    before = Path("runs/engine-good/model.safetensors").read_bytes()
    code, text, _ = typed(capsys, LINE)
    assert code == 0 and not fake.tried
    assert "Going on with 10 candidates in runs/engine-good" in text
    assert Path("runs/engine-good/model.safetensors").read_bytes() == before


def test_another_search_needs_force(copy, capsys, monkeypatch):
    Path("engine.toml").write_text(TOML.replace('"r0.csv", ', ""))
    fake = searching(monkeypatch)
    before = {p.name for p in Path("runs/engine-good").iterdir()}
    code, _, told = typed(capsys, "identify engine.toml")
    assert code == 2 and "differs in records" in told and "--force" in told
    assert {p.name for p in Path("runs/engine-good").iterdir()} == before
    code, *_ = typed(capsys, "identify engine.toml --force --candidates 2")
    assert code == 0 and len(fake.tried) == 4
    assert len(os.listdir("runs/engine-good/candidates")) == 4


# leaderboard and choose -------------------------------------------------------------


def test_a_short_table_has_so_many_rows_and_names_the_command_for_all():
    rows = [row(2, n) for n in range(1, 30)] + [row(1, 99), row(0, 100)]
    text = table(Leaderboard(tuple(rows), NAMES), "y", top=10, command="show it")
    head, *lines = text.split("\n")
    assert "above best" in head and lines[-1].strip() == "and 21 more: show it"
    assert len(lines) == 11 and sum("ARX" in line for line in lines) == 1
    assert sum(line.startswith("*") for line in lines) == 1
    assert "0.1 ± 0.076" in next(line for line in lines if "ARX" in line)


def test_leaderboard_prints_the_table_or_csv(copy, capsys):
    code, text, _ = typed(capsys, "leaderboard runs/engine-good")
    assert code == 0 and text.count("polynomial") >= 2
    used = [s for s in text.split("\n") if s.startswith("*")]
    assert [s.split()[2] for s in used] == ["3", "8"]
    code, text, _ = typed(capsys, "leaderboard runs/engine-good --csv")
    assert text == Path("runs/engine-good/leaderboard.csv").read_text()
    code, _, told = typed(capsys, "leaderboard runs")
    assert code == 3 and "runs is no folder of a search" in told
    Path("runs/engine-good/search.json").write_text('{"format": 1}')
    code, _, told = typed(capsys, "leaderboard runs/engine-good")
    assert code == 3 and "cannot be read" in told


def test_take_makes_another_candidate_the_model(copy, capsys):
    from jaxnarx.models import load

    code, text, _ = typed(capsys, "choose runs/engine-good 2 9")
    assert code == 0 and "chosen by hand in place of 3 (polynomial: degree 2)" in text
    folder = Path("runs/engine-good-2-9")
    assert set(os.listdir(folder)) == FILES - {"leaderboard.csv"}
    assert load(folder / "model.safetensors").output_names == ["y", "w"]
    found = json.loads((folder / "report.json").read_text())["leaderboard"]
    assert (found["y"]["used"], found["w"]["used"]) == (2, 9)
    assert found["y"]["chosen"] == 3
    # of one output only: new data need not bring the other one along
    origin = Path("runs/engine-good/made_from.json")
    origin.write_text(json.dumps({"description": "/gone/engine.toml", "root": None}))
    code, _, told = typed(capsys, "choose runs/engine-good 2")
    assert code == 2 and "/gone/engine.toml" in told and "--description" in told
    words = "choose runs/engine-good 2 --description engine.toml --out one"
    assert typed(capsys, words)[0] == 0
    assert load("one/model.safetensors").channels.output_names == ["y"]


@pytest.mark.parametrize(
    ("line", "code", "words"),
    [
        ("choose runs/engine-good", 2, "give the number of a candidate"),
        ("choose runs/engine-good 99", 2, "no candidate 99: numbers go from 1 to 10"),
        ("choose runs/engine-good 2 3", 2, "2 and 3 are both of y"),
        ("choose runs/engine-good two", 2, "two"),
        ("choose runs/none 2", 3, "there is no such folder"),
        ("identify engine.toml --output x", 2, "there is no output 'x'"),
        ("identify engine.toml --preset fast", 2, "fast"),
        ("identify engine.toml --budget soon", 2, "--budget takes a time such as"),
        ("identify engine.toml --budget 0s", 2, "--budget takes a time such as"),
        ("identify engine.toml --candidates 0", 2, "--candidates must be at least 1"),
        ("identify engine.toml --hold-out 0.3", 2, "--hold-out belongs to one method"),
        (
            "identify engine.toml --preset quick --degree 2",
            2,
            "--degree makes this one",
        ),
        ("identify engine.toml --budget 9s --set grow=tree", 2, "--budget belongs to"),
        ("identify engine.toml --require-fit nan", 2, "--require-fit must be a number"),
    ],
)
def test_what_makes_no_sense_is_one_sentence(copy, capsys, line, code, words):
    before = sorted(Path().rglob("*"))
    found, _, told = typed(capsys, line)
    assert found == code and words in told
    assert sorted(Path().rglob("*")) == before


# ends before its time -------------------------------------------------------------


@pytest.fixture
def heard(monkeypatch):
    """Signals as the command line takes them."""
    before = signal.signal(signal.SIGINT, interrupt._raise)
    monkeypatch.setattr(interrupt, "_received", [])
    yield
    signal.signal(signal.SIGINT, before)


def test_ctrl_c_ends_with_the_best_and_the_same_command_goes_on(
    copy, capsys, monkeypatch, heard
):
    line = "identify engine.toml --output y --out part"
    fake = searching(monkeypatch, stop_after=3)
    code, text, told = typed(capsys, line)
    assert code == 130 and len(fake.tried) == 3
    assert "interrupted: this is the best so far, and the same command" in told
    assert f"Next: jaxnarx {line}  (goes on)" in text
    assert set(os.listdir("part")) == FILES | KEPT
    fake = searching(monkeypatch)
    code, text, _ = typed(capsys, line)
    assert code == 0 and fake.tried == ["y: shared feedback", "y: LOLIMOT"]
    assert "Going on with 3 candidates" in text


def test_ctrl_c_before_the_first_candidate_leaves_nothing(
    copy, capsys, monkeypatch, heard
):
    searching(monkeypatch, stop_after=0)
    code, _, told = typed(capsys, "identify engine.toml --out a/b")
    assert code == 130 and told.startswith("jaxnarx: interrupted")
    assert not Path("a").exists()


def test_data_that_cannot_be_searched_leave_nothing(copy, capsys, monkeypatch):
    searching(monkeypatch, error=DataError("output 'y' is constant"))
    code, _, told = typed(capsys, "identify engine.toml --preset ecu")
    assert code == 3 and "'y' is constant" in told
    assert not Path("runs/engine-ecu").exists()


def test_where_all_are_vetoed_the_safest_is_written_and_called_unusable(
    copy, capsys, monkeypatch
):
    Path("engine.toml").write_text(TOML.replace('test = ["r3.csv"]', ""))
    searching(monkeypatch, vetoed=True)
    code, text, told = typed(capsys, "identify engine.toml --output y --out lost")
    assert code == 1 and "Every candidate is vetoed" in text
    assert "diverged: so it ended" in told and "not usable: the free run of y" in told
    assert set(os.listdir("lost")) == FILES | KEPT
    words = shlex.split(text.split("Next: ")[1])
    assert words[words.index("--preset") + 1] == "linear"


def test_physics_of_the_description_is_handed_on(home, patched, capsys, tmp_path):
    patched.chdir(home)
    text = '\n[physics]\ny = {increases_with = ["a"]}\nw = {increases_with = ["b"]}\n'
    (home / "signs.toml").write_text(TOML + text)
    fake = searching(patched)
    line = f"identify signs.toml --output y --out {tmp_path / 'signs'}"
    code, out, _ = typed(capsys, line)
    assert code == 0 and fake.options["physics"] == {"y": Physics(increases_with=["a"])}
    assert "By physics: y rises with a\n" in out


def test_operating_points_of_the_description_are_handed_on(
    home, patched, capsys, tmp_path
):
    patched.chdir(home)
    first = (home / "r1.csv").read_text().splitlines()
    (home / "steady.csv").write_text("\n".join(first[:6]) + "\n")
    text = TOML.replace("[records]", '[records]\nat_rest = ["steady.csv"]')
    (home / "points.toml").write_text(text)
    fake = searching(patched)
    line = f"identify points.toml --output y --out {tmp_path / 'points'}"
    code, out, _ = typed(capsys, line)
    assert code == 0 and fake.options["at_rest"].samples == 5
    assert "5 operating points at rest, of steady\n" in out
