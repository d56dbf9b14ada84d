"""`jaxnarx prepare`: files that read back as they were, and a model that remembers."""

import csv
import json
import os
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

from jaxnarx.data import (
    Channel,
    Channels,
    Dataset,
    Hampel,
    Preparation,
    Scale,
    ToCrankAngle,
    match_channels,
    prepare,
    read_split,
)
from jaxnarx.models import load, load_about, save
from jaxnarx.shell import commands
from jaxnarx.shell.cli import run
from jaxnarx.shell.prepare import make_steps, raw_channels, stored_preparation
from jaxnarx.shell.record_files import describe, record_csv
from jaxnarx.simulation import simulate

pytestmark = pytest.mark.usefixtures("remembered")
ROWS = 500
FLAGS = shlex.split(
    "--hampel 5 --low-pass 4 --decimate 2 --offset mean --scale min-max"
)
IDENTIFY = shlex.split(
    "--steps 0 --input-lags 1 2 --output-lags 1 --degree 1 --terms 5"
)
DESCRIPTION = """
[data]
sample_time = 0.05
[channels.inputs]
speed = "rpm"
"=load" = {column = "load", unit = "%"}
[channels.outputs]
"NOx" = "ppm"
[records]
train = ["r0.csv", "r1.csv"]
validate = ["r2.csv"]
test = ["r3.csv"]
"""


def engine(seed: int) -> np.ndarray:
    """Time [s], speed [rpm], load [%] and a NOx [ppm] of first order, with a spike."""
    rng = np.random.default_rng(seed)
    speed = np.repeat(rng.uniform(1000, 4000, 20), 25) + rng.standard_normal(ROWS)
    load = np.repeat(rng.uniform(10, 90, 25), 20)
    nox = np.full(ROWS, 300.0)
    for t in range(1, ROWS):
        nox[t] = 0.8 * nox[t - 1] + 0.02 * speed[t - 1] + load[t - 1]
    nox += rng.standard_normal(ROWS)
    nox[200 + seed] += 900
    return np.stack([0.05 * np.arange(ROWS), speed, load, nox])


