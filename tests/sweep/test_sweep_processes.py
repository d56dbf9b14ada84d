"""Sweeps that are killed, shared by processes, interrupted, or run on a cluster."""

import collections
import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import dask.config
import distributed
import numpy as np
import pytest
from sweep_toys import Lawless, Settings, Toy

from jaxnarx.errors import DataFileError, JaxnarxError, SpecError
from jaxnarx.sweep import OverDevices, SweepTable, processes, read_sweep, run_sweep
from jaxnarx.sweep.folder import files

LIMIT = 120
"""Seconds after which a process that should have ended is a failure."""


@pytest.fixture
def sound(tmp_path):
    """The table of the uninterrupted sweep, in one process."""
    return run_sweep(Toy(24), tmp_path / "sound", chunk=2).value


def chunks(folder):
    return sorted((folder / "chunks").glob("*.parquet"))


def wait_for(condition):
    until = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < until, "it did not come"
        time.sleep(0.01)


def pages(diary):
    """Members by the process that computed them."""
    found = collections.defaultdict(list)
    for line in Path(diary).read_text().splitlines():
        process, *members = map(int, line.split())
        found[process] += members
    return found


def test_a_killed_sweep_continues_and_equals_the_uninterrupted_one(
    tmp_path, start, sound, same_rows
):
    folder, diary = tmp_path / "x", tmp_path / "diary"
    # Long enough that a busy machine is not done before the signal comes.
    toy = f"Toy(24, pause=0.3, diary={str(diary)!r})"
    first = start(folder, toy, "dict(chunk=2)")
    wait_for(lambda: len(chunks(folder)) >= 3 or first.poll() is not None)
    first.send_signal(signal.SIGKILL)
    first.wait()
    before = {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in chunks(folder)}
    assert 3 <= len(before) < 12, first.communicate()
    again = start(folder, toy.replace("0.3", "0.0"), "dict(chunk=2)")
    _, errors = again.communicate(timeout=LIMIT)
    assert again.returncode == 0, errors
    assert {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in before} == before
    same_rows(read_sweep(folder), sound)
    computed = pages(diary)
    # Nothing twice but, at most, the chunk in flight.
    assert len(computed[first.pid]) <= 2 * len(before) + 2
    assert len(computed[again.pid]) == 24 - 2 * len(before)
    assert not list((folder / "claims").iterdir())


@pytest.mark.slow
def test_two_processes_share_a_folder(tmp_path, start, sound, same_rows):
    folder, diary = tmp_path / "x", tmp_path / "diary"
    # Long enough for the second to come before the first is done.
    toy = f"Toy(24, pause=0.4, diary={str(diary)!r})"
    both = [start(folder, toy, "dict(chunk=2)") for _ in range(2)]
    for process in both:
        _, errors = process.communicate(timeout=LIMIT)
        assert process.returncode == 0, errors
    same_rows(read_sweep(folder), sound)
    computed = pages(diary)
    assert set(computed) == {process.pid for process in both}
    assert sorted(sum(computed.values(), [])) == list(range(24))


@pytest.mark.slow
def test_workers_share_the_chunks_each_on_a_core_of_its_own(tmp_path, sound, same_rows):
    diary, told = tmp_path / "diary", []
    toy = Toy(24, pause=0.3, diary=str(diary))
    options = {"chunk": 2, "workers": 2, "progress": told.append}
    solution = run_sweep(toy, tmp_path / "x", **options)
    same_rows(solution.value, sound)
    assert solution.stats["notes"] == []
    computed = pages(diary)
    assert len(computed) == 2 and os.getpid() not in computed
    assert sorted(sum(computed.values(), [])) == list(range(24))
    assert told[0]["done"] == 0 and told[-1]["done"] == 24


