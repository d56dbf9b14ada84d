"""Damaged, foreign and unwritable files in a run folder."""

import errno
import json
import os
import resource
import signal
import subprocess
import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from sweep_toys import Toy

from jaxnarx import files
from jaxnarx.errors import DataFileError
from jaxnarx.sweep import find_run, read_sweep, run_sweep
from jaxnarx.sweep.folder.chunks import Damaged, read_results
from jaxnarx.sweep.folder.manifest import sha256


@pytest.fixture
def done(tmp_path):
    """A finished sweep of three chunks without its table."""
    run_sweep(Toy(), tmp_path / "x", chunk=4)
    (tmp_path / "x" / "table.parquet").unlink()
    return tmp_path / "x"


@pytest.fixture
def sound(tmp_path):
    return run_sweep(Toy(), tmp_path / "sound", chunk=4).value


def cut(path):
    path.write_bytes(path.read_bytes()[:-40])


def flip(path):
    data = bytearray(path.read_bytes())
    data[60] ^= 0xFF
    path.write_bytes(data)


def empty(path):
    path.write_bytes(b"")


def link_out(path):
    outside = path.parents[2] / "outside.parquet"
    path.rename(outside)
    path.symlink_to(outside)


def copy_another(path):
    path.write_bytes(path.with_name("00002.parquet").read_bytes())


@pytest.mark.parametrize("damage", [cut, flip, empty, link_out, copy_another])
def test_a_damaged_chunk_is_computed_again_and_said(done, sound, same_rows, damage):
    damage(done / "chunks" / "00001.parquet")
    others = {n: (done / "chunks" / n).stat().st_mtime_ns for n in kept(done)}
    solution = run_sweep(Toy(), done, chunk=4)
    same_rows(solution.value, sound)
    assert solution.stats["redone"] == [1]
    assert "1 damaged chunk was computed again" in solution.detail
    assert {n: (done / "chunks" / n).stat().st_mtime_ns for n in kept(done)} == others
    assert not (done / "chunks" / "00001.parquet").is_symlink()


def kept(folder):
    return ["00000.parquet", "00002.parquet"]


@pytest.mark.parametrize("damage", [cut, flip, empty])
def test_a_damaged_table_is_gathered_again(done, sound, same_rows, damage):
    run_sweep(Toy(), done, chunk=4)
    damage(done / "table.parquet")
    same_rows(run_sweep(Toy(), done, chunk=4).value, sound)
    assert pq.read_table(done / "table.parquet").num_rows == 12


def test_no_bit_of_a_chunk_changes_unseen(done):
    path, rng = done / "chunks" / "00001.parquet", np.random.default_rng(3)
    data, run = path.read_bytes(), find_run(done)
    for bit in rng.choice(8 * len(data), 400, replace=False):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        path.write_bytes(changed)
        with pytest.raises((Damaged, DataFileError)):
            read_results(path, run.manifest.digest, run.members(1))


def test_a_chunk_in_place_of_the_table_is_no_table(done, sound, same_rows):
    run_sweep(Toy(), done, chunk=4)
    (done / "table.parquet").write_bytes((done / "chunks/00001.parquet").read_bytes())
    same_rows(read_sweep(done), sound)


def test_a_folder_of_the_first_format_is_continued(done, sound, same_rows):
    for path in sorted((done / "chunks").glob("*"))[:2]:
        as_format_1(path, find_run(done).manifest.digest)
    copy = done / "chunks" / "00002.parquet"
    copy.write_bytes((done / "chunks" / "00000.parquet").read_bytes())
    solution = run_sweep(Toy(), done, chunk=4)
    same_rows(solution.value, sound)
    assert solution.stats["redone"] == [2]


def as_format_1(path, digest):
    mark = json.dumps({"format": 1, "sweep": digest})
    table = pq.ParquetFile(path).read()
    pq.write_table(table.replace_schema_metadata({"jaxnarx": mark}), path)


