"""`run_sweep` in one process: rows, failures, resuming, interruption."""

import time

import numpy as np
import pytest
from sweep_toys import Toy

from jaxnarx.errors import DataFileError, SpecError
from jaxnarx.sweep import read_sweep, run_sweep
from jaxnarx.sweep.folder.manifest import make_manifest
from jaxnarx.sweep.folder.run_folder import open_run
from jaxnarx.sweep.progress import Throughput


def test_every_member_is_a_row_in_its_place(tmp_path):
    toy, told = Toy(), []
    solution = run_sweep(toy, tmp_path / "x", chunk=5, progress=told.append)
    assert solution.is_okay
    assert solution.stats["statuses"] == {"ok": 11, "diverged": 1}
    assert solution.detail == "12 members: 11 ok, 1 diverged."
    table = solution.value
    expected = toy.run(range(12))
    for i, (row, label) in enumerate(zip(table.rows(), toy.members, strict=True)):
        computed = {k: row[k] for k in expected[i]}
        assert computed == expected[i] and {k: row[k] for k in label} == label
        assert row["index"] == i and row["message"] == "" and row["seconds"] >= 0
    assert [row["done"] for row in told] == [0, 5, 10, 12]
    assert [row["chunks"] for row in told] == [0, 1, 2, 3]
    assert told[0]["rate"] is None and told[3]["rate"] > 0 and told[3]["left"] == 0


