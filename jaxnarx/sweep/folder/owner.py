"""Who works on a chunk: one process of one machine, told from all that follow it."""

import dataclasses
import functools
import hashlib
import os
import platform
from pathlib import Path


@dataclasses.dataclass(frozen=True)
class Owner:
    """A process: the machine it runs on, its number there and when it was started.

    Numbers of processes are used again, and containers number their own: hence
    `started`, in the kernel's clock ticks, and a `machine` that names the start of the
    system and the space the number counts in. Both are empty where they are not known.
    """

    machine: str
    pid: int
    started: str

    @property
    def token(self) -> str:
        """Short text for file names, another one for every process."""
        text = f"{self.machine} {self.pid} {self.started}"
        return f"{self.pid}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"

    def is_gone(self) -> bool | None:
        """Whether the process has ended; None for one of another machine."""
        if os.name != "posix" or self.machine != machine():
            return None
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return True
        except PermissionError:
            pass
        state, started = _state(self.pid)
        return state in ("Z", "X") or started != self.started


def this_process() -> Owner:
    """The owner that this process is."""
    return _owner(os.getpid())


@functools.lru_cache(maxsize=2)
def _owner(pid: int) -> Owner:
    return Owner(machine(), pid, _state(pid)[1])


@functools.cache
def machine() -> str:
    """Name of the machine, its present start, and the space of its process numbers."""
    parts = [platform.node()]
    for read in (
        lambda: Path("/proc/sys/kernel/random/boot_id").read_text().strip(),
        lambda: os.readlink("/proc/self/ns/pid"),
    ):
        try:
            parts.append(read())
        except OSError:
            parts.append("")
    return "|".join(parts)


def _state(pid: int) -> tuple[str, str]:
    """Linux's letter for the state of a process and its start; else empty."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(errors="replace")
    except OSError:
        return "", ""
    fields = text.rpartition(")")[2].split()
    return fields[0], fields[19]