@pytest.mark.slow
def test_reading_a_sweep_leaves_no_thread_of_arrow(done):
    # Such a thread may hold Python's memory when Python ends, and then aborts it.
    code = f"""
import os
from jaxnarx.sweep import read_sweep
def threads():
    tasks = [f"/proc/self/task/{{t}}/comm" for t in os.listdir("/proc/self/task")]
    return sum("jemalloc" not in open(name).read() for name in tasks)
before = threads()
assert read_sweep({str(done)!r}).column("status").tolist().count("ok") == 11
print(threads() - before if os.path.isdir("/proc/self/task") else 0)
"""
    # pandas, which Arrow looks for, loads numexpr where it is there: with threads too
    own = os.environ | {"NUMEXPR_MAX_THREADS": "1", "NUMEXPR_NUM_THREADS": "1"}
    command = [sys.executable, "-c", code]
    ended = subprocess.run(command, capture_output=True, text=True, env=own)
    assert (ended.returncode, ended.stdout) == (0, "0\n"), ended.stderr


def test_leftovers_of_a_killed_process_are_ignored_and_cleared(done, sound, same_rows):
    (done / "chunks" / "00001.parquet").unlink()
    leftover = done / "chunks" / "00001.parquet.99999999-abc.tmp"
    foreign = done / "chunks" / "00002.parquet.99999999-abc.tmp"
    for path in (leftover, foreign):
        path.write_bytes(b"half")
    same_rows(run_sweep(Toy(), done, chunk=4).value, sound)
    assert not leftover.exists()
    assert foreign.exists()  # nobody claimed chunk 2, it may be in the making


def test_results_of_another_sweep_are_refused(done, tmp_path):
    run_sweep(Toy(scale=2.0), tmp_path / "y", chunk=4)
    wrong = (tmp_path / "y" / "chunks" / "00001.parquet").read_bytes()
    (done / "chunks" / "00001.parquet").write_bytes(wrong)
    with pytest.raises(DataFileError, match="00001.parquet belongs to another sweep"):
        run_sweep(Toy(), done, chunk=4)


def test_files_that_are_no_results_are_refused(done):
    path = done / "chunks" / "00001.parquet"
    table = pq.read_table(path)
    pq.write_table(table.replace_schema_metadata(None), path)
    with pytest.raises(DataFileError, match="is no result of a sweep"):
        run_sweep(Toy(), done, chunk=4)
    mark = {"jaxnarx": json.dumps({"format": 99, "sweep": ""})}
    pq.write_table(table.replace_schema_metadata(mark), path)
    with pytest.raises(DataFileError, match="has format 99, not 2"):
        run_sweep(Toy(), done, chunk=4)
    assert isinstance(table, pa.Table)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text[:50], "cannot be read"),
        (lambda text: text.replace('"scale": 1.0', '"scale": 2.0'), "digest"),
        (lambda text: text.replace('"format": 1', '"format": 2'), "has format 2"),
        (lambda text: "[]", "cannot be read"),
    ],
)
def test_a_changed_manifest_is_refused(done, change, words):
    path = done / "manifest.json"
    path.write_text(change(path.read_text()))
    with pytest.raises(DataFileError, match=words) as error:
        run_sweep(Toy(scale=2.0), done, chunk=4)
    assert error.value.path == path and "--new-run" in str(error.value)
    run_sweep(Toy(scale=2.0), done, chunk=4, new=True)
    assert (done.parent / "x-1" / "chunks" / "00002.parquet").exists()


def edited(**changes):
    """A manifest with other contents and the digest that fits them."""

    def change(text):
        value = json.loads(text)
        value["sweep"] = changes.pop("sweep", value["sweep"] | changes)
        return json.dumps(value | {"sha256": sha256(value["sweep"])})

    return change


@pytest.mark.parametrize(
    "change",
    [
        edited(chunk=0),
        edited(chunk=True),
        edited(members="x"),
        edited(members=10**30),
        edited(sweep={}),
        edited(sweep=[1]),
        lambda text: text.replace('"about": {', '"about": null, "more": {'),
        lambda text: "[" * 100_000 + "]" * 100_000,
        lambda text: "5",
    ],
)
def test_a_manifest_that_is_none_is_refused(done, change):
    path = done / "manifest.json"
    path.write_text(change(path.read_text()))
    for use in (lambda: read_sweep(done), lambda: run_sweep(Toy(), done, chunk=4)):
        with pytest.raises(DataFileError, match="manifest.json.*--new-run") as error:
            use()
        assert error.value.path == path