def test_the_time_left_knows_of_the_compilation(tmp_path, monkeypatch):
    # Two processes compile for 30 s, then compute a chunk every 2 s between them.
    times, told = [0.0, 30.0, 30.1, 32.0, 34.0, 70.0], []
    monkeypatch.setattr(time, "perf_counter", lambda: times[0])
    run = open_run(tmp_path, make_manifest(Toy(120), chunk=4, float64=True))
    pace = Throughput(run, told.append)
    for number, chunks in enumerate((0, 1, 1, 1, 1, 18)):
        for n in range(chunks):
            members = run.members(sum((0, 1, 1, 1, 1, 18)[:number]) + n)
            run.write(members[0] // 4, [{"index": i} for i in members])
        pace()
        times.pop(0)
    left = [row["left"] for row in told]
    assert left[0] is None
    # 4 of 120 in 30 s; then 8 in 30.1, although the last 4 came within 0.1 s
    assert left[1] == pytest.approx(116 * 30 / 4)
    assert left[2] == pytest.approx(112 * 30.1 / 8)
    # 84 since the first chunk, within 40 s
    assert left[5] == pytest.approx(32 * 40 / 84)


def test_a_failing_member_is_a_row_and_the_others_are_computed(tmp_path, same_rows):
    toy = Toy(bad=(0, 4, 7, 8))
    solution = run_sweep(toy, tmp_path / "x", chunk=9)
    table = solution.value
    failed = table.column("status") == "crashed"
    assert np.flatnonzero(failed).tolist() == [0, 4, 7, 8]
    assert table.column("message")[4] == "ZeroDivisionError: engine 4 stalled"
    assert np.isnan(table.column("error")[failed]).all()
    assert solution.stats["statuses"] == {"ok": 7, "crashed": 4, "diverged": 1}
    sound = run_sweep(Toy(), tmp_path / "y", chunk=9).value
    same_rows(table.take(~failed), sound.take(~failed))


def test_a_chunk_of_failures_only_still_gathers(tmp_path):
    table = run_sweep(Toy(bad=(0, 1)), tmp_path / "x", chunk=2).value
    assert table.column("status")[:3].tolist() == ["crashed", "crashed", "ok"]
    assert table.arrow.column("terms").to_pylist()[:3] == [None, None, ["u[t]"]]


@pytest.mark.parametrize("room", [1, 3])
def test_too_little_memory_halves_the_chunk_and_is_noted(tmp_path, same_rows, room):
    diary = tmp_path / "diary"
    toy = Toy(trouble="memory", room=room, diary=str(diary))
    table = run_sweep(toy, tmp_path / "x", chunk=8).value
    tried = [len(line.split()) - 1 for line in diary.read_text().splitlines()]
    # 8 does not fit; 4, 2 (and 1) are tried once; what fits is used from then on.
    fits = {1: 1, 3: 2}[room]
    assert tried[: tried.index(fits)] == [n for n in (8, 4, 2) if n > room]
    assert set(tried[tried.index(fits) :]) == {fits}
    assert set(table.column("status")) == {"ok", "diverged"}
    note = f"computed in pieces of {fits} for want of memory"
    assert set(table.column("message")) == {note}


def test_a_member_that_never_fits_is_a_row(tmp_path):
    table = run_sweep(Toy(2, trouble="memory", room=0), tmp_path / "x").value
    assert table.column("status").tolist() == ["crashed"] * 2
    assert "RESOURCE_EXHAUSTED" in table.column("message")[1]


def test_an_interrupted_sweep_keeps_its_chunks_and_continues(tmp_path, same_rows):
    folder, diary = tmp_path / "x", tmp_path / "diary"
    with pytest.raises(KeyboardInterrupt) as stop:
        run_sweep(Toy(bad=(7,), trouble="interrupt"), folder, chunk=3)
    assert "2 of 4 chunks (6 of 12 members) are finished" in stop.value.__notes__[0]
    assert not list((folder / "claims").iterdir())
    before = {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in files(folder)}
    assert len(before) == 3  # manifest and two chunks
    assert len(read_sweep(folder)) == 6
    table = run_sweep(Toy(diary=str(diary)), folder, chunk=3).value
    assert {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in before} == before
    assert [line.split()[1:] for line in diary.read_text().splitlines()] == [
        ["6", "7", "8"],
        ["9", "10", "11"],
    ]
    same_rows(table, run_sweep(Toy(), tmp_path / "y", chunk=3).value)


def test_a_finished_sweep_is_read_not_computed(tmp_path, same_rows):
    folder = tmp_path / "x"
    first = run_sweep(Toy(), folder).value
    before = {p: p.stat().st_mtime_ns for p in files(folder)}
    again = run_sweep(Toy(bad=tuple(range(12)), trouble="interrupt"), folder).value
    assert again.arrow.equals(first.arrow)
    assert {p: p.stat().st_mtime_ns for p in files(folder)} == before
    same_rows(read_sweep(folder), first)


@pytest.mark.parametrize(
    ("toy", "chunk", "words"),
    [
        (Toy(scale=2.0), 4, "settings.scale was 1.0, is 2.0"),
        (Toy(count=11), 4, "members was 12, is 11"),
        (Toy(scale=2.0), 5, "settings.scale was 1.0, is 2.0. Continue"),
    ],
)
def test_another_sweep_is_refused_by_name_and_nothing_changes(
    tmp_path, toy, chunk, words
):
    run_sweep(Toy(), tmp_path / "x", chunk=4)
    before = {p: p.read_bytes() for p in files(tmp_path)}
    with pytest.raises(SpecError, match=r"new=True \(--new-run\)") as error:
        run_sweep(toy, tmp_path / "x", chunk=chunk)
    assert words in str(error.value)
    assert {p: p.read_bytes() for p in files(tmp_path)} == before


def test_chunks_of_another_size_are_the_same_sweep(tmp_path, same_rows):
    folder = tmp_path / "x"
    with pytest.raises(KeyboardInterrupt):
        run_sweep(Toy(bad=(7,), trouble="interrupt"), folder, chunk=3)
    before = {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in files(folder)}
    solution = run_sweep(Toy(), folder, chunk=5)
    assert {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in before} == before
    assert "chunks are of 3 members, as they were begun" in solution.detail
    same_rows(solution.value, run_sweep(Toy(), tmp_path / "y", chunk=5).value)


def test_a_new_run_sets_the_old_one_aside(tmp_path, same_rows):
    old = run_sweep(Toy(), tmp_path / "x").value
    for scale in (2.0, 3.0):
        new = run_sweep(Toy(scale=scale), tmp_path / "x", new=True).value
        assert new.column("error")[0] == scale
    same_rows(read_sweep(tmp_path / "x-1"), old)
    assert read_sweep(tmp_path / "x-2").column("error")[0] == 2.0
    assert read_sweep(tmp_path / "x").column("error")[0] == 3.0


def test_another_number_type_is_another_sweep(tmp_path, monkeypatch):
    run_sweep(Toy(), tmp_path / "x")
    monkeypatch.setattr("jaxnarx.sweep.drive.is_float64", lambda: False)
    with pytest.raises(SpecError, match="float64 was true, is false"):
        run_sweep(Toy(), tmp_path / "x")


def test_other_packages_are_told_another_jaxnarx_is_refused(tmp_path, monkeypatch):
    from jaxnarx.sweep.folder import manifest

    run_sweep(Toy(), tmp_path / "x")
    now = manifest._versions()
    monkeypatch.setattr(manifest, "_versions", lambda: {**now, "jax": "99"})
    detail = run_sweep(Toy(), tmp_path / "x").detail
    assert f"jax was {now['jax']} when the sweep began and is 99" in detail
    monkeypatch.setattr(manifest, "_versions", lambda: {**now, "jaxnarx": "99"})
    with pytest.raises(SpecError, match='jaxnarx was ".*", is "99"'):
        run_sweep(Toy(), tmp_path / "x")


@pytest.mark.parametrize(
    ("toy", "options", "field"),
    [
        (Toy(), {"chunk": 0}, "chunk"),
        (Toy(), {"workers": 0}, "workers"),
        (Toy(), {"workers": 2, "client": "c"}, "workers"),
        (Toy(count=0), {}, "work"),
    ],
)
def test_wrong_use_is_refused_before_a_folder_is_made(tmp_path, toy, options, field):
    with pytest.raises(SpecError) as error:
        run_sweep(toy, tmp_path / "x", **options)
    assert error.value.field == field
    assert not (tmp_path / "x").exists()


def test_work_that_breaks_the_protocol_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(Toy, "run", lambda self, indices: [{"status": "ok"}])
    with pytest.raises(SpecError, match="each of 12 members; it returned 1"):
        run_sweep(Toy(), tmp_path / "x")
    assert not list((tmp_path / "x" / "claims").iterdir())
    rows = [{"status": "ok", "x": 1}, {"status": "ok", "x": "a"}]
    monkeypatch.setattr(Toy, "run", lambda self, indices: rows)
    with pytest.raises(SpecError, match="'x' of a sweep's rows is of different kinds"):
        run_sweep(Toy(2), tmp_path / "z")
    rows = [{"status": "ok", "engine": 1}] * 2
    with pytest.raises(SpecError, match="a key of the labels, as 'engine' is"):
        run_sweep(Toy(2), tmp_path / "z")
    monkeypatch.setattr(Toy, "describe", lambda self: {"data": np.zeros(2)})
    with pytest.raises(SpecError, match="plain JSON values"):
        run_sweep(Toy(), tmp_path / "y")


def test_a_folder_without_a_sweep_is_not_read(tmp_path):
    with pytest.raises(DataFileError, match="is no run folder"):
        read_sweep(tmp_path)


def files(folder):
    return sorted(p for p in folder.rglob("*") if p.is_file())
