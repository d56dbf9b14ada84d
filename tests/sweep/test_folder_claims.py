"""Claims: one owner at a time, the dead give way, the living do not."""

import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from jaxnarx.sweep.folder import claims as module
from jaxnarx.sweep.folder.claims import Claims, is_at_work
from jaxnarx.sweep.folder.owner import Owner, machine, this_process


def claim_of(folder, owner, number=0):
    path = folder / f"{number:05d}.json"
    path.write_text(json.dumps(vars(owner)))
    return path


@pytest.fixture
def dead():
    """A process of this machine that has ended."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return Owner(machine(), process.pid, "")


def test_a_claim_is_for_one_and_gone_at_the_end(tmp_path):
    with Claims(tmp_path) as one, Claims(tmp_path) as two:
        assert one.take(3) and not two.take(3) and two.take(4)
        assert is_at_work(tmp_path)
        one.release(3)
        assert two.take(3)
    assert not list(tmp_path.iterdir()) and not is_at_work(tmp_path)


def test_of_many_that_ask_at_once_one_gets_it(tmp_path, dead):
    claim_of(tmp_path, dead)
    crowd, gate = [Claims(tmp_path) for _ in range(8)], threading.Barrier(8)
    got = []

    def ask(claims):
        gate.wait()
        if claims.take(0):
            got.append(claims)

    threads = [threading.Thread(target=ask, args=(c,)) for c in crowd]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(got) == 1


def test_the_claim_of_a_dead_process_is_taken_over(tmp_path, dead):
    claim_of(tmp_path, dead)
    assert not is_at_work(tmp_path)
    with Claims(tmp_path) as claims:
        assert claims.take(0)
        assert is_at_work(tmp_path)


def test_a_number_that_another_process_has_by_now_is_a_dead_owner(tmp_path):
    me = this_process()
    claim_of(tmp_path, Owner(me.machine, me.pid, "1"))
    with Claims(tmp_path) as claims:
        assert claims.take(0)


def test_a_killed_process_nobody_has_waited_for_is_dead(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", "input()"], stdin=-1)
    started = (
        Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[19]
    )
    owner = Owner(machine(), process.pid, started)
    assert owner.is_gone() is False
    process.kill()
    until = time.monotonic() + 10
    while not owner.is_gone() and time.monotonic() < until:
        time.sleep(0.01)
    assert owner.is_gone()
    process.communicate()


@pytest.mark.parametrize("text", [None, "", "{", "[1]"])
def test_whom_nobody_can_check_is_dead_when_silent_for_long(tmp_path, text):
    path = claim_of(tmp_path, Owner("another", 1, ""))
    if text is not None:
        path.write_text(text)
    with Claims(tmp_path) as claims:
        assert not claims.take(0) and is_at_work(tmp_path)
        old = time.time() - module.STALE - 5
        os.utime(path, (old, old))
        assert not is_at_work(tmp_path) and claims.take(0)


def test_a_claim_is_renewed_while_its_owner_lives(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "BEAT", 0.01)
    with Claims(tmp_path) as claims:
        claims.take(0)
        path = tmp_path / "00000.json"
        os.utime(path, (0, 0))
        until = time.monotonic() + 10
        while path.stat().st_mtime == 0 and time.monotonic() < until:
            time.sleep(0.01)
        assert path.stat().st_mtime > 0


def test_a_claim_that_was_taken_over_is_not_released(tmp_path):
    with Claims(tmp_path) as claims:
        claims.take(0)
        path = claim_of(tmp_path, Owner("another", 1, ""))
    assert path.exists()
