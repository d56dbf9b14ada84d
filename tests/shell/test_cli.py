"""The command line: exit codes, one clear sentence for every fault, files whole or not.

Commands run in this process, on one small engine whose compiled shapes they share; few
need a process of their own.
"""

import csv
import dataclasses
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import jax
import numpy as np
import pytest

from jaxnarx.errors import SpecError
from jaxnarx.files import cell
from jaxnarx.models import hold_to_range, load, save
from jaxnarx.shell.cli import run
from jaxnarx.shell.commands import COMMANDS
from jaxnarx.shell.commands.overview import TASK_COMMANDS
from jaxnarx.shell.output import file_names, slug

ROWS = 240
NAMES = ("speed", "load", "temp", "NOx")
UNITS = ("rpm", "%", "degC", "ppm")
QUICK = shlex.split(
    "--steps 2 --window-steps 2 --horizons 10 30 --input-lags 1 2 --terms 5"
)
PART = ["--output", "temp", *QUICK]
MODEL = "model.safetensors"
PARTS = 'train = ["{0}0.csv", "{0}1.csv"]\nvalidate = ["{0}2.csv"]\ntest = ["{0}3.csv"]'
FILES = sorted([MODEL, "report.html", "report.json"])

pytestmark = pytest.mark.usefixtures("remembered")


# a small engine in files ----------------------------------------------------------


