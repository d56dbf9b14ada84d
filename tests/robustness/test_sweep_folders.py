"""Damaged folders of sweeps: own errors or the rows that were computed, no others."""

import shutil

import numpy as np
import pytest
from battery import mutate
from sweep_toys import Toy

from jaxnarx.sweep import read_sweep, run_sweep

TOKENS = [b"null", b"[1]", b"{}", b"-1", b"0", b"9" * 30, b'"x"', b"PAR1", b"[" * 2000]


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """A finished sweep of three chunks."""
    folder = tmp_path_factory.mktemp("sweeps") / "sound"
    run_sweep(Toy(), folder, chunk=4)
    return folder


def rows(table):
    """Rows by member, but for the seconds they took."""
    found = table.arrow.drop_columns(["seconds"]).to_pylist()
    return {row["index"]: row for row in found}


def damage(folder, rng: np.random.Generator) -> None:
    """One or two files are damaged, lost, replaced or taken for others."""
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    for _ in range(int(rng.integers(1, 3))):
        path, other = (files[int(i)] for i in rng.integers(0, len(files), 2))
        kind = int(rng.integers(0, 10))
        if kind == 0 and not path.is_dir():
            path.unlink(missing_ok=True)
        elif kind == 1 and other.is_file():
            shutil.copyfile(other, path) if path != other else None
        elif kind == 2 and path.is_file():
            path.unlink()
            path.mkdir()
        elif path.is_file():
            path.write_bytes(mutate(path.read_bytes(), rng, TOKENS))


@pytest.mark.slow
def test_damaged_sweep_folders(battery, sound, tmp_path):
    whole = rows(read_sweep(sound))
    place = tmp_path / "x"

    def attempt(rng):
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(sound, place)
        if rng.random() < 0.5:
            (place / "table.parquet").unlink()
        damage(place, rng)
        if rng.random() < 0.5:
            found = rows(read_sweep(place))
            assert found and all(whole[n] == row for n, row in found.items())
        else:
            assert rows(run_sweep(Toy(), place, chunk=4).value) == whole

    ends = battery.run(attempt)
    if battery.cases >= 300:  # that damages are met, and mended
        assert ends["DataFileError"] > battery.cases // 10
        assert ends["done"] > battery.cases // 10
