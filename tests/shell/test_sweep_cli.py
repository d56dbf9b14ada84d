"""`jaxnarx sweep`: description, run folder, exit codes."""

import csv
import functools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sweep_toys import BED

from jaxnarx.errors import DataFileError
from jaxnarx.shell.sweep import run as command
from jaxnarx.shell.sweep.description import Measured, Relatives, load_sweep
from jaxnarx.sweep import IdentificationWork, read_sweep


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A working folder with a description, and the lines of its first run."""
    folder = tmp_path_factory.mktemp("sweep")
    (folder / "bed.toml").write_text(BED)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield folder


@pytest.fixture
def jaxnarx(place, typed):
    return functools.partial(typed, "sweep")


def toy_row(self, n):
    """What a fit would say, without one."""
    names = [f"{p}_free_run" for p in self.fleet.parts]
    if n == 3:
        row = {"status": "diverged", "names": ["=a"]}
        return row | dict.fromkeys(names, float("inf"))
    return {"status": "ok", "names": ["=a"]} | dict.fromkeys(names, 0.5 / (1 + n))


@pytest.fixture
def quick(monkeypatch):
    """Fits that cost nothing."""
    monkeypatch.setattr(
        IdentificationWork, "run", lambda self, ns: [toy_row(self, n) for n in ns]
    )


def test_a_sweep_of_a_bed_is_run_told_and_continued(jaxnarx, quick):
    code, out, _ = jaxnarx("bed.toml --chunk 2")
    assert code == 0
    assert "4 fits: 2 engines by 2 cases, 2 to a chunk" in out
    assert "0 of 4 fits" in out and "4 of 4 fits" in out
    lines = out.splitlines()
    assert ["ok", "3"] in [line.split() for line in lines]
    best = [line.split() for line in lines if line.startswith("  pfi-cc-")]
    assert best == [
        ["pfi-cc-0000", "0.0001", "ok", "0.25", "0.25", "0.25"],
        ["pfi-cc-0001", "1e-06", "ok", "0.1667", "0.1667", "0.1667"],
    ]
    assert "wrote table.parquet and table.csv to runs/bed" in out
    text = Path("runs/bed/table.csv").read_text()
    rows = list(csv.DictReader(text.splitlines()))
    assert [row["refine.ridge"] for row in rows] == ["1e-06", "0.0001"] * 2
    assert len(read_sweep("runs/bed")) == 4
    before = Path("runs/bed/table.parquet").stat().st_mtime_ns
    assert jaxnarx("bed.toml --chunk 2")[0] == 0
    assert Path("runs/bed/table.parquet").stat().st_mtime_ns == before


def test_changed_settings_are_wrong_usage_until_a_new_run(jaxnarx, quick, place):
    jaxnarx("bed.toml --folder x")
    (place / "other.toml").write_text(BED.replace("1e-4", "1e-3"))
    code, _, err = jaxnarx("other.toml --folder x")
    assert code == 2 and err.count("\n") == 1
    assert "begin anew with --new-run" in err and "cases[1].refine.ridge" in err
    assert jaxnarx("other.toml --folder x --new-run")[0] == 0
    assert read_sweep("x").column("refine.ridge")[1] == 1e-3
    assert read_sweep("x-1").column("refine.ridge")[1] == 1e-4


def test_an_interrupt_is_told_with_what_is_finished(jaxnarx, monkeypatch):
    def interrupted(self, indices):
        if 2 in indices:
            raise KeyboardInterrupt
        return [toy_row(self, n) for n in indices]

    monkeypatch.setattr(IdentificationWork, "run", interrupted)
    code, out, err = jaxnarx("bed.toml --chunk 1 --folder stopped")
    assert code == 130
    assert "2 of 4 chunks (2 of 4 members) are finished" in out
    assert "interrupted" in err


def test_a_sweep_without_any_result_says_why(jaxnarx, monkeypatch):
    def broken(self, indices):
        raise ValueError("the moon is full")

    monkeypatch.setattr(IdentificationWork, "run", broken)
    code, out, err = jaxnarx("bed.toml --folder broken")
    assert code == 3 and "crashed" in out
    assert "every member crashed" in err and "--new-run" in err
    assert "The first was pfi-cc-0000: " in err
    assert "the moon is full" in err and err.count("\n") == 1
    assert len(read_sweep("broken")) == 4
    code, out, err = jaxnarx("bed.toml --folder broken")
    assert code == 3 and "the moon is full" in err


def test_engines_that_stall_are_rows(jaxnarx, monkeypatch):
    from jaxnarx.engines import CrossleyCook
    from jaxnarx.errors import DataError

    simulate, calls = CrossleyCook.simulate, []

    def stalls(self, *args, **options):
        calls.append(self)
        if len(calls) == 1:
            raise DataError("speed is below its limit at event 4")
        return simulate(self, *args, **options)

    def rows(self, indices):
        good = [n for n in indices if n >= 2]
        status = self.fleet.status
        assert status[0] == "nonfinite_data" and status[1] == "ok"
        bad = [{"status": status[0]} for n in indices if n < 2]
        return bad + [toy_row(self, n) for n in good]

    monkeypatch.setattr(CrossleyCook, "simulate", stalls)
    monkeypatch.setattr(IdentificationWork, "run", rows)
    code, out, err = jaxnarx("bed.toml --folder stalls")
    assert code == 0, err
    assert "engine 0000 is left out: speed is below its limit" in out
    assert ["nonfinite_data", "2"] in [line.split() for line in out.splitlines()]


@pytest.mark.slow
def test_a_real_sweep_in_two_processes(jaxnarx):
    code, out, _ = jaxnarx("bed.toml --folder real --workers 2 --chunk 2")
    assert code == 0, out
    # Records this short leave the free run of an engine to chance, one step not.
    table = read_sweep("real")
    assert "crashed" not in table.column("status")
    scores = table.numbers("train_one_step")
    assert len(scores) == 4 and np.all((scores > 0) & (scores < 1))


# measured engines ------------------------------------------------------------------


def engine(folder, name, counts, gain):
    """A described engine with so many records in each part."""
    lines = ["[data]", "sample_time = 0.1", "[channels.inputs]", 'u = "%"']
    lines += ["[channels.outputs]", 'y = "rpm"', "[records]"]
    for part, count in counts.items():
        files = []
        for k in range(count):
            u = np.random.default_rng([k, len(part)]).normal(size=60)
            rows = "\n".join(f"{a:.6f},{gain * a:.6f}" for a in u)
            files.append(f"{name}_{part}{k}.csv")
            (folder / files[-1]).write_text(f"u,y\n{rows}\n")
        lines.append(f"{part} = {files}")
    (folder / f"{name}.toml").write_text("\n".join(lines))


@pytest.fixture
def measured(place):
    folder = place / "engines"
    folder.mkdir(exist_ok=True)
    engine(folder, "a", {"train": 2, "validate": 1}, 2.0)
    engine(folder, "b", {"train": 1, "validate": 2}, 3.0)
    text = '[data]\nengines = ["engines/*.toml"]\n[identification.select]\n'
    (place / "measured.toml").write_text(text + "max_terms = 3\n")
    return folder


def test_measured_engines_may_have_different_numbers_of_records(
    jaxnarx, quick, measured, monkeypatch
):
    seen = []
    made = command.make_fleet
    monkeypatch.setattr(
        command, "make_fleet", lambda d: seen.append(made(d)) or seen[-1]
    )
    code, out, err = jaxnarx("measured.toml")
    assert code == 0, err
    (fleet,) = seen
    assert fleet.names == ("a", "b") and fleet.test is None
    assert [len(n) for n in fleet.train.names] == [2, 1]
    assert [len(n) for n in fleet.validation.names] == [1, 2]
    ratio = fleet.dataset(1, "validation").records[1]
    np.testing.assert_allclose(ratio.y, 3.0 * ratio.u, atol=2e-6)


def test_engines_with_other_parts_are_refused(jaxnarx, measured):
    engine(measured, "b", {"train": 1, "test": 1}, 3.0)
    code, _, err = jaxnarx("measured.toml --folder y")
    assert code == 3 and "the same parts as the first; b has train, test" in err
    assert not Path("y").exists()


# descriptions ----------------------------------------------------------------------


def load(folder, text):
    path = folder / "d.toml"
    path.write_text(text)
    return load_sweep(path)


def test_a_description_is_settings_and_cases(tmp_path):
    found = load(tmp_path, BED)
    assert found.data == Relatives("pfi-cc", 2, 0.02, 120)
    method: Any = found.method
    assert method.select.max_terms == 3 and method.pool.input_lags == (0, 1)
    assert found.cases == ({"refine.ridge": 1e-6}, {"refine.ridge": 1e-4})
    text = BED.split("[cases]")[0]
    assert load(tmp_path, text).cases == ({},)
    drawn = text + '[random]\ncount = 5\nseed = 2\nrefine.ridge = ["log", 1e-6, 1e-2]\n'
    assert load(tmp_path, drawn) == load(tmp_path, drawn)
    assert len({c["refine.ridge"] for c in load(tmp_path, drawn).cases}) == 5


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[data]", "[dta]", "unknown key 'dta'. Did you mean 'data'"),
        ('bed = "pfi-cc"', "", "[data] needs bed"),
        ("count = 2", 'count = "2"', "count must be a whole number, got '2'"),
        ("count = 2", "count = 0", "count must be at least 1"),
        ("spread = 0.02", "spread = nan", "spread must be a number"),
        ("max_steps = 1", "stps = 1", "Did you mean 'max_steps'"),
        ("max_steps = 1", "max_steps = true", "refine.max_steps must be a whole"),
        ("max_steps = 1", "max_steps = -1", "refine.max_steps must be at least 0"),
        (
            "[cases]",
            "[identification.grow]\nmax_models = 2\n[cases]",
            "grow needs a method: one of lolimot, tree",
        ),
        (
            "[cases]",
            '[identification.grow]\nmethod = "round"\n[cases]',
            "grow must be one of global, lolimot",
        ),
        ("[1e-6, 1e-4]", "1e-6", "refine.ridge must be a list"),
        ("[1e-6, 1e-4]", '["a"]', "refine.ridge must be a number, got 'a'"),
        ("refine.ridge = [1e-6, 1e-4]", "select.max_terms = [1.5]", "a whole number"),
        ("refine.ridge = [1e-6, 1e-4]", 'refine.train = ["all"]', "one of staged"),
        ("refine.ridge", "refine.rige", "Did you mean 'ridge'"),
        ("refine.ridge", "ridge", "there is no setting 'ridge'"),
        ("[cases]", "[random]\n[cases]", "not both"),
        ("[identification.pool]", "[", "not valid TOML"),
        ('bed = "pfi-cc"', "engines = []", "must be a list of files"),
        ('bed = "pfi-cc"', 'engines = ["/x"]', "relative to the description"),
    ],
)
def test_what_is_wrong_in_a_description_is_named(tmp_path, old, new, words):
    with pytest.raises(DataFileError) as error:
        load(tmp_path, BED.replace(old, new, 1))
    assert words in str(error.value) and "d.toml" in str(error.value)


def test_a_bed_nobody_knows_is_named(jaxnarx, place):
    (place / "odd.toml").write_text(BED.replace("pfi-cc", "pfi-c"))
    code, _, err = jaxnarx("odd.toml")
    assert code == 3 and "there is no bed 'pfi-c'" in err
    assert isinstance(Measured(("a",)), Measured) and not Path("runs/odd").exists()


def test_a_description_that_is_not_there_is_said(jaxnarx):
    code, _, err = jaxnarx("absent.toml")
    assert code == 3 and "absent.toml: cannot be opened" in err
