"""Claims: one owner at a time, the dead give way, the living do not."""

import gc
import os
import signal
import subprocess
import sys
import threading
import warnings

import pytest
from common import some

from jaxnarx.errors import DataFileError
from jaxnarx.sweep.folder.claims import Claims, clear_dead

SCRIPT = """
import pathlib, sys
from jaxnarx.sweep.folder.claims import Claims
claims = Claims(pathlib.Path(sys.argv[1]))
print(claims.take(0), flush=True)
input()
"""


@pytest.fixture
def other(tmp_path):
    """Another process, which claims the first chunk."""
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout and process.stdout.readline() == "True\n"
    yield process
    process.kill()
    process.communicate()


def test_a_claim_is_for_one_and_gone_at_the_end(tmp_path):
    with Claims(tmp_path) as one, Claims(tmp_path) as two:
        assert one.take(3) and not two.take(3) and two.take(4)
        assert not one.take(3)
        assert clear_dead(tmp_path)
        assert not two.take(3)
        one.release(3)
        assert two.take(3)
    assert not list(tmp_path.iterdir()) and not clear_dead(tmp_path)


def test_of_many_that_ask_at_once_one_gets_it(tmp_path):
    (tmp_path / "00000.lock").touch()  # left by a dead process
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
    got[0].release(0)


def test_a_chunk_that_goes_from_hand_to_hand_has_one_owner_at_a_time(tmp_path):
    """Each release removes the file that others may just have opened."""
    inside, most, rounds = [0], [0], [0]
    guard = threading.Lock()

    def work():
        with Claims(tmp_path) as claims:
            while rounds[0] < 400:
                if not claims.take(0):
                    continue
                with guard:
                    inside[0] += 1
                    rounds[0] += 1
                    most[0] = max(most[0], inside[0])
                with guard:
                    inside[0] -= 1
                claims.release(0)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert rounds[0] >= 400 and most[0] == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("end", some((signal.SIGKILL, signal.SIGSTOP), signal.SIGSTOP))
def test_a_process_has_its_claim_until_it_ends_however_it_ends(tmp_path, other, end):
    with Claims(tmp_path) as claims:
        assert not claims.take(0) and clear_dead(tmp_path)
        other.send_signal(end)
        if end == signal.SIGSTOP:  # it only sleeps
            assert not claims.take(0) and clear_dead(tmp_path)
            other.kill()
        other.wait()
        assert (tmp_path / "00000.lock").exists()
        assert claims.take(0) and clear_dead(tmp_path)
    assert not list(tmp_path.iterdir())


def test_what_the_dead_have_left_is_cleared(tmp_path, other):
    (tmp_path / "00007.lock").write_text("{")
    assert clear_dead(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["00000.lock"]
    other.kill()
    other.wait()
    assert not clear_dead(tmp_path)
    assert not list(tmp_path.iterdir())


def test_claims_that_nobody_has_any_more_are_free(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        assert Claims(tmp_path).take(0)  # an interrupt may lose them so
        gc.collect()
    with Claims(tmp_path) as claims:
        assert claims.take(0)


def test_a_link_in_place_of_a_claim_is_not_followed(tmp_path):
    (tmp_path / "claims").mkdir()
    os.symlink(tmp_path / "outside", tmp_path / "claims" / "00000.lock")
    with Claims(tmp_path / "claims") as claims:
        with pytest.raises(DataFileError, match="00000.lock: cannot be written"):
            claims.take(0)
    assert not (tmp_path / "outside").exists()