@pytest.mark.slow
def test_a_worker_has_one_core_one_thread_and_our_number_type(tmp_path, monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", "--xla_force_host_platform_device_count=1")
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    before = dict(os.environ)
    table = run_sweep(Settings(2), tmp_path / "x", chunk=1, workers=2).value
    for row in table.rows():
        assert len(row["cores"]) == 1
        threads, wide, safe, flags = row["set"]
        assert (threads, wide, safe) == ("1", "1", "1")
        assert flags.startswith("--xla_force_host_platform_device_count=1 ")
        assert "intra_op_parallelism_threads=1" in flags
    assert dict(os.environ) == before


@pytest.mark.slow
def test_when_a_worker_is_killed_the_others_finish(tmp_path, sound, same_rows):
    diary, killed = tmp_path / "diary", []

    def kill(row):
        if row["chunks"] >= 3 and not killed and len(pages(diary)) == 2:
            killed.append(min(pages(diary)))
            os.kill(killed[0], signal.SIGKILL)

    toy = Toy(24, pause=0.3, diary=str(diary))
    options = {"chunk": 2, "workers": 2, "progress": kill}
    solution = run_sweep(toy, tmp_path / "x", **options)
    assert killed
    same_rows(solution.value, sound)
    assert solution.stats["notes"] == ["1 of 2 processes were lost"]


@pytest.mark.slow
def test_a_member_that_kills_every_process_is_a_row_and_the_others_are_computed(
    tmp_path, same_rows
):
    toy = Toy(4, bad=(0,), trouble="kill")
    # However short dask is told to wait: the next process may be slow to start.
    with dask.config.set({"distributed.deploy.lost-worker-timeout": "10ms"}):
        solution = run_sweep(toy, tmp_path / "x", chunk=2, workers=2)
    table = solution.value
    bad = table.column("status") == "crashed"
    assert np.flatnonzero(bad).tolist() == [0]
    assert all("killed the workers" in text for text in table.column("message")[bad])
    assert "2 of 2 processes were lost" in solution.stats["notes"]
    sound = run_sweep(Toy(4), tmp_path / "y", chunk=2).value
    same_rows(table.take(~bad), sound.take(~bad))


@pytest.mark.slow
def test_an_error_of_a_worker_or_of_its_files_is_raised_here(tmp_path, monkeypatch):
    with pytest.raises(SpecError, match="each of 2 members; it returned 1 rows"):
        run_sweep(Lawless(4), tmp_path / "x", chunk=2, workers=2)
    assert not list((tmp_path / "x" / "claims").iterdir())

    def full(path, data, replace):
        if path.parent.name == "chunks":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        return write(path, data, replace=replace)

    write = files.write_whole
    monkeypatch.setattr(files, "write_whole", full)
    with pytest.raises(DataFileError, match="No space left") as error:
        run_sweep(Toy(4), tmp_path / "y", chunk=2, workers=2)
    assert Path(str(error.value.path)).parent == tmp_path / "y" / "chunks"


@pytest.mark.slow
def test_when_no_process_can_be_replaced_the_same_call_continues(tmp_path, monkeypatch):
    name = "distributed.scheduler.no-workers-timeout"
    monkeypatch.setitem(processes._SCHEDULER_SETTINGS, name, "200ms")
    toy = Toy(2, bad=(0, 1), trouble="kill")
    words = (
        "no others could be started, with 2 of 2 chunks open.*same command continues"
    )
    with pytest.raises(JaxnarxError, match=words):
        run_sweep(toy, tmp_path / "x", chunk=1, workers=2)
    table = run_sweep(Toy(2), tmp_path / "x", chunk=1).value
    assert table.column("status").tolist() == ["ok", "ok"]


@pytest.mark.slow
def test_one_process_does_not_load_dask(tmp_path):
    code = f"""
import sys
from sweep_toys import Toy
from jaxnarx.sweep import run_sweep
run_sweep(Toy(), {str(tmp_path / "x")!r})
print(*{{name.split(".")[0] for name in sys.modules}})
"""
    path = os.pathsep.join([str(Path(__file__).parents[1]), *sys.path])
    environment = os.environ | {"PYTHONPATH": path}
    command = [sys.executable, "-c", code]
    found = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert found.returncode == 0, found.stderr
    assert "jax" in found.stdout.split()
    assert not {"dask", "distributed", "tornado"} & set(found.stdout.split())


@pytest.mark.slow
def test_a_script_without_guard_is_told_what_it_lacks(tmp_path, start):
    process = start(tmp_path / "x", "Toy(4)", "dict(workers=2)", guard=False)
    _, errors = process.communicate(timeout=LIMIT)
    assert process.returncode == 1
    assert "JaxnarxError" in errors and "did not start" in errors


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_ctrl_c_keeps_what_is_finished(tmp_path, start, sound, same_rows, workers):
    folder, diary = tmp_path / "x", tmp_path / "diary"
    # Long enough that a busy machine is not done before the signal comes.
    toy = f"Toy(24, pause=0.5, diary={str(diary)!r})"
    process = start(folder, toy, f"dict(chunk=2, workers={workers})")
    wait_for(lambda: len(chunks(folder)) >= 2 or process.poll() is not None)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=LIMIT)
    assert "KeyboardInterrupt" in errors and "the same command continues" in errors
    if sys.platform == "linux":
        for worker in pages(diary):
            assert not Path(f"/proc/{worker}").exists()
    assert not list((folder / "claims").iterdir())
    before = {p: p.stat().st_mtime_ns for p in chunks(folder)}
    assert 2 <= len(before) < 12
    table = run_sweep(Toy(24), folder, chunk=2).value
    assert {p: p.stat().st_mtime_ns for p in before} == before
    same_rows(table, sound)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_ctrl_c_at_the_start_of_workers_is_quiet(tmp_path, start):
    """Workers that have just begun have no word in it, whoever gets the signal."""
    for group in (False, True):
        process = start(tmp_path / f"x{group}", "Toy(40, pause=1.0)", "dict(workers=2)")
        wait_for(lambda: len(children(process)) >= 2)  # noqa: B023
        for one in (*(children(process) if group else ()), process.pid):
            os.kill(one, signal.SIGINT)
        _, errors = process.communicate(timeout=LIMIT)
        assert errors.count("Traceback") == 1, errors  # the script's own
        assert "the same command continues" in errors


