"""Progress of long work: a bar on a terminal, a line per stage otherwise."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from jaxnarx.arrays import Progress
from jaxnarx.shell.messages import count, say


def selection_progress(row: dict[str, Any]) -> None:
    """A line for every round of a selection on simulation error."""
    say(
        f"  {row['terms']:3d} of {row['of']} terms, training NRMSE "
        f"{row['loss'] ** 0.5:.4f}: {row['term']} {row['what']}"
    )


@contextmanager
def refinement_progress() -> Iterator[Progress]:
    """A callback for `refine`: loss, horizon and time left while it runs."""
    if sys.stdout.isatty():
        with _bar() as callback:
            yield callback
    else:
        lines = _StageLines()
        yield lines
        lines.tell()


@contextmanager
def _bar() -> Iterator[Progress]:
    from rich.progress import (
        BarColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("  refining"),
        BarColumn(bar_width=24),
        TextColumn("{task.description}"),
        TimeElapsedColumn(),
        TextColumn("left at most"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, transient=True) as bar:
        task = bar.add_task("compiling", total=None)

        def callback(row: dict[str, Any]) -> None:
            text = (
                f"{row['stage']:>12}  NRMSE {row['loss'] ** 0.5:.4f}  "
                f"validation {row['validation'] ** 0.5:.4f}"
                + (" (diverged)" if row["diverged"] else "")
            )
            bar.update(task, description=text, total=row["of"], completed=row["done"])

        yield callback


class _StageLines:
    """Quiet form: the last step of every stage, once the stage is over."""

    def __init__(self):
        self.last: dict[str, Any] | None = None

    def __call__(self, row: dict[str, Any]) -> None:
        if self.last is not None and self.last["stage"] != row["stage"]:
            self.tell()
        self.last = row

    def tell(self) -> None:
        row = self.last
        if row is not None:
            steps = count(row["stage_step"], "step")
            say(
                f"  {row['stage']:>12}: {steps:>8}, training NRMSE "
                f"{row['loss'] ** 0.5:.4f}, validation {row['validation'] ** 0.5:.4f}"
                + (" (diverged)" if row["diverged"] else "")
            )
