"""Files appear whole or not at all, whatever else writes to the same place."""

import os
import subprocess
import tempfile
from concurrent.futures import ThreadPoolExecutor

import pytest

from jaxnarx import files
from jaxnarx.child_process import python_command, python_environment
from jaxnarx.files import TemporaryFolder, write_whole


def test_writers_to_one_place_do_not_meet(tmp_path):
    # every reader finds all of one writer's bytes, and no writer fails
    path, size, times = tmp_path / "file", 200_000, 40

    def write(mark):
        for _ in range(times):
            assert write_whole(path, mark * size)

    def read(_):
        return {path.read_bytes() for _ in range(times)}

    write_whole(path, b"x" * size)
    with ThreadPoolExecutor(6) as pool:
        writers = [pool.submit(write, mark) for mark in (b"a", b"b", b"c")]
        found = set().union(*pool.map(read, range(3)))
        assert [w.result() for w in writers] == [None] * 3
    assert found <= {mark * size for mark in (b"x", b"a", b"b", b"c")}
    assert os.listdir(tmp_path) == ["file"]


def test_what_is_there_stays_unless_it_is_to_be_replaced(tmp_path):
    path = tmp_path / "file"
    assert write_whole(path, b"one", replace=False)
    assert not write_whole(path, b"two", replace=False)
    assert path.read_bytes() == b"one"
    assert write_whole(path, b"three")
    assert path.read_bytes() == b"three"
    assert os.listdir(tmp_path) == ["file"]


def test_a_planted_link_is_not_followed(tmp_path, monkeypatch):
    monkeypatch.setattr("secrets.token_hex", lambda _: "foreseen")
    target = tmp_path / "precious"
    target.write_bytes(b"kept")
    (tmp_path / "file.foreseen.tmp").symlink_to(target)
    with pytest.raises(FileExistsError):
        write_whole(tmp_path / "file", b"new")
    assert target.read_bytes() == b"kept"
    assert (tmp_path / "file.foreseen.tmp").is_symlink()
    # nor is one in the place itself: it is replaced, not written through
    (tmp_path / "link").symlink_to(target)
    monkeypatch.undo()
    write_whole(tmp_path / "link", b"new")
    assert target.read_bytes() == b"kept"
    assert (tmp_path / "link").read_bytes() == b"new"


def test_a_temporary_folder_goes_with_its_owner(tmp_path, monkeypatch):
    """However that ends; that of a killed process is cleared by the next."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(files, "FRESH_FOLDER_SECONDS", 0.0)
    code = (
        "from jaxnarx.files import TemporaryFolder as T; t = T(); print(1, flush=True)"
    )
    code += "; input()"
    environment = python_environment({"TMPDIR": str(tmp_path)})
    with subprocess.Popen(
        python_command(code),
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline().strip() == b"1"  # it has made and locked it
        (theirs,) = tmp_path.iterdir()
        with TemporaryFolder() as ours:
            assert set(tmp_path.iterdir()) == {ours, theirs}
        assert list(tmp_path.iterdir()) == [theirs]
        other.kill()
    with TemporaryFolder() as ours:
        assert list(tmp_path.iterdir()) == [ours]
    assert not list(tmp_path.iterdir())


def test_a_link_in_place_of_a_temporary_folder_is_not_followed(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "t"))
    monkeypatch.setattr(files, "FRESH_FOLDER_SECONDS", 0.0)
    (tmp_path / "t").mkdir()
    (kept := tmp_path / "kept").mkdir()
    (kept / "file").touch()
    (tmp_path / "t" / f"{files.TEMPORARY_PREFIX}x").symlink_to(kept)
    files.clear_temporary()
    assert (kept / "file").exists()