def children(process):
    """Processes that this one has started."""
    tasks = Path(f"/proc/{process.pid}/task").glob("*/children")
    return [int(pid) for path in tasks for pid in path.read_text().split()]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_workers_end_when_their_parent_is_killed(tmp_path, start):
    folder, diary = tmp_path / "x", tmp_path / "diary"
    toy = f"Toy(400, pause=0.05, diary={str(diary)!r})"
    process = start(folder, toy, "dict(chunk=2, workers=2)")
    wait_for(lambda: diary.exists() and len(pages(diary)) == 2)
    process.send_signal(signal.SIGKILL)
    process.wait()
    wait_for(lambda: not any(Path(f"/proc/{pid}").exists() for pid in pages(diary)))
    assert len(chunks(folder)) < 200


# cluster --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cluster():
    """Two worker processes of dask on this machine, and a client."""
    path = os.pathsep.join([str(Path(__file__).parents[1]), *sys.path])
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", path)
        settings = {
            "distributed.scheduler.allowed-failures": 1,
            # a busy machine may need longer than dask's 15 s for a new process
            "distributed.deploy.lost-worker-timeout": "1 day",
        }
        with (
            dask.config.set(settings),
            distributed.LocalCluster(
                n_workers=2,
                threads_per_worker=1,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",
            ) as cluster,
            distributed.Client(cluster) as client,
        ):
            yield client


@pytest.mark.slow
def test_a_cluster_computes_the_same_rows(tmp_path, cluster, sound, same_rows):
    diary = tmp_path / "diary"
    toy = Toy(24, pause=0.3, diary=str(diary))
    table = run_sweep(toy, tmp_path / "x", chunk=2, client=cluster).value
    same_rows(table, sound)
    computed = pages(diary)
    assert len(computed) == 2 and os.getpid() not in computed
    assert not list((tmp_path / "x" / "claims").iterdir())