def test_odd_things_in_place_of_files_are_said(done):
    chunk = done / "chunks" / "00001.parquet"
    chunk.unlink()
    os.mkfifo(chunk)  # reading it would never end
    with pytest.raises(DataFileError, match="00001.parquet: it is no file"):
        read_sweep(done)
    assert run_sweep(Toy(), done, chunk=4).stats["redone"] == [1]
    (done / "table.parquet").unlink()
    chunk.unlink()
    chunk.mkdir()
    with pytest.raises(DataFileError, match="00001.parquet: cannot be"):
        run_sweep(Toy(), done, chunk=4)


@pytest.mark.parametrize("name", ["00000.lock", "00001.lock", "x.lock"])
def test_a_claim_that_is_none_holds_nobody_up(done, sound, same_rows, name):
    (done / "chunks" / "00001.parquet").unlink()
    claim = done / "claims" / name
    claim.write_text("5")
    same_rows(run_sweep(Toy(), done, chunk=4).value, sound)
    assert not claim.exists()


def test_results_without_a_manifest_are_refused(done):
    (done / "manifest.json").unlink()
    with pytest.raises(DataFileError, match="holds results but no manifest"):
        run_sweep(Toy(), done, chunk=4)


@pytest.mark.parametrize("part", ["chunks", "claims", "manifest.json"])
def test_links_out_of_the_folder_are_not_followed(tmp_path, part):
    (tmp_path / "x").mkdir()
    (tmp_path / "outside").mkdir()
    (tmp_path / "x" / part).symlink_to(tmp_path / "outside")
    with pytest.raises(DataFileError, match="is a symbolic link"):
        run_sweep(Toy(), tmp_path / "x")
    assert not list((tmp_path / "outside").iterdir())


def test_odd_labels_name_no_file(tmp_path, monkeypatch):
    odd = [{"engine": "../../e", "a/b": "\x00;=1+1"} for _ in range(2)]
    monkeypatch.setattr(Toy, "members", property(lambda self: odd))
    table = run_sweep(Toy(), tmp_path / "x", chunk=1).value
    assert [row["a/b"] for row in table.rows()] == ["\x00;=1+1"] * 2
    names = {p.name for p in tmp_path.rglob("*") if p.is_file()}
    assert names == {
        *("00000.parquet", "00001.parquet"),
        *("manifest.json", "table.parquet"),
    }


def test_a_full_disk_is_said_and_earlier_chunks_are_kept(
    tmp_path, monkeypatch, same_rows
):
    move = files._move

    def full(source, target, replace):
        if target.name.startswith("00002"):
            os.truncate(source, 100)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(source))
        return move(source, target, replace)

    monkeypatch.setattr(files, "_move", full)
    with pytest.raises(DataFileError, match="No space left on device") as error:
        run_sweep(Toy(), tmp_path / "x", chunk=4)
    assert "00002.parquet" in str(error.value.path)
    assert "Finished chunks are kept" in str(error.value)
    chunks = tmp_path / "x" / "chunks"
    assert sorted(p.name for p in chunks.iterdir()) == [
        "00000.parquet",
        "00001.parquet",
    ]
    assert not list((tmp_path / "x" / "claims").iterdir())
    monkeypatch.setattr(files, "_move", move)
    before = {p: p.stat().st_mtime_ns for p in chunks.iterdir()}
    table = run_sweep(Toy(), tmp_path / "x", chunk=4).value
    assert {p: p.stat().st_mtime_ns for p in before} == before
    same_rows(table, run_sweep(Toy(), tmp_path / "y", chunk=4).value)


def test_a_limit_of_the_system_on_files_is_said(tmp_path):
    # The kernel itself refuses here: nothing is replaced in the code under test.
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4000, limits[1]))
    try:
        with pytest.raises(DataFileError, match="cannot be written"):
            run_sweep(Toy(text=20_000), tmp_path / "x", chunk=6)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert not list((tmp_path / "x" / "chunks").iterdir())


def test_a_folder_that_cannot_be_made_is_said(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(DataFileError, match="cannot be written"):
        run_sweep(Toy(), tmp_path / "file" / "x")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_folder_is_said(done):
    (done / "chunks" / "00001.parquet").unlink()
    (done / "chunks").chmod(0o555)
    with pytest.raises(DataFileError, match="Make the folder writable"):
        run_sweep(Toy(), done, chunk=4)
    (done / "chunks").chmod(0o755)
