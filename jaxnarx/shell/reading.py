"""Which file is being read, where that takes long."""

import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from jaxnarx.shell.messages import count, say

SILENT_SECONDS, LINE_INTERVAL_SECONDS = 2.0, 10.0
"""Seconds until reading is told of, and between lines about one file."""
READING_PAUSE_SECONDS = 0.5
"""Seconds without a file being read after which the reading is over."""


@contextmanager
def tell_reading() -> Iterator[None]:
    """Tell, beside the output, the file that is being read, from two seconds on, and
    the seconds that reading has taken once it is over."""
    from jaxnarx.data import FILE_WATCHER

    log = _ReadingLog()
    ended = threading.Event()

    def watch_and_tell() -> None:
        while not ended.wait(0.2):
            log.tell(time.monotonic())
        log.tell(math.inf)

    token = FILE_WATCHER.set(log.watch)
    teller = threading.Thread(target=watch_and_tell, daemon=True)
    teller.start()
    try:
        yield
    finally:
        ended.set()
        teller.join()
        FILE_WATCHER.reset(token)


class _ReadingLog:
    """Files that are read, and lines about them."""

    def __init__(self) -> None:
        self.seen: dict[Path, int] = {}
        self.now: Path | None = None
        self.told: Path | None = None
        self.last = self.changed = time.monotonic()
        self.spent = 0.0

    def watch(self, path: Path | None) -> None:
        """Hear that a file is begun, or with None that it has ended."""
        at = time.monotonic()
        if self.now is not None:
            self.spent += at - self.changed
        if path is not None:
            # a file may be opened several times
            self.seen.setdefault(path, len(self.seen) + 1)
        self.now, self.changed = path, at

    def tell(self, at: float) -> None:
        """Say what there is to say at a time of the clock [s]."""
        path = self.now
        if path is not None and at < math.inf:
            if at - self.last > (
                LINE_INTERVAL_SECONDS if path == self.told else SILENT_SECONDS
            ):
                more = f" (file {self.seen[path]})" if len(self.seen) > 1 else ""
                say(f"reading {path}{more}", aside=True)
                self.last, self.told = at, path
        elif self.told is not None and at - self.changed > READING_PAUSE_SECONDS:
            files = count(len(self.seen), "file")
            say(f"read {files} in {self.spent:.0f} s", aside=True)
            self.told = None
