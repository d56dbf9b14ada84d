"""Which file is being read, where that takes long."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from jaxnarx.shell.messages import say

SILENT, LONG = 2.0, 10.0
"""Seconds until reading is told of, and between lines about one file."""


@contextmanager
def reading_told() -> Iterator[None]:
    """Beside the output, the file that is being read, from two seconds on."""
    from jaxnarx.data.readers import WATCHER

    begin, files = time.monotonic(), 0
    now: list[Path] = []
    ended = threading.Event()

    def watch(path: Path | None) -> None:
        nonlocal files
        now.clear()
        if path is not None:
            files += 1
            now.append(path)

    def tell() -> None:
        last, told = begin, Path()
        while not ended.wait(0.2):
            at = time.monotonic()
            for path in tuple(now):
                if at - last > (LONG if path == told else SILENT):
                    say(f"reading {path} (file {files})", aside=True)
                    last, told = at, path

    token = WATCHER.set(watch)
    teller = threading.Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield
    finally:
        ended.set()
        teller.join()
        WATCHER.reset(token)