def engine(rows: int, seed: int) -> np.ndarray:
    """Speed, load, temperature, NOx: bilinear and quadratic in lagged inputs."""
    rng = np.random.default_rng(seed)
    speed = np.repeat(rng.uniform(1000, 4000, rows // 12 + 1), 12)[:rows]
    load = np.repeat(rng.uniform(10, 90, rows // 9 + 1), 9)[:rows]
    s, l = speed / 1000, load / 50  # noqa: E741
    temp, nox = np.full(rows, 40.0), np.zeros(rows)
    for t in range(2, rows):
        temp[t] = 0.7 * temp[t - 1] + 3 + 4 * l[t - 1] * s[t - 1] + 2 * s[t - 2]
        nox[t] = 0.5 * nox[t - 1] + 0.3 * nox[t - 2] + 20 * l[t - 1] + 5 * l[t - 1] ** 2
    noise = rng.standard_normal((2, rows)) * [[0.3], [0.8]]
    return np.stack([speed, load, temp + noise[0], nox + noise[1]])


def write(path, columns: dict[str, np.ndarray]) -> None:
    with open(path, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        rows = zip(*(c.tolist() for c in columns.values()), strict=True)
        writer.writerows([f"{x:.8g}" for x in row] for row in rows)


def columns(seed: int = 9, rows: int = ROWS, names=NAMES) -> dict[str, np.ndarray]:
    return dict(zip(names, engine(rows, seed), strict=True))


def describe(
    path, records: str, *, inputs=2, extra="", names=NAMES, units=UNITS, dt=0.1
):
    """A description whose first `inputs` channels are inputs."""
    lines = [f"{json.dumps(n)} = {json.dumps(u)}" for n, u in zip(names, units)]  # noqa: B905
    text = ["[data]", f"sample_time = {dt}", extra]
    text += ["[channels.inputs]", *lines[:inputs]]
    text += ["[channels.outputs]", *lines[inputs:], "[records]", records]
    Path(path).write_text("\n".join(text) + "\n")


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("engine")
    for k in range(4):
        write(folder / f"r{k}.csv", columns(k))
    describe(folder / "engine.toml", PARTS.format("r"))
    return folder


@pytest.fixture(scope="module", autouse=True)
def settings():
    """Strict promotion, set by the tests, is not changed by any command."""
    names = ("jax_numpy_dtype_promotion", "jax_numpy_rank_promotion")
    before = [getattr(jax.config, name) for name in names]
    yield
    assert [getattr(jax.config, name) for name in names] == before


@pytest.fixture(autouse=True)
def place(files, tmp_path, monkeypatch) -> Path:
    """A folder of its own for every test, with the engine's files in it."""
    shutil.copytree(files, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def both(files, tmp_path_factory) -> Path:
    """A model of both outputs."""
    out = tmp_path_factory.mktemp("both") / "run"
    description = str(files / "engine.toml")
    assert run(["identify", description, *QUICK, "--out", str(out)]) == 0
    return out / MODEL


@pytest.fixture(scope="module")
def one(files, tmp_path_factory) -> Path:
    """A model of the first output only."""
    out = tmp_path_factory.mktemp("one") / "run"
    assert run(["identify", str(files / "engine.toml"), *PART, "--out", str(out)]) == 0
    return out / MODEL


def fails(capsys, code: int, arguments, *words: str) -> str:
    """The command ends with `code` and one sentence; nothing new is in the folder."""
    before = sorted(Path().rglob("*"))
    capsys.readouterr()
    assert run([str(a) for a in arguments]) == code
    text = capsys.readouterr().err
    assert text.startswith("jaxnarx: ") and "Traceback" not in text
    first, *rest = text.rstrip("\n").split("\n")
    assert all(line.startswith("  ") for line in rest)  # the first lines of a file
    for word in words:
        assert word in first, text
    assert sorted(Path().rglob("*")) == before
    return first


def passes(capsys, arguments) -> str:
    """The command succeeds without a word of complaint; returns what it printed."""
    capsys.readouterr()
    code = run([str(a) for a in arguments])
    told = capsys.readouterr()
    assert (code, told.err) == (0, "")
    return told.out


def table(path) -> dict[str, list[str]]:
    with open(path, newline="") as file:
        rows = list(csv.reader(file))
    return dict(zip(rows[0], map(list, zip(*rows[1:], strict=True)), strict=True))


def started(*arguments: str, **options):
    """The command line in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "jaxnarx.shell.cli", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


# help and usage -------------------------------------------------------------------


@pytest.mark.parametrize("name", COMMANDS)
def test_help_is_short_and_shows_an_example_that_parses(capsys, name):
    """It names every default. Keys of a description are told by `check` alone."""
    from jaxnarx.shell.commands.parse import parse

    assert run([name, "--help"]) == 0
    text = capsys.readouterr().out
    lines = text.split("\n")
    example = lines[lines.index("Example:") + 1]
    assert example.startswith(f"    jaxnarx {name}")
    assert isinstance(parse(shlex.split(example)[1:]), COMMANDS[name])
    # A flag has no twin that turns it off; limits are on without one.
    assert "None" not in text and "--no-" not in text.replace("--no-limits ", "")
    assert "(default: )" not in text
    assert len(text.splitlines()) <= 150
    paragraphs = re.split("positional arguments|options", text)[0].split("\n\n")
    assert max(len(p.split()) for p in paragraphs if "    [data]" not in p) < 110
    if name in ("identify", "invert", "report", "prepare"):
        assert "`jaxnarx check --help`" in text


def test_the_description_that_help_shows_can_be_read(capsys):
    run(["check", "--help"])
    text = capsys.readouterr().out
    begin = text.index("[data]")
    shown = text[begin : text.index("\n\n", begin)]
    Path("shown.toml").write_text("\n".join(s.strip() for s in shown.split("\n")))
    for k in range(2):
        write(f"day{k + 1}_a.csv", columns(k))
    assert "2 records" not in passes(capsys, ["check", "shown.toml"])


def test_an_unknown_preset_is_told_with_those_there_are(capsys):
    assert run(["identify", "x.toml", "--preset", "fast"]) == 2
    listed = "--preset must be one of 'quick', 'good', 'best', 'ecu', 'linear', got"
    assert listed in capsys.readouterr().err


def test_help_lists_every_key_of_a_description(capsys):
    from jaxnarx.data.description import parse_description

    run(["check", "--help"])
    text = capsys.readouterr().out
    begin = text.index("[data]", text.index("All keys of a description"))
    table = tomllib.loads(text[begin : text.index("Files are CSV")])
    known = parse_description({**table, "data": {"sample_time": 1.0}})
    assert known.channels.names == ["speed", "load", "NOx"]
    # what the parser knows is in help, and nothing else
    with pytest.raises(SpecError, match="unknown key 'qqq'") as caught:
        parse_description({**table, "data": {"qqq": 1}})
    listed = str(caught.value).split("Known names: ")[1].strip(".").split(", ")
    assert sorted(table["data"]) == sorted(listed)


def test_the_commands_are_listed_by_task_on_one_screen(capsys):
    words = list(dict.fromkeys(name.split()[0] for name in COMMANDS))
    assert [name for names in TASK_COMMANDS.values() for name in names] == words
    assert run(["--help"]) == 0
    text = capsys.readouterr().out
    lines = text.splitlines()
    assert len(lines) < 24 and max(map(len, lines)) <= 80
    rows = lines[3:-1]
    assert [row[:10].strip() for row in rows if row[0] != " "] == list(TASK_COMMANDS)
    assert [row[10:27].strip() for row in rows] == words
    assert all(row[27:].endswith(".") for row in rows)
    assert "130, 143 stopped" in text and "1 not usable" in text
    assert run([]) == 2
    assert capsys.readouterr().out == text


def test_the_version(capsys):
    assert run(["--version"]) == 0
    name, version = capsys.readouterr().out.split()
    assert name == "jaxnarx" and version[0].isdigit()


def test_an_unknown_command_is_suggested(capsys):
    fails(capsys, 2, ["idntify", "x.toml"], "no command 'idntify'", "'identify'")


@pytest.mark.parametrize(
    "arguments",
    [
        ["identify"],
        ["identify", "engine.toml", "--degre", "1"],
        ["identify", "engine.toml", "--degree", "two"],
        ["identify", "engine.toml", "--constant", "last"],
        ["check", "engine.toml", "--models", "2"],
        ["--models", "2"],
    ],
)
def test_what_cannot_be_parsed_is_usage(capsys, arguments):
    assert run(arguments) == 2
    text = capsys.readouterr().err
    assert "--help" in text and "Traceback" not in text


LIGHT = """
import sys, time
# Processor time: what runs beside a test must not decide it.
begin = time.process_time()
from jaxnarx.shell.cli import run
code = run(sys.argv[1:])
heavy = [m for m in ("jax", "numpy", "pyarrow", "matplotlib") if m in sys.modules]
print(code, time.process_time() - begin, heavy, file=sys.stderr)
"""


@pytest.mark.parametrize("name", ["", "identify"])
def test_help_answers_at_once_without_jax(name):
    arguments = [name, "--help"] if name else ["--help"]
    times = []
    for _ in range(5):
        done = subprocess.run(
            [sys.executable, "-c", LIGHT, *arguments], capture_output=True, text=True
        )
        code, seconds, heavy = done.stderr.split(maxsplit=2)
        assert code == "0" and heavy.strip() == "[]"
        times.append(float(seconds))
        if times[-1] < 0.5:
            break
    assert min(times) < 0.5


# check ----------------------------------------------------------------------------


def test_check_suggests_lags_and_the_next_command(capsys):
    text = passes(capsys, ["check", "engine.toml"])
    assert "2 records, 480 samples at 0.1 s for training" in text
    words = shlex.split(text.split("Next: ")[1])
    assert words == ["jaxnarx", "identify", "engine.toml", "--output", "temp"]
    assert "input lags" in text and "output lags" in text


def test_check_in_json_is_strict_and_holds_the_lags(capsys):
    def refuse(constant):
        raise AssertionError(constant)

    text = passes(capsys, ["check", "engine.toml", "--json"])
    found = json.loads(text, parse_constant=refuse)
    assert found["findings"]["is_okay"] is True
    assert found["lags"]["input_lags"][:2] == [0, 1]
    assert found["lags"]["pairs"][0].keys() == {
        "input",
        "output",
        "dead_time",
        "settling",
    }


def test_check_finds_what_is_bad_and_says_so_in_its_exit_code(capsys):
    write("r0.csv", columns() | {"temp": np.full(ROWS, 80.0)})
    describe("one.toml", 'files = ["r0.csv"]')
    assert run(["check", "one.toml"]) == 3
    text = capsys.readouterr().out
    assert "error: output temp is constant" in text
    assert "Next: jaxnarx check one.toml" in text
    assert run(["check", "one.toml", "--json"]) == 3
    assert json.loads(capsys.readouterr().out)["findings"]["is_okay"] is False


def test_check_of_duplicate_and_constant_inputs_is_a_warning(capsys):
    speed = columns()["speed"]
    write("r0.csv", columns() | {"load": 2 * speed})
    write("r1.csv", columns() | {"load": np.full(ROWS, 50.0)})
    describe("dup.toml", 'files = ["r0.csv"]')
    describe("flat.toml", 'files = ["r1.csv"]')
    assert "warning: load is 2 times speed" in passes(capsys, ["check", "dup.toml"])
    assert "warning: input load is constant" in passes(capsys, ["check", "flat.toml"])


def test_names_in_the_next_command_are_quoted(capsys):
    names = ("a b", "$(touch x)", "it's", "y")
    write("odd file.csv", columns(names=names))
    describe("odd file.toml", 'files = ["odd file.csv"]', names=names)
    text = passes(capsys, ["check", "odd file.toml"])
    words = shlex.split(text.split("Next: ")[1])
    assert words[2:5] == ["odd file.toml", "--output", "it's"]


# descriptions and data that cannot be used ----------------------------------------


def gap(at: int, name: str = "temp") -> dict[str, np.ndarray]:
    c = columns()
    c[name] = c[name].copy()
    c[name][at : at + 3] = np.nan
    return c


def bad_data(kind: str) -> str:
    """Write a description with one fault; returns its name."""
    records = 'files = ["r0.csv"]'
    options: dict[str, Any] = {}
    if kind == "gap":
        write("r0.csv", gap(100))
    elif kind == "column":
        options = {"names": ("sped", *NAMES[1:])}
    elif kind == "pattern":
        records = 'files = ["day*.csv"]'
    elif kind == "twice":
        records = 'train = ["r0.csv"]\nvalidate = ["r0.csv"]'
    elif kind == "copied":
        shutil.copy("r0.csv", "copy.csv")
        records = 'train = ["r0.csv"]\ntest = ["copy.csv"]'
    elif kind == "outside":
        records = 'files = ["../*.csv"]'
    elif kind == "key":
        options = {"extra": "sampletime = 3"}
    elif kind == "text":
        Path("r0.csv").write_text("speed,load,temp,NOx\n" + "1,2,3,4\n1,off,3,4\n" * 9)
    elif kind == "empty":
        Path("r0.csv").write_text("")
    describe("bad.toml", records, **options)
    if kind == "toml":
        Path("bad.toml").write_text("[data\n")
    elif kind == "none":
        Path("bad.toml").unlink()
    return "bad.toml"


DATA_FAULTS = {
    "gap": ("r0.csv", "temp has 3 NaN", "row 102", '"mask"', "[data]"),
    "column": ("r0.csv", "no column 'sped'", "'speed'"),
    "pattern": ("bad.toml", "'day*.csv'", "--root"),
    "twice": ("bad.toml", "r0.csv is in train and in validate"),
    "copied": ("bad.toml", "copy in test has the same contents as r0 in train"),
    "outside": ("bad.toml", "'../*.csv'"),
    "key": ("bad.toml", "'sampletime'", "'sample_time'"),
    "text": ("r0.csv", "load holds text", "'off'", "row 3"),
    "empty": ("r0.csv", "empty"),
    "toml": ("bad.toml", "not valid TOML", "line 1"),
    "none": ("bad.toml", "cannot be opened"),
}


@pytest.mark.parametrize("command", ["check", "identify", "report", "simulate"])
@pytest.mark.parametrize("kind", DATA_FAULTS)
def test_data_faults_are_one_sentence(capsys, command, kind, one):
    lead = [command] if command in ("check", "identify") else [command, one]
    name = bad_data(kind)
    fails(capsys, 3, [*lead, name], *DATA_FAULTS[kind])


@pytest.mark.parametrize("command", ["check", "identify"])
def test_a_csv_in_place_of_a_description_is_usage(capsys, command):
    fails(capsys, 2, [command, "r0.csv"], "r0.csv is not a TOML", "check --help")


def test_the_data_folder_may_be_given(capsys, monkeypatch):
    os.mkdir("far")
    shutil.move("r0.csv", "far/r9.csv")
    describe("far.toml", 'files = ["r9.csv"]')
    fails(capsys, 3, ["check", "far.toml"], "far.toml", "--root", "JAXNARX_DATA")
    fails(capsys, 3, ["check", "far.toml", "--root", "nowhere"], "nowhere")
    text = passes(capsys, ["check", "far.toml", "--root", "far"])
    assert "--root far" in text.split("Next: ")[1]
    monkeypatch.setenv("JAXNARX_DATA", "far")
    passes(capsys, ["check", "far.toml"])


# identify -------------------------------------------------------------------------


def test_identify_writes_a_run_and_tells_how(capsys, place):
    arguments = ["identify", "engine.toml", *PART, "--out", "runs/a b"]
    text = passes(capsys, arguments)
    assert sorted(os.listdir("runs/a b")) == FILES
    assert "2 records, 480 samples at 0.1 s for training" in text
    assert "Choosing 5 of 28 terms" in text
    assert "full record:" in text and "On test: RMSE" in text
    assert "\nGood: " in text and "why    the free run on test explains" in text
    following = shlex.split(text.split("Next: ")[1])
    assert following[:3] == ["jaxnarx", "simulate", f"runs/a b/{MODEL}"]
    found = json.loads(Path("runs/a b/report.json").read_text())
    assert shlex.split(found["provenance"]["command"]) == ["jaxnarx", *arguments]
    from jaxnarx.models.storage import load_about

    assert found["verdict"]["level"] == "good"
    about = load_about(f"runs/a b/{MODEL}")
    assert about["command"] == found["provenance"]["command"]


def test_a_run_is_not_overwritten_unless_told(capsys, one):
    out = one.parent
    before = one.read_bytes()
    again = ["identify", "engine.toml", *PART, "--out", out]
    fails(capsys, 2, again, str(out), "already holds", "--force")
    assert one.read_bytes() == before
    passes(capsys, [*again, "--force"])
    assert sorted(os.listdir(out)) == FILES


@pytest.mark.slow
def test_default_folders_are_numbered(capsys):
    arguments = ["identify", "engine.toml", *PART]
    os.makedirs("runs/engine-temp")
    for folder in ("runs/engine-temp-2", "runs/engine-temp-3"):
        assert folder in passes(capsys, arguments)
        assert sorted(os.listdir(folder)) == FILES
    assert os.listdir("runs/engine-temp") == []


def test_a_required_fit_decides_the_exit_code(capsys):
    arguments = ["identify", "engine.toml", *PART, "--require-fit"]
    passes(capsys, [*arguments, "50", "--out", "a"])
    assert run([*arguments, "99.99", "--out", "b"]) == 1
    text = capsys.readouterr().err
    assert "free-run fit of temp on test" in text and "required 99.99 %" in text
    assert sorted(os.listdir("b")) == FILES


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_few_records_are_cut_for_validation(capsys, count):
    names = [f"r{k}" for k in range(count)]
    describe("few.toml", f"files = {json.dumps([n + '.csv' for n in names])}")
    text = passes(capsys, ["identify", "few.toml", *PART, "--out", "run"])
    held = ", ".join(f"{n} (end)" for n in names)
    assert f"Held out for validation: {held}" in text
    assert "On validate: RMSE" in text


def test_outputs_that_are_not_modelled_are_not_needed_later(capsys, one):
    new = {k: v for k, v in columns().items() if k != "NOx"}
    write("new.csv", new)
    passes(capsys, ["simulate", one, "new.csv", "--out", "out"])
    assert not any("NOx" in name for name in table("out/new.csv"))


@pytest.mark.slow
def test_regions_are_made_and_may_follow_another_output(capsys):
    """With more terms asked for than there are: all of them."""
    flags = ["--degree", "1", "--terms", "500"]
    regions = ["--models", "3", "--schedule", "speed[t]", "NOx[t-1]"]
    arguments = ["identify", "engine.toml", *PART, *flags, *regions]
    text = passes(capsys, [*arguments, "--out", "run"])
    assert "Choosing 7 of 7 terms" in text
    assert "temp: 3 local models of 7 terms" in text
    passes(capsys, ["simulate", f"run/{MODEL}", "r3.csv", "--out", "out"])
    assert Path("out/r3.csv").is_file()


@pytest.mark.slow
def test_constant_and_duplicate_inputs_are_passed_over_aloud(capsys):
    for k in range(4):
        c = columns(k)
        c["speed"] = np.round(c["speed"])  # as exact in the file as its double
        write(f"d{k}.csv", c | {"load": 2 * c["speed"]})
        write(f"c{k}.csv", c | {"load": np.full(ROWS, 50.0)})
    for letter, reason in (("d", "the same as speed"), ("c", "constant")):
        describe("odd.toml", PARTS.format(letter))
        text = passes(capsys, ["identify", "odd.toml", *PART, "--out", letter])
        assert f"terms of load are passed over: {reason}" in text


def test_a_model_that_runs_away_is_not_passed_off_as_one(capsys, monkeypatch):
    from jaxnarx.shell import identify as path

    real = path.report

    def report(*arguments, **options):
        import dataclasses

        result = real(*arguments, **options)
        lost = dict.fromkeys(("rmse", "nrmse", "r2", "fit", "nmse"))
        lost |= {"status": "diverged", "extrapolated": outside}
        rows = [dataclasses.replace(r, **lost) for r in result.rows]
        return dataclasses.replace(result, rows=tuple(rows))

    outside = 0
    monkeypatch.setattr(path, "report", report)
    arguments = ["identify", "engine.toml", *PART]
    assert run([*arguments, "--out", "run"]) == 1
    told = capsys.readouterr()
    sentence = "the free run of temp on test diverges in r3"
    assert f"why    {sentence}" in told.out and f"not usable: {sentence}" in told.err
    # Not in a circle: another identification, with what keeps it from running away.
    words = shlex.split(told.out.split("Next: ")[1])
    assert words[:3] == ["jaxnarx", "identify", "engine.toml"]
    assert words[words.index("--select") + 1] == "simulation" and "--out" not in words
    # Samples out of range call for records that reach there, not for another model.
    outside = 150
    arguments += ["--force", "--require-fit", "1"]
    assert run([*arguments, "--out", "run"]) == 1
    told = capsys.readouterr()
    assert "temp on test is no figure (it diverges)" in told.err
    assert "train on records that reach as far" in " ".join(told.out.split())
    assert "fewer terms" not in told.out and "under train)" in told.out


USAGE = {
    "--output tmp": ("no output 'tmp'", "'temp'"),
    "--models 3": ("--models needs --schedule", "speed[t]"),
    "--models 3 --schedule sped[t]": ("'sped'", "'speed'"),
    "--models 3 --schedule speed": ("'speed'", "name[t]"),
    "--models 3 --schedule temp[t]": ("'temp[t]'", "'temp[t-1]'"),
    "--criterion bic": ("--criterion needs --schedule",),
    "--significance 0.1": ("--significance does not go with --select forward",),
    "--set refine.tolerance=-1": ("--set refine.tolerance", "got -1"),
    "--models 0": ("--models must be at least 1, got 0",),
    "--degree 5": ("--degree must be 1 to 4, got 5",),
    "--degree 0": ("--degree must be 1 to 4, got 0",),
    "--terms 0": ("--terms must be at least 1, got 0",),
    "--horizons 1": ("--horizons must be at least 2",),
    "--input-lags -1": ("--input-lags of 'speed'", "-1"),
    "--input-lags 1 1": ("--input-lags of 'speed' repeat",),
    "--output-lags 0": ("--output-lags of 'temp'", "at least 1"),
    "--steps -4": ("--steps must be at least 0, got -4",),
    "--ridge nan": ("--ridge", "nan"),
    "--ridge -1": ("--ridge", "-1"),
    "--hold-out 1.5": ("--hold-out", "between 0 and 1"),
    "--k-sigma -1 --models 2 --schedule speed[t]": ("--k-sigma must be positive",),
    "--require-fit nan": ("--require-fit", "nan"),
}


@pytest.mark.parametrize("flags", USAGE)
def test_settings_that_make_no_sense_are_usage(capsys, flags):
    arguments = ["identify", "engine.toml", *PART, *flags.split()]
    fails(capsys, 2, arguments, *USAGE[flags])


def test_units_that_differ_between_files_are_refused(capsys):
    for k, unit in enumerate(("rpm", "km/h")):
        text = Path(f"r{k}.csv").read_text().split("\n")
        Path(f"r{k}.csv").write_text(
            "\n".join([text[0], f"{unit},%,degC,ppm", *text[1:]])
        )
    describe("units.toml", 'files = ["r0.csv", "r1.csv"]', extra="unit_row = true")
    fails(capsys, 3, ["identify", "units.toml"], "r1.csv", "speed", "'km/h'", "'rpm'")


@pytest.mark.parametrize(
    "kind, words",
    [
        ("constant output", ("'temp' is constant",)),
        ("constant inputs", ("every input is constant", "speed", "load")),
        ("short", ("train: the longest record, r0, has 12 rows", "smaller lags")),
        ("lags", ("r0, has 192 rows", "lags up to 300")),
    ],
)
def test_data_that_nothing_can_be_learned_from(capsys, kind, words):
    c, more = columns(), []
    if kind == "constant output":
        c["temp"] = np.full(ROWS, 80.0)
    elif kind == "constant inputs":
        c |= {"speed": np.full(ROWS, 1e3), "load": np.full(ROWS, 50.0)}
    elif kind == "short":
        c = columns(rows=15)
    else:
        more = ["--input-lags", "1", "300"]
    write("r0.csv", c)
    describe("one.toml", 'files = ["r0.csv"]')
    fails(capsys, 3, ["identify", "one.toml", *PART, *more], *words)
    fails(capsys, 3, ["identify", "one.toml", *PART, *more, "--out", "a/b"], *words)


def test_log_and_report_state_one_nrmse_and_whole_names(capsys):
    """Validation records of another spread than training; two names alike at first."""
    names = ("speed", "load", "temp_before", "temp_behind")
    for k in range(4):
        c = columns(k, names=names)
        if k == 2:
            c = {n: np.resize(v[: ROWS // 4], ROWS) for n, v in c.items()}
        write(f"n{k}.csv", c)
    describe("n.toml", PARTS.format("n"), names=names)
    asked = [*QUICK, "--output", "temp_before", "--out", "run"]
    text = passes(capsys, ["identify", "n.toml", *asked])
    assert "temp_before one-step model" in text
    logged = float(text.split("free-run NRMSE on validation ")[1].split()[2])
    rows = json.loads(Path("run/report.json").read_text())["rows"]
    key = ("validate", "free run", "pooled")
    (row,) = [r for r in rows if (r["part"], r["mode"], r["record"]) == key]
    assert logged == pytest.approx(row["nrmse"], rel=1e-3)  # four digits are printed


# simulate -------------------------------------------------------------------------


def test_simulate_writes_what_it_computed_beside_what_was_measured(capsys, both):
    write("new.csv", columns())
    text = passes(capsys, ["simulate", both, "new.csv"])
    assert "1 record, 240 samples" in text and "wrote simulated/new.csv" in text
    assert "Next: jaxnarx report" in text
    found = table("simulated/new.csv")
    assert list(found)[:4] == ["time [s]", *(f"temp {k}" for k in KINDS)]
    measured = np.array(found["temp measured"], float)
    np.testing.assert_allclose(measured, columns()["temp"], rtol=1e-7)
    simulated = np.array(found["temp simulated"], float)
    assert np.std(simulated - measured) < 0.1 * np.std(measured)
    assert found["time [s]"][:3] == ["0", "0.1", "0.2"]
    error = np.sqrt(np.mean((simulated - measured) ** 2)) / np.std(measured)
    told = re.search(r"temp: simulated with an NRMSE of (\S+) over (\d+) meas", text)
    assert told is not None and 200 < int(told[2]) <= 240
    assert float(told[1]) == pytest.approx(error, rel=0.05)


def test_help_of_simulate_explains_every_column(capsys, both):
    run(["simulate", "--help"])
    text = capsys.readouterr().out
    for kind in (*KINDS, "predicted", "held", "lower", "upper", "extrapolated"):
        assert re.search(rf"\b{kind}\b", text), kind


def test_columns_without_spaces_on_request(capsys, both):
    write("new.csv", columns())
    passes(capsys, ["simulate", both, "new.csv", "--plain-names", "--out", "plain"])
    passes(capsys, ["simulate", both, "new.csv", "--out", "spaced"])
    plain, spaced = table("plain/new.csv"), table("spaced/new.csv")
    assert [n.replace(" ", "_") for n in spaced][1:] == list(plain)[1:]
    assert list(plain)[0] == "time_s" and "temp_simulated" in plain
    assert plain["temp_simulated"] == spaced["temp simulated"]


KINDS = ("simulated", "measured", "limited")


def test_order_and_number_of_columns_do_not_matter(capsys, both):
    new = columns()
    write("new.csv", new)
    write("turned.csv", dict(reversed(new.items())))
    write("more.csv", new | {"=oil": new["temp"]})
    names = ["new.csv", "turned.csv", "more.csv"]
    text = passes(capsys, ["simulate", both, *names, "--out", "out"])
    assert "read speed, load, temp, NOx, ignored any other column" in text
    assert len({Path("out", name).read_bytes() for name in names}) == 1


def test_extra_channels_of_a_description_are_named(capsys, one):
    text = passes(capsys, ["simulate", one, "engine.toml", "--out", "out"])
    assert "4 records, 960 samples at 0.1 s; ignored: NOx" in text
    assert len(os.listdir("out")) == 4


def test_outputs_may_be_missing_once_the_run_has_begun(capsys, both):
    """The run is the same as with them, bit by bit; their cells stay empty."""
    new = columns()
    write("new.csv", new)
    for name in ("temp", "NOx"):
        new[name][30:] = np.nan
    write("open.csv", new)
    passes(capsys, ["simulate", both, "new.csv", "open.csv", "--out", "out"])
    whole, open_ended = table("out/new.csv"), table("out/open.csv")
    for name in ("temp simulated", "NOx simulated", "extrapolated"):
        assert whole[name] == open_ended[name]
    assert open_ended["temp measured"][:30] == whole["temp measured"][:30]
    assert set(open_ended["temp measured"][30:]) == {""}


def test_steps_ahead(capsys, both):
    write("new.csv", columns())
    passes(capsys, ["simulate", both, "new.csv", "--steps", "5", "--out", "five"])
    passes(capsys, ["simulate", both, "new.csv", "--out", "free"])
    found, free = table("five/new.csv"), table("free/new.csv")
    begin = found["temp predicted"][:6]
    assert begin == found["temp measured"][:6]
    assert found["temp predicted"][6] == free["temp simulated"][6]
    assert found["temp predicted"][100] != free["temp simulated"][100]


@pytest.fixture
def held(both) -> str:
    """The model of both outputs with limits: temperatures of half their range."""
    network = load(both)
    low, high = np.array(network.low), np.array(network.high)
    middle, half = (low + high)[2] / 2, (high - low)[2] / 4
    low[2], high[2] = middle - half, middle + half
    ends = jax.device_put((low, high))
    network = dataclasses.replace(network, low=ends[0], high=ends[1])
    save(hold_to_range(network, 0.1, outside="hold"), "held.safetensors")
    return "held.safetensors"


def read_back(path: str, name: str) -> tuple[np.ndarray, str]:
    """A column and its unit, by another library than ours where there is one."""
    if path.endswith("parquet"):
        import pyarrow.parquet as parquet

        found = parquet.read_table(path)
        return found[name].to_numpy(), found.field(name).metadata[b"unit"].decode()
    if path.endswith("mat"):
        from scipy.io import loadmat

        found = loadmat(path)
        at = [str(n.item()) for n in found["names"][:, 0]].index(name)
        unit = [str(u.item()) if u.size else "" for u in found["units"][:, 0]][at]
        return found[name.replace(" ", "_")][:, 0], unit
    from asammdf import MDF

    with MDF(path) as mdf:
        signal = mdf.get(name)
    return np.asarray(signal.samples), signal.unit


def test_records_beyond_what_a_model_knows_are_told(capsys, both):
    new = columns()
    write("same.csv", new)
    low, high = float(np.min(new["load"])), float(np.max(new["load"]))
    # so shortly that the outputs stay within the bounds of their feedback
    new["load"][100:108] = high + 0.5 * (high - low)
    write("new.csv", new)
    text = passes(capsys, ["simulate", both, "same.csv", "new.csv", "--out", "out"])
    assert "of the samples are outside of the model's domain" in text
    assert "farthest: new" in text and "of load" in text
    index = np.array(table("out/new.csv")["index"], float)
    assert index[100:108].min() > 1 > np.median(index)
    assert "NOx lower" not in table("out/new.csv")
    plain = table("out/new.csv")
    for kind in ("parquet", "mat", "mf4"):
        words = ["simulate", both, "new.csv", "--out", kind, "--format", kind]
        assert f"wrote {kind}/new.{kind}" in passes(capsys, words)
        y, unit = read_back(f"{kind}/new.{kind}", "NOx simulated")
        # CSV has ten digits
        expected = np.array(plain["NOx simulated"], float)
        np.testing.assert_allclose(y, expected, rtol=1e-9)
        assert unit == load(both).output_channels[-1].unit
    passes(capsys, ["simulate", both, "new.csv", "--out", "wide", "--level", ".95"])
    found = table("wide/new.csv")
    low, y, high = (
        np.array(found[f"NOx {what}"], float)
        for what in ("lower", "simulated", "upper")
    )
    np.testing.assert_allclose(high - y, y - low, rtol=1e-6)
    half = (high - low) / 2
    assert np.median(half[100:108]) > 2 * np.median(half[:100]) > 0
    straight, still = (
        passes(capsys, ["simulate", both, "new.csv", "--out", name, "--outside", name])
        and table(f"{name}/new.csv")["NOx simulated"]
        for name in ("linear", "hold")
    )
    assert straight[:100] == still[:100] and straight[107] != still[107]
    describe("beyond.toml", 'train = ["new.csv"]')
    told = passes(capsys, ["check", "beyond.toml", "--model", both])
    assert "outside the domain" in told and "of load" in told
    found = json.loads(
        passes(capsys, ["check", "beyond.toml", "--model", both, "--json"])
    )
    assert 0.01 < found["outside"] < 0.5
    assert found["excursions"][0]["channel"] == "load"


def test_limits_hold_what_is_simulated_unless_they_are_not_wanted(capsys, both, held):
    write("new.csv", columns())
    text = passes(capsys, ["simulate", held, "new.csv", "--out", "held"])
    passes(capsys, ["simulate", both, "new.csv", "--out", "free"])
    more = ["simulate", held, "new.csv", "--out", "off", "--no-limits"]
    assert "held at the edge" not in passes(capsys, more)
    found, free, off = (table(f"{n}/new.csv") for n in ("held", "free", "off"))
    assert off == free and set(free["temp held"]) == {"0"}
    network = load(held)
    low, high = (float(np.asarray(a)[2]) for a in (network.low, network.high))
    reach = 0.1 * (high - low)
    y = np.array(found["temp simulated"], float)[2:]
    mask = np.array(found["temp held"])[2:] == "1"
    assert y.min() >= low - reach - 1e-6 and y.max() <= high + reach + 1e-6
    at_edge = np.isclose(y, low - reach) | np.isclose(y, high + reach)
    np.testing.assert_array_equal(mask, at_edge)
    assert f"temp: {mask.sum()} samples of {ROWS} held at the edge" in text


def test_a_report_tells_what_limits_hold_unless_they_are_not_wanted(capsys, both, held):
    told = passes(capsys, ["report", held, "engine.toml", "--out", "told"])
    assert "were held at the edge of the trained range" in " ".join(told.split())
    page = Path("told", "report.html").read_text()
    assert "Reported outputs stay within their trained ranges, widened by 10 %" in page
    text = passes(capsys, ["report", held, "engine.toml", "--no-limits"])
    assert "held at the edge" not in " ".join(text.split())
    assert "engine.toml --no-limits --out FOLDER" in text
    plain = passes(capsys, ["report", both, "engine.toml"])
    assert text.replace("--no-limits ", "").replace(held, str(both)) == plain


def new_file(kind: str) -> list[str]:
    """Files and options with one fault."""
    new = columns()
    if kind == "lacking":
        del new["load"]
    elif kind == "short":
        new = columns(rows=1)
    elif kind == "input gap":
        new = gap(100, "speed")
    elif kind in ("output gap", "late start"):
        new = gap(100)
        if kind == "late start":
            new["temp"][:] = np.nan
    write("new.csv", new)
    options = {
        "output gap": ["--steps", "3"],
        "far": ["--steps", "500"],
        "zero": ["--steps", "0"],
        "level": ["--level", "2"],
        "level and steps": ["--level", ".9", "--steps", "3"],
        "folder": ["--out", "r0.csv"],
        "below a file": ["--out", "r0.csv/x"],
    }
    if kind == "units":
        describe("units.toml", 'files = ["r0.csv"]', units=("km/h", *UNITS[1:]))
        return ["units.toml"]
    if kind == "sample time":
        describe("time.toml", 'files = ["r0.csv"]', dt=0.2)
        return ["time.toml"]
    if kind == "mixed":
        return ["new.csv", "engine.toml"]
    return ["none.csv" if kind == "none" else "new.csv", *options.get(kind, [])]


NEW_FAULTS = {
    "lacking": (3, "new.csv", "no column 'load'"),
    "short": (3, "new", "needs 2 valid measured samples"),
    "input gap": (3, "new.csv", "speed has 3 empty", "row 102", "t = 10 s"),
    "output gap": (3, "new.csv", "temp has 3 empty", "row 102", "--steps"),
    "late start": (3, "new.csv", "temp has no valid sample"),
    "far": (2, "--steps 500", "240 samples"),
    "zero": (2, "--steps must be at least 1, got 0"),
    "units": (3, "units.toml", "speed", "'km/h'", "'rpm'"),
    "sample time": (3, "time.toml", "0.1 s", "0.2 s"),
    "mixed": (2, "not both"),
    "level": (2, "level must lie from 0.5 to 0.99, got 2.0"),
    "level and steps": (2, "--level is for free runs; leave out --steps"),
    "none": (3, "none.csv", "no such file"),
    "folder": (3, "r0.csv: cannot be written", "--out"),
    "below a file": (3, "r0.csv/x: cannot be written", "--out"),
}


@pytest.mark.parametrize("kind", NEW_FAULTS)
def test_faults_of_new_data_are_one_sentence(capsys, kind, both):
    code, *words = NEW_FAULTS[kind]
    arguments = new_file(kind)
    fails(capsys, code, ["simulate", both, *arguments], *words)


def test_no_new_data_is_usage(capsys, both):
    fails(capsys, 2, ["simulate", both], "give data files")


def test_results_are_not_overwritten_unless_told(capsys, both):
    arguments = ["simulate", both, "r3.csv", "--out", "out"]
    passes(capsys, arguments)
    fails(capsys, 2, arguments, "out already holds r3.csv", "--force")
    passes(capsys, [*arguments, "--force"])
    assert os.listdir("out") == ["r3.csv"]


def test_odd_file_names_stay_inside_the_folder(capsys, one):
    os.makedirs("a/b")
    os.makedirs("c/b")
    names = ["=1+1, näme<b>.csv", "a/b/r.csv", "c/b/r.csv"]
    for name in names:
        shutil.copy("r3.csv", name)
    passes(capsys, ["simulate", one, *names, "--out", "out"])
    assert sorted(os.listdir("out")) == ["1_1_n_me_b.csv", "a_b_r.csv", "c_b_r.csv"]


@pytest.mark.parametrize(
    "damage", ["cut", "junk", "empty", "foreign", "none", "folder"]
)
@pytest.mark.parametrize("command", ["simulate", "report"])
def test_models_that_cannot_be_used(capsys, command, damage, one):
    from safetensors.numpy import save_file

    data = one.read_bytes()
    if damage == "foreign":
        save_file({"a": np.zeros(2)}, "bad")
    elif damage == "folder":
        os.mkdir("bad")
    elif damage != "none":
        text = {"cut": data[:-9], "junk": b"PK\3\4" * 99, "empty": b""}[damage]
        Path("bad").write_bytes(text)
    new = "r3.csv" if command == "simulate" else "engine.toml"
    fails(capsys, 3, [command, "bad", new], "bad: ")


# report ---------------------------------------------------------------------------


def test_report_prints_and_writes_when_asked(capsys, both):
    text = passes(capsys, ["report", both, "engine.toml"])
    assert "free run" in text and text.startswith(("Good: ", "Usable with limits: "))
    assert shlex.split(text.split("Next: ")[1])[4:6] == ["--out", "FOLDER"]
    arguments = ["report", both, "engine.toml", "--out", "out"]
    assert "Open out/report.html" in passes(capsys, arguments)
    assert sorted(os.listdir("out")) == ["report.html", "report.json"]
    fails(capsys, 2, arguments, "out already holds report.json", "--force")
    arguments += ["--force", "--junit", "out/verdict.xml"]
    passes(capsys, [*arguments, "--require-fit", "50"])
    assert "required fit" not in failures("out/verdict.xml")
    assert run([str(a) for a in (*arguments, "--require-fit", "100")]) == 1
    assert capsys.readouterr().err.count("below the required 100 %") == 2
    assert failures("out/verdict.xml").count("required fit %") == 2
    assert sorted(os.listdir("out")) == ["report.html", "report.json", "verdict.xml"]


def failures(path: str) -> str:
    """The messages of the failures in a file of test cases."""
    found = ET.parse(path).iter("failure")
    return " ".join(failure.get("message", "") for failure in found)


def test_report_needs_channels_units_and_rows_that_fit(capsys, both):
    describe("units.toml", 'files = ["r0.csv"]', units=("km/h", *UNITS[1:]))
    describe("lack.toml", 'files = ["r0.csv"]', names=NAMES[:3], units=UNITS[:3])
    write("r1.csv", columns(rows=9))
    describe("short.toml", 'files = ["r1.csv"]')
    fails(capsys, 3, ["report", both, "units.toml"], "units.toml", "'km/h'", "'rpm'")
    fails(capsys, 3, ["report", both, "lack.toml"], "lack.toml", "no channel 'NOx'")
    fails(capsys, 3, ["report", both, "short.toml"], "data", "r1", "9 rows")


def test_the_channels_of_a_map_are_named_by_their_option(capsys, both):
    arguments = ["report", both, "engine.toml", "--map", "speed"]
    fails(capsys, 2, arguments, "--map must name two channels", "speed")


def test_the_data_a_model_was_trained_on_are_called_that(capsys, both):
    os.rename("engine.toml", "same.toml")
    records = 'train = ["r0.csv"]\nvalidate = ["r1.csv"]'
    describe("same.toml", records)
    assert "No test data" in passes(capsys, ["report", both, "same.toml"])


# hostile names --------------------------------------------------------------------

HOSTILE = ("<script>alert(1)</script>", '=HYPERLINK("x")', 'a&b"c</svg>', "@N'Ox")


def test_hostile_channel_names_harm_nothing(capsys):
    for k in range(4):
        write(f"h{k}.csv", columns(k, names=HOSTILE))
    units = ("<i>", "%", "</td>", "ppm")
    describe("h.toml", PARTS.format("h"), names=HOSTILE, units=units)
    passes(capsys, ["identify", "h.toml", *QUICK, "--out", "run"])
    page = Path("run/report.html").read_text()
    ours = ['<script type="application/json" id="report-data">', *["<script>"] * 3]
    assert re.findall(r"<script[^>]*>", page, flags=re.I) == ours
    assert "&lt;script&gt;" in page
    for text in ("<i>", "c</svg>", "</td></td>", "http://", "https://"):
        assert text not in page.replace("http://www.w3.org", "")
    passes(capsys, ["simulate", f"run/{MODEL}", "h0.csv", "--out", "out"])
    names = list(table("out/h0.csv"))
    assert "'@N'Ox simulated" in names and 'a&b"c</svg> simulated' in names
    assert not any(name[0] in "=+-@\t\r" for name in names)


def test_cells_and_file_names():
    assert [cell(t) for t in ("=1", "+a", "-b", "@c", "\td", "\re", "f", "")] == [
        *("'=1", "'+a", "'-b", "'@c", "'\td", "'\re", "f", "")
    ]
    assert slug("../../etc/passwd") == "etc_passwd"
    assert slug("..") == slug("") == slug("/") == "unnamed"
    assert len(slug("x" * 500)) == 100
    assert file_names(["a", "a-2", "a", "A", "ä"]) == [
        *("a.csv", "a-2.csv", "a-3.csv", "A-4.csv", "unnamed.csv")
    ]


# faults of the machine ------------------------------------------------------------


def test_a_disk_that_fills_up_leaves_nothing(capsys, one, monkeypatch):
    from jaxnarx.shell import formats, output

    real = output.write_text

    def full(path, text):
        real(path, text[:10])
        raise OSError(28, "No space left on device", str(path))

    for module in (output, formats):
        monkeypatch.setattr(module, "write_text", full)
    fails(capsys, 3, ["identify", "engine.toml", *PART, "--out", "a/b"], "No space")
    fails(capsys, 3, ["simulate", one, "r3.csv"], "No space")
    before = {f: (one.parent / f).read_bytes() for f in FILES}
    force = ["--out", one.parent, "--force"]
    fails(capsys, 3, ["identify", "engine.toml", *PART, *force], "No space")
    assert {f: (one.parent / f).read_bytes() for f in os.listdir(one.parent)} == before


def test_a_folder_that_cannot_be_written_is_found_before_the_work(capsys, monkeypatch):
    def refuse(path: Path, *arguments, **options):
        raise PermissionError(13, "Permission denied", str(path))

    os.mkdir("out")
    monkeypatch.setattr(Path, "mkdir", refuse)
    monkeypatch.setattr("jaxnarx.shell.identify.identify", None)
    arguments = ["identify", "engine.toml", *PART, "--out", "out"]
    fails(capsys, 3, arguments, "out: cannot be written (Permission denied)", "--out")


def test_ctrl_c_is_130_and_leaves_nothing(capsys, monkeypatch, remembered):
    remembered.clear()

    def stop(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("jaxnarx.identification._by_method.refine", stop)
    fails(capsys, 130, ["identify", "engine.toml", *PART], "interrupted")


def test_too_little_memory_is_said_in_words(capsys, monkeypatch, remembered):
    remembered.clear()

    def exhausted(*arguments, **options):
        raise RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 9 bytes.")

    monkeypatch.setattr("jaxnarx.identification._by_method.select", exhausted)
    fails(capsys, 3, ["identify", "engine.toml", *PART], "memory", "fewer lags")


def test_a_defect_is_not_taken_for_a_bad_fit(capsys, monkeypatch, remembered):
    remembered.clear()

    def defect(*arguments, **options):
        raise IndexError("off by one")

    monkeypatch.setattr("jaxnarx.identification._by_method.select", defect)
    assert run(["identify", "engine.toml", *PART]) == 70
    text = capsys.readouterr().err
    assert "IndexError: off by one" in text and "defect of jaxnarx" in text
    assert not Path("runs").exists()


# processes of their own -----------------------------------------------------------


@pytest.mark.parametrize(
    "arguments, code",
    [(("check", "engine.toml"), 0), (("check", "--help"), 0), (("--help",), 0)],
)
def test_nobody_reading_is_no_fault(arguments, code):
    process = started(*arguments)
    assert process.stdout and process.stderr
    process.stdout.close()
    assert process.stderr.read() == ""
    process.stderr.close()
    assert process.wait() == code


@pytest.mark.slow
@pytest.mark.parametrize("own", [False, True])
def test_compiled_programs_are_kept_where_the_user_says(tmp_path, own):
    names = ("JAX_COMPILATION_CACHE_DIR", "XDG_CACHE_HOME")
    environment = {k: v for k, v in os.environ.items() if k not in names}
    environment["XDG_CACHE_HOME"] = str(tmp_path / "home")
    if own:
        environment[names[0]] = str(tmp_path / "own")
    words = "from jaxnarx.shell import dispatch; dispatch._configure(); import jax; "
    words += "print(jax.config.jax_compilation_cache_dir)"
    found = subprocess.run(
        [sys.executable, "-c", words], env=environment, text=True, capture_output=True
    )
    wanted = tmp_path / ("own" if own else "home/jaxnarx/compiled")
    assert found.stdout.strip() == str(wanted)


@pytest.mark.slow
def test_half_written_programs_are_compiled_anew(tmp_path):
    # all programs are kept, whatever the environment says of short ones
    kept = {"JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    environment = os.environ | {"JAX_COMPILATION_CACHE_DIR": str(tmp_path)} | kept
    words = "from jaxnarx.shell import dispatch; dispatch._configure(); import jax; "
    words += "print(jax.jit(lambda x: x * 3)(2.0))"
    for _ in range(2):
        found = subprocess.run(
            [sys.executable, "-c", words],
            env=environment,
            text=True,
            capture_output=True,
        )
        assert found.stdout == "6.0\n" and "cache" not in found.stderr
        programs = list(tmp_path.glob("*-cache"))
        assert programs
        for program in programs:
            program.write_bytes(program.read_bytes()[:20])


@pytest.mark.slow
def test_ctrl_c_during_refinement():
    long = ["--steps", "400", "--window-steps", "400", "--horizons", "10", "30", "100"]
    long += ["--input-lags", "1", "2", "3", "4", "5", "--terms", "40"]
    process = started("identify", "engine.toml", *long, "--out", "a/run")
    assert process.stdout
    for line in process.stdout:
        if line.startswith("Refining"):
            break
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    _, told = process.communicate(timeout=60)
    assert process.returncode == 130
    # Where reading has taken long it is told before.
    assert told.splitlines()[-1].startswith("jaxnarx: interrupted")
    assert not Path("a").exists()


@pytest.mark.slow
def test_the_demo(capsys):
    assert run(["demo", "--events", "600", "--models", "2", "--out", "demo"]) == 0
    assert sorted(os.listdir("demo")) == FILES
    assert "Next: jaxnarx check engine.toml" in capsys.readouterr().out
    fails(capsys, 2, ["demo", "--out", "demo"], "demo already holds", "--force")
    fails(capsys, 2, ["demo", "--events", "10"], "--events must be at least 200")
