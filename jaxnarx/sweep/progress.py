"""Progress of a sweep, read off its folder, so that all processes see the same."""

import time
from collections.abc import Callable
from typing import Any

from jaxnarx.sweep.folder.run_folder import RunFolder

Progress = Callable[[dict[str, Any]], object]
"""A function called with `done` and `of` members, `chunks` and `of_chunks`, `rate` in
members per second and seconds `left`; these two are None until a chunk has come. The
rate counts from the first chunk on, which came with the compilation, as soon as that is
longer than what went before; until then from the call on, so that more time is rather
left than less."""


class Throughput:
    """Tells a callback when chunks have been added to the folder."""

    def __init__(self, run: RunFolder, progress: Progress | None):
        self.run, self.progress = run, progress
        self.begin = (time.perf_counter(), self._members_done())
        self.first: tuple[float, int] | None = None
        self.told: int | None = None

    def __call__(self) -> None:
        """Count, and tell if there is news."""
        done = self._members_done()
        if self.progress is None or done == self.told:
            return
        self.told, of = done, self.run.manifest.members
        rate = self._rate(done)
        self.progress(
            {
                "done": done,
                "of": of,
                "chunks": len(self.run.finished_chunks()),
                "of_chunks": self.run.chunks,
                "rate": rate,
                "left": (of - done) / rate if rate else None,
            }
        )

    def _rate(self, done: int) -> float | None:
        if done == self.begin[1]:
            return None
        now = time.perf_counter()
        first = self.first = self.first or (now, done)
        settled = now - first[0] > first[0] - self.begin[0]
        since, before = first if settled else self.begin
        return (done - before) / (now - since)

    def _members_done(self) -> int:
        return sum(len(self.run.members(n)) for n in self.run.finished_chunks())
