"""Which file is being read, where that takes long."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from jaxnarx.shell.messages import count, say

SILENT, LONG = 2.0, 10.0
"""Seconds until reading is told of, and between lines about one file."""


@contextmanager
def reading_told() -> Iterator[None]:
    """Beside the output, the file that is being read, from two seconds on."""
    from jaxnarx.data.readers import WATCHER

    begin = time.monotonic()
    seen: dict[Path, int] = {}
    now: list[Path] = []
    ended = threading.Event()

    def watch(path: Path | None) -> None:
        now.clear()
        if path is not None:
            seen.setdefault(path, len(seen) + 1)  # a file may be opened several times
            now.append(path)

    def tell() -> None:
        last, told = begin, None
        while not ended.wait(0.2):
            at = time.monotonic()
            for path in tuple(now):
                if at - last > (LONG if path == told else SILENT):
                    more = f" (file {seen[path]})" if len(seen) > 1 else ""
                    say(f"reading {path}{more}", aside=True)
                    last, told = at, path
        if told is not None:
            files = count(len(seen), "file")
            say(f"read {files} in {time.monotonic() - begin:.0f} s", aside=True)

    token = WATCHER.set(watch)
    teller = threading.Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield
    finally:
        ended.set()
        teller.join()
        WATCHER.reset(token)
