"""What a search tells while it runs: a line for every candidate, and a bar below."""

import functools
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from jaxnarx.identification import figure
from jaxnarx.shell.messages import say
from jaxnarx.shell.search.leaderboard import live_head, live_line

Events = Callable[[dict[str, Any]], None]


SILENT_SECONDS = 5.0
"""Seconds without a line after which one says what is being tried."""


@contextmanager
def search_progress() -> Iterator[Events]:
    """A callback for `identify`: lines, on a terminal above a bar."""
    if not sys.stdout.isatty():
        with _CandidateLines(say).tell_while_silent(SILENT_SECONDS) as lines:
            yield lines
        return
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
    )

    columns = (
        TextColumn("  searching"),
        BarColumn(bar_width=20),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.description}", markup=False),
    )
    with Progress(*columns, transient=True) as bar:
        task = bar.add_task("looking at the data", total=None)
        lines = _CandidateLines(functools.partial(_write_above, bar))

        def tell(event: dict[str, Any]) -> None:
            lines(event)
            if "row" in event:
                bar.update(task, total=event["of"], completed=event["done"])
            bar.update(task, description=lines.now)

        yield tell


def _write_above(bar: Any, text: str) -> None:
    """A line above the bar, as it is."""
    bar.print(text, markup=False, highlight=False, soft_wrap=True)


class _CandidateLines:
    """The lines, and in `now` what is tried, the best so far and the time left where it
    is known."""

    def __init__(self, write: Callable[[str], object]):
        self.write, self.head, self.now = write, False, "looking at the data"
        self.last = self.begin = time.monotonic()

    @contextmanager
    def tell_while_silent(self, seconds: float) -> Iterator["_CandidateLines"]:
        """Add a line about what is being tried wherever so long none was written."""
        ended = threading.Event()

        def beat() -> None:
            while not ended.wait(seconds / 10):
                if time.monotonic() - self.last > seconds:
                    passed = duration(time.monotonic() - self.begin)
                    self._write(f"  ... {passed}: {self.now}")

        thread = threading.Thread(target=beat, daemon=True)
        thread.start()
        try:
            yield self
        finally:
            ended.set()
            thread.join()

    def _write(self, text: str) -> None:
        self.last = time.monotonic()
        self.write(text)

    def __call__(self, event: dict[str, Any]) -> None:
        if "trying" in event:
            self.now = _describe_trial(event)
        if "row" not in event:
            return
        if not self.head:
            self._write(live_head())
            self.head = True
        row, chosen, left = event["row"], event.get("chosen"), event.get("left")
        self._write(live_line(row, chosen == row))
        best = "" if chosen is None else f", so far {figure(chosen)}"
        rest = "" if left is None else f"; about {duration(left)} left"
        self.now = f"{row.output}{best}{rest}"


def _describe_trial(event: dict[str, Any]) -> str:
    """`torque, candidate 12: hidden states, 2 states (group 1 of 4 left out), so far
    0.125`."""
    trying, chosen = event["trying"], event["chosen"]
    words = ", ".join(filter(None, (trying.family, trying.name)))
    nested = " of every choice" * trying.nested
    fold = f" (group {trying.fold} of {trying.folds} left out{nested})"
    fold *= bool(trying.fold)
    best = "" if chosen is None else f", so far {figure(chosen)}"
    return f"{event['output']}, candidate {event['number']}: {words}{fold}{best}"


def duration(seconds: float) -> str:
    """`12 s`, `3 min 20 s`, `1 h 5 min`."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    return f"{minutes // 60} h {minutes % 60} min"