@pytest.mark.slow
def test_a_worker_of_the_cluster_is_killed_and_its_chunks_made_by_the_other(
    tmp_path, cluster, sound, same_rows
):
    diary, killed = tmp_path / "diary", []

    def kill(row):
        if row["chunks"] >= 3 and not killed:
            killed.append(min(pages(diary)))
            os.kill(killed[0], signal.SIGKILL)

    toy = Toy(24, pause=0.3, diary=str(diary))
    options = {"chunk": 2, "client": cluster, "progress": kill}
    table = run_sweep(toy, tmp_path / "x", **options).value
    assert killed
    same_rows(table, sound)


@pytest.mark.slow
def test_a_member_that_kills_workers_is_a_row(tmp_path, cluster):
    toy = Toy(3, bad=(1,), trouble="kill")
    solution = run_sweep(toy, tmp_path / "x", chunk=2, client=cluster)
    assert solution.value.column("status").tolist() == ["ok", "crashed", "ok"]
    assert "killed the workers" in solution.value.column("message")[1]
    assert "workers died" in solution.stats["notes"][0]


@pytest.mark.slow
def test_a_scheduler_that_dies_is_told_with_how_to_go_on(tmp_path, sound, same_rows):
    place: dict[str, Any] = {"processes": False, "dashboard_address": None}
    with (
        dask.config.set({"distributed.comm.timeouts.connect": "1s"}),
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, **place) as cluster,
        distributed.Client(cluster, timeout=1) as client,
    ):

        def stop(row):
            if row["chunks"] >= 3 and client.status == "running":
                closing: Any = cluster
                closing.sync(closing.scheduler.close)

        options = {"chunk": 2, "client": client, "progress": stop}
        with pytest.raises(JaxnarxError, match="scheduler .* the same call goes on"):
            run_sweep(Toy(24, pause=0.05), tmp_path / "x", **options)
    assert len(chunks(tmp_path / "x")) >= 3
    same_rows(run_sweep(Toy(24), tmp_path / "x", chunk=2).value, sound)


def test_what_is_no_client_is_refused(tmp_path):
    with pytest.raises(SpecError, match="must be a dask.distributed Client, got int"):
        run_sweep(Toy(), tmp_path / "x", client=3)


# devices --------------------------------------------------------------------------


def test_a_chunk_is_divided_among_devices(tmp_path, monkeypatch, sound, same_rows):
    import jax

    device, diary = jax.local_devices()[0], tmp_path / "diary"
    monkeypatch.setattr(jax, "local_devices", lambda: [device] * 3)
    work = OverDevices(Toy(24, diary=str(diary)))
    table = run_sweep(work, tmp_path / "x", chunk=8).value
    same_rows(table, sound)
    sizes = [len(line.split()) - 1 for line in diary.read_text().splitlines()]
    assert sorted(sizes) == [2] * 3 + [3] * 6
    assert np.array_equal(table.column("index"), np.arange(24))


@pytest.mark.slow
def test_several_devices_compute_the_same_rows(tmp_path, start, same_rows):
    # NPROC: with more devices than cores, threads of XLA else wait for one another.
    flags = "--xla_force_host_platform_device_count=4"
    environment = {"NPROC": "8", "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"}
    tables = []
    for name, work in (("one", "Compiled(16)"), ("four", "OverDevices(Compiled(16))")):
        # Equal shapes of what is compiled: 4 members, alone or on each device.
        chunk = 4 if name == "one" else 16
        process = start(tmp_path / name, work, f"dict(chunk={chunk})", environment)
        _, errors = process.communicate(timeout=LIMIT)
        assert process.returncode == 0, errors
        tables.append(read_sweep(tmp_path / name))
    one, four = (set(t.column("device").tolist()) for t in tables)
    assert len(one) == 1 and len(four) == 4
    same_rows(*[SweepTable(t.arrow.drop_columns(["device"])) for t in tables])