def write(path: Path, columns: np.ndarray) -> None:
    with open(path, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time", "speed", "load", "NOx"])
        writer.writerows(columns.T.tolist())


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """Raw records, prepared ones, and a model of the prepared ones."""
    folder = tmp_path_factory.mktemp("engine")
    for k in range(4):
        write(folder / f"r{k}.csv", engine(k))
    (folder / "engine.toml").write_text(DESCRIPTION)
    raw, done = str(folder / "engine.toml"), str(folder / "done")
    assert run(["prepare", raw, "--out", done, *FLAGS]) == 0
    model = ["--out", str(folder / "model"), *IDENTIFY]
    assert run(["identify", f"{done}/prepared.toml", *model]) == 0
    return folder


@pytest.fixture(autouse=True)
def place(files, tmp_path, monkeypatch) -> Path:
    """A folder of its own for every test, with everything in it."""
    shutil.copytree(files, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def passes(capsys, arguments: str) -> str:
    capsys.readouterr()
    code = run(shlex.split(arguments))
    told = capsys.readouterr()
    assert (code, told.err) == (0, "")
    return told.out


def fails(capsys, code: int, arguments: str) -> str:
    """One sentence and nothing written."""
    before = sorted(Path().rglob("*"))
    capsys.readouterr()
    assert run(shlex.split(arguments)) == code
    text = capsys.readouterr().err
    assert text.startswith("jaxnarx: ") and text.count("\n") == 1
    assert sorted(Path().rglob("*")) == before
    return text


def same(a: Dataset, b: Dataset):
    """Equal to the last bit; names of records follow their files."""
    assert a.channels == b.channels and a.sample_time == b.sample_time
    for r, s in zip(a, b, strict=True):
        np.testing.assert_array_equal(r.valid, s.valid)
        np.testing.assert_array_equal(r.u, s.u)
        np.testing.assert_array_equal(r.y, s.y)


# files ----------------------------------------------------------------------------


def test_what_is_left_out_together_stays_so(capsys):
    text = DESCRIPTION + 'groups = {"a \\"cold\\" one" = ["r1*"]}\n'
    Path("engine.toml").write_text(text)
    passes(capsys, "prepare engine.toml --decimate 2 --out grouped")
    done = read_split("grouped/prepared.toml")
    assert [r.group for r in done.all] == ["", 'a "cold" one', "", ""]


def test_signs_of_gains_stay(place, capsys):
    signs = 'NOx = {increases_with = ["speed", "=load"], longest_time_constant = 9.5}'
    (place / "signs.toml").write_text(f"{DESCRIPTION}[physics]\n{signs}\n")
    passes(capsys, "prepare signs.toml --out signs --scale standard")
    raw, done = read_split("signs.toml"), read_split("signs/prepared.toml")
    assert raw.physics and done.physics == raw.physics


def test_what_is_written_reads_back_as_it_was():
    """Fitted to the training records only, applied to every part."""
    raw, done = read_split("engine.toml"), read_split("done/prepared.toml")
    assert raw.train is not None and raw.validate is not None and raw.test is not None
    assert done.train is not None and done.validate is not None
    assert done.test is not None and done.preparation is not None
    steps = done.preparation.steps
    kinds = ["OutliersMasked", "LowPass", "Decimate", "OffsetRemoved", "Scaled"]
    assert [type(s).__name__ for s in steps] == kinds
    same(done.train, done.preparation.apply(raw.train))
    same(done.validate, done.preparation.apply(raw.validate))
    same(done.test, done.preparation.apply(raw.test))
    train = np.concatenate([r.y[r.valid[:, 2]] for r in done.train])
    assert (train.min(), train.max()) == (0.0, 1.0)
    assert max(np.ptp(r.y) for r in done.all) > 0
    assert done.all.sample_time == 0.1
    assert all(c.unit == "-" for c in done.all.channels.all)


def test_the_spikes_are_empty_cells_and_reported(capsys):
    text = passes(capsys, "prepare engine.toml --out spikes --hampel 5")
    assert "Fitted to 2 records, 1000 samples for training" in text
    assert "NOx: 4 masked (0.2 %) in 4 record(s)" in text
    with open("spikes/r3.csv", newline="") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["time [s]", "speed", "'=load", "NOx"]
    assert [k for k, row in enumerate(rows[1:]) if "" in row] == [203]
    assert rows[204][:1] == ["10.15"] and rows[204][3] == ""


def test_the_next_command_works(capsys):
    text = passes(capsys, "prepare engine.toml --out next --decimate 2 --detrend")
    words = text.split("Next: jaxnarx ")[1]
    assert words.strip() == "check next/prepared.toml"
    assert "jaxnarx identify next/prepared.toml" in passes(capsys, words)


def test_the_next_command_works_beside_a_folder_for_data(capsys, monkeypatch):
    monkeypatch.setenv("JAXNARX_DATA", os.getcwd())
    words = passes(capsys, "prepare engine.toml --out next --decimate 2")
    words = words.split("Next: jaxnarx ")[1]
    assert words.strip() == "check next/prepared.toml --root next"
    assert "2 records, 500 samples" in passes(capsys, words)


def test_preparing_twice_keeps_both(capsys):
    passes(capsys, "prepare engine.toml --out one --hampel 5 --decimate 2")
    passes(capsys, "prepare one/prepared.toml --out two --scale standard")
    passes(capsys, "prepare engine.toml --out both --hampel 5 --decimate 2 "
                   "--scale standard")  # fmt: skip
    two, both = read_split("two/prepared.toml"), read_split("both/prepared.toml")
    assert two.preparation == both.preparation
    same(two.all, both.all)


def test_files_without_parts_stay_without(capsys):
    text = DESCRIPTION.split("train")[0] + 'files = ["r*.csv"]\n'
    Path("all.toml").write_text(text)
    told = passes(capsys, "prepare all.toml --out all --scale mean")
    assert "Fitted to 4 records, 2000 samples: all that are described" in told
    assert (
        'files = ["r0.csv", "r1.csv", "r2.csv", "r3.csv"]'
        in Path("all/prepared.toml").read_text()
    )


def test_odd_names_are_quoted():
    """Quotes, commas, formulas and a channel named as the time column is."""
    names = ['a"b', "x, y", "=1+1", "time [s]", "ü\\"]
    channels = Channels((), tuple(Channel(n, "µg\\") for n in names))
    values = np.arange(15.0).reshape(3, 5) / 7
    data = Dataset.from_arrays(
        None, values, inputs=[], outputs=channels.outputs, sample_time=1e-5
    )
    text = describe(data, {"files": ["a.csv"]}, by="a test")
    Path("odd.toml").write_text(text, encoding="utf-8")
    Path("a.csv").write_text(record_csv(data, 0), encoding="utf-8")
    same(read_split("odd.toml").all, data)


# wrong use ------------------------------------------------------------------------


@pytest.mark.parametrize(
    "flags, code, words",
    [
        ("", 2, "give at least one step"),
        ("--decimate 1", 2, "--decimate must be a whole number from 2 on, got 1"),
        ("--decimate 80", 3, "r0: of 500 samples 7 would be left"),
        ("--resample 0", 2, "--resample must be a positive"),
        ("--hampel 0", 2, "--hampel must be at least 1"),
        ("--hampel 300", 3, "r0 has 500 rows, the window of the outlier search 601"),
        ("--low-pass 10", 2, "--low-pass is 10 Hz, but samples of 0.05 s hold"),
        ("--low-pass 0.01", 3, "r0 lasts 25 s, less than one period"),
    ],
)
def test_what_cannot_be_done_is_said_and_nothing_written(capsys, flags, code, words):
    assert words in fails(capsys, code, f"prepare engine.toml --out no {flags}")


def test_earlier_files_are_not_overwritten_unasked(capsys):
    arguments = "prepare engine.toml --out done --scale mean"
    assert "already holds" in fails(capsys, 2, arguments)
    passes(capsys, arguments + " --force")


@pytest.mark.parametrize(
    "text, words",
    [
        ("", "not what `jaxnarx prepare` writes"),
        ("[1]", "preparation must be"),
        ('{"format": 9}', "format 9"),
    ],
)
def test_a_damaged_preparation_is_said(capsys, text, words):
    Path("done/preparation.json").write_text(text)
    told = fails(capsys, 3, "check done/prepared.toml")
    assert words in told and "preparation.json" in told


def test_a_missing_or_outside_preparation_is_said(capsys):
    Path("done/preparation.json").unlink()
    assert "cannot be opened" in fails(capsys, 3, "check done/prepared.toml")
    file = Path("done/prepared.toml")
    for name in ("../preparation.json", "/preparation.json", ""):
        file.write_text(
            DESCRIPTION.replace("[data]", f'[data]\npreparation = "{name}"')
        )
        told = fails(capsys, 3, "check done/prepared.toml")
        assert "preparation must be a file in the data folder" in told


# the model remembers --------------------------------------------------------------


def test_the_model_keeps_the_preparation(capsys):
    kept = stored_preparation("model/model.safetensors")
    assert kept is not None
    assert kept == read_split("done/prepared.toml").preparation
    assert "preparation" in load_about("model/model.safetensors")


def test_the_report_counts_what_was_masked(capsys):
    """Every record has one spike: two of them in training."""
    told = json.loads(Path("model/report.json").read_text())
    train = read_split("done/prepared.toml").train
    assert train is not None
    lost = sum(int((~r.valid).sum()) for r in train)
    share = f"NOx {lost} ({100 * lost / ROWS:.2g} %)"  # decimated by two, two records
    assert any("Masked in train" in n and share in n for n in told["notes"])
    assert "outlier" in told["provenance"]["preparation"].lower()
    again = "report model/model.safetensors done/prepared.toml --out again"
    assert "Masked in test" in passes(capsys, again)
    page = Path("again/report.html").read_text()
    assert "outlier" in page.lower()


def test_raw_files_are_prepared_as_the_training_records_were(capsys):
    """The same free run as on the prepared files, and the scale is said."""
    # raw files hold the model's channels by name
    raw = Path("r3.csv").read_text().replace("load", "=load", 1)
    Path("new.csv").write_text(raw)
    model = "model/model.safetensors"
    text = passes(capsys, f"simulate {model} new.csv --prepare --out sim")
    assert "Outputs are those of the prepared records: NOx [-]" in text
    split, network = read_split("done/prepared.toml"), load(model)
    assert split.test is not None
    expected = simulate(network, split.test).value[0][:, 0]
    with open("sim/new.csv", newline="") as file:
        got = [float(row["NOx simulated"]) for row in csv.DictReader(file)]
    np.testing.assert_allclose(got, expected, rtol=1e-9)  # ten digits are written


def test_without_the_flag_it_is_said_how_files_must_be_prepared(capsys):
    model = "model/model.safetensors"
    text = passes(capsys, f"simulate {model} done/prepared.toml --out sim")
    assert "identified from prepared records" in text
    assert "min-max scaling" in text
    told = fails(capsys, 2, f"simulate {model} done/prepared.toml --prepare --out no")
    assert "describes prepared records; leave out --prepare" in told


def test_raw_descriptions_are_prepared_too(capsys):
    model = "model/model.safetensors"
    passes(capsys, f"simulate {model} engine.toml --prepare --out raw")
    passes(capsys, f"simulate {model} done/prepared.toml --out done-sim")
    for k in range(4):
        raw, done = Path(f"raw/r{k}.csv"), Path(f"done-sim/r{k}.csv")
        assert raw.read_text() == done.read_text()


def test_a_model_of_raw_records_has_nothing_to_prepare_by(capsys):
    save(load("model/model.safetensors"), "plain.safetensors")
    assert stored_preparation("plain.safetensors") is None
    told = fails(capsys, 2, "simulate plain.safetensors r3.csv --prepare")
    assert "was not identified from prepared records" in told


def test_a_damaged_preparation_of_a_model_is_said(capsys):
    about = {"preparation": {"format": 1}}
    save(load("model/model.safetensors"), "odd.safetensors", about=about)
    told = fails(capsys, 3, "simulate odd.safetensors r3.csv")
    assert "odd.safetensors: its preparation cannot be read" in told


def test_raw_files_hold_what_the_steps_need():
    """A speed that only counts crank angle is read too, in its raw unit."""
    rng = np.random.default_rng(0)
    data = Dataset.from_arrays(
        rng.uniform(900, 1100, (200, 2)),
        rng.standard_normal(200),
        inputs=[Channel("n", "rpm"), Channel("u", "V")],
        outputs=["y"],
        sample_time=0.1,
    )
    steps = [ToCrankAngle(speed="n", degrees=720), Hampel(), Scale()]
    done, preparation = prepare(data, steps)
    less = Channels(done.channels.inputs[1:], done.channels.outputs)
    wanted = raw_channels(preparation, less)
    assert [c.label for c in wanted.inputs] == ["u [V]", "n [rpm]"]
    again = preparation.apply(match_channels(data, wanted)[0])
    same(match_channels(again, less)[0], match_channels(done, less)[0])


def test_steps_come_in_the_documented_order():
    command = commands.Prepare(
        "x.toml",
        scale="mean",
        offset="first",
        resample=0.2,
        decimate=2,
        low_pass=1.0,
        detrend=True,
        hampel=7,
    )
    names = [type(step).__name__ for step in make_steps(command)]
    assert names == [
        "Hampel", "Detrend", "LowPass", "Decimate", "Resample", "RemoveOffset", "Scale"
    ]  # fmt: skip
    doc = json.dumps(Preparation((), Channels((), ()), 1.0).to_dict())
    assert Preparation.from_dict(json.loads(doc)).steps == ()


def test_command_names_are_split_at_capitals():
    assert commands._kebab("SimulateEngine") == "simulate-engine"
    assert commands._kebab("Prepare") == "prepare"
    assert "prepare" in commands.COMMANDS
