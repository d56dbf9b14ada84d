"""Damaged input, case by case: only own errors, within a time and a memory bound."""

import collections
import contextlib
import dataclasses
import faulthandler
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from jaxnarx.errors import JaxnarxError

_STATUS, _CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")
MEMORY_IS_TOLD = _CLEAR.exists()


@dataclasses.dataclass(frozen=True)
class Battery:
    """`cases` cases of a kind, from `first` on; a case depends on its number and `seed`
    alone, so that `--robustness-first=17 --robustness-cases=1` runs one again.
    """

    seed: int
    cases: int
    first: int = 0

    def run(
        self,
        attempt: Callable[[np.random.Generator], object],
        *,
        seconds: float = 20,
        megabytes: float = 300,
    ) -> collections.Counter[str]:
        """Call `attempt(rng)` for every case; it damages something and reads it.

        A case may return, or raise one of the package's own errors. Any other
        exception (a failed assertion of `attempt` too), more than `seconds`, or a peak
        of more than `megabytes` above where the case began is a fault; all faults are
        listed together. Returns how many cases ended how: "done", or the error's name.
        """
        ends: collections.Counter[str] = collections.Counter()
        faults = []
        for case in range(self.first, self.first + self.cases):
            rng = np.random.default_rng([self.seed, case])
            end, fault = _one(lambda rng=rng: attempt(rng), seconds, megabytes)
            ends[end] += 1
            if fault:
                faults.append(f"--robustness-first={case}: {fault}")
        assert not faults, (
            f"{len(faults)} of {self.cases} cases failed with "
            f"--robustness-seed={self.seed}:\n" + "\n".join(faults[:40])
        )
        return ends


class Hang(BaseException):
    """A case takes too long; not an Exception, so that no guard holds it back."""


def _one(call: Callable[[], object], seconds, megabytes) -> tuple[str, str]:
    """How a case ended, and what is wrong about that."""
    begin = _resident("VmRSS", reset=True)
    end, fault, since = "done", "", time.monotonic()
    try:
        with _at_most(seconds):
            call()
    except JaxnarxError as error:
        end = type(error).__name__
        if not str(error).strip():
            fault = f"{end} without a word"
    except (Hang, Exception) as error:
        end = type(error).__name__
        at = traceback.extract_tb(error.__traceback__)[-1]
        fault = f"{end} at {Path(at.filename).name}:{at.lineno}: {str(error)[:200]}"
        fault += f" after {time.monotonic() - since:.3g} s" * isinstance(error, Hang)
    used = (_resident("VmHWM") - begin) / 1e6
    if not fault and used > megabytes:
        fault = f"{used:.0f} MB, allowed are {megabytes:.0f} ({end})"
    return end, fault


@contextlib.contextmanager
def _at_most(seconds: float) -> Iterator[None]:
    """`Hang` after `seconds`; code that lets no signal in ends the process later on."""

    def stop(number, frame):
        raise Hang

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    assert sys.__stderr__ is not None
    stream = sys.__stderr__  # that of pytest's `capsys` has no number
    faulthandler.dump_traceback_later(5 * seconds, exit=True, file=stream)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        faulthandler.cancel_dump_traceback_later()
        signal.signal(signal.SIGALRM, before)


def _resident(which: str, *, reset: bool = False) -> float:
    """Resident memory now (VmRSS) or at its peak since the last `reset` [bytes].

    Zero where the system does not tell (Linux does).
    """
    try:
        if reset:
            _CLEAR.write_text("5")
        lines = _STATUS.read_text().splitlines()
    except OSError:
        return 0
    return 1024 * next(float(s.split()[1]) for s in lines if s.startswith(which))


def mutate(raw: bytes, rng: np.random.Generator, tokens: Sequence[bytes] = ()) -> bytes:
    """`raw` with one to four damages: bits flipped, pieces cut out, doubled, swapped or
    overwritten, noise or one of the format's own `tokens` put in, the end cut off.
    """
    for _ in range(int(rng.integers(1, 5))):
        raw = _damage(bytearray(raw or b" "), rng, tokens)
    return raw


def _damage(raw: bytearray, rng: np.random.Generator, tokens) -> bytes:
    a, b = sorted(int(i) for i in rng.integers(0, len(raw), 2))
    near = slice(a, min(b, a + int(rng.integers(1, 33))))
    kind = int(rng.integers(0, 8 if not tokens else 12))
    if kind == 0:
        raw[a] ^= 1 << int(rng.integers(0, 8))
    elif kind == 1:
        raw[a] = int(rng.integers(0, 256))
    elif kind == 2:
        del raw[near]
    elif kind == 3:
        raw[b:b] = raw[near]
    elif kind == 4:
        raw[near] = rng.bytes(near.stop - near.start)
    elif kind == 5:
        raw[a:a] = rng.bytes(int(rng.integers(1, 9)))
    elif kind == 6:
        raw[a : a + 1], raw[b : b + 1] = raw[b : b + 1], raw[a : a + 1]
    elif kind == 7:
        del raw[b:]
    else:  # half of the damages, where there are tokens, speak the format's language
        token = tokens[int(rng.integers(0, len(tokens)))]
        raw[near if kind == 8 else slice(a, a)] = token
    return bytes(raw)
