"""`jaxnarx sweep`: a described sweep in its run folder."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from jaxnarx import fleet
from jaxnarx.errors import DataError, JaxnarxError
from jaxnarx.shell.commands import Sweep
from jaxnarx.shell.interrupt import last_words
from jaxnarx.shell.messages import about
from jaxnarx.shell.output import slug, write_text, write_together
from jaxnarx.shell.progress import count, say
from jaxnarx.shell.sweep.description import load_sweep
from jaxnarx.shell.sweep.fleet import calibration_work, make_fleet
from jaxnarx.shell.sweep.table import (
    best_lines,
    calibration_lines,
    status_lines,
    sweep_csv,
)
from jaxnarx.sweep import (
    IdentificationWork,
    Progress,
    SweepTable,
    best_per_group,
    describe_progress,
    find_run,
    run_sweep,
)

TABLE_FILE = "table.csv"
PROGRESS_SHARE = 0.1
"""Share of the members after which a plain line tells of progress."""


def sweep(command: Sweep) -> None:
    """Run or continue the sweep, and tell what came out.

    DataError where every member crashed; the table is written all the same.
    """
    description = load_sweep(Path(command.description))
    folder = Path(command.folder or Path("runs") / slug(Path(command.description).stem))
    with about(command.description):
        if description.fleet is None:
            engines = make_fleet(description)
            work = IdentificationWork(engines, description.method, description.cases)
            asked = "fit", len(engines), count(len(work.cases), "case")
        else:
            work = calibration_work(description, description.fleet)
            numbers = count(len(work.samples), "number") + " of samples"
            asked = "calibration", len(work.engines), numbers
    kind, engines, by = asked
    say(
        f"{count(len(work.members), kind)}: {count(engines, 'engine')} by {by}, "
        f"{command.chunk} to a chunk"
    )
    try:
        with sweep_progress() as progress, last_words(lambda: _tell_so_far(folder)):
            solution = run_sweep(
                work,
                folder,
                chunk=command.chunk,
                workers=command.workers,
                new=command.new_run,
                progress=progress,
            )
    except KeyboardInterrupt:
        _tell_so_far(folder)
        raise
    for note in solution.stats["notes"]:
        say(f"  note: {note}")
    _tell(solution.value, work)
    with write_together(folder) as place:
        write_text(place / TABLE_FILE, sweep_csv(solution.value))
    say(f"\nwrote table.parquet and {TABLE_FILE} to {folder}")
    crashed = _crashed_rows(solution.value)
    if len(crashed) == len(solution.value):
        first = crashed[0]
        raise DataError(
            f"every member crashed; once that is mended, begin anew with --new-run. "
            f"The first was {first['engine']}: {first['message']}"
        )


def _crashed_rows(table: SweepTable) -> list[dict[str, Any]]:
    return [row for row in table.rows() if row["status"] == "crashed"]


def _tell(table: SweepTable, work: IdentificationWork | fleet.CalibrationWork) -> None:
    say("\nMembers by status")
    for line in status_lines(table):
        say(line)
    crashed = _crashed_rows(table)
    if len(crashed) == len(table):
        return
    if crashed:
        say(f"  the first crash, {crashed[0]['engine']}: {crashed[0]['message']}")
    if isinstance(work, fleet.CalibrationWork):
        say("\nNRMSE of the free run behind these samples, median over the engines")
        for line in calibration_lines(table, work.prior.network.output_names):
            say(line)
        return
    known = work.fleet
    judge = "validation" if known.validation is not None else "train"
    scores = [f"{part}_free_run" for part in known.parts]
    best = best_per_group(table, "engine", f"{judge}_free_run")
    varied = list(dict.fromkeys(path for case in work.cases for path in case))
    if len(best):
        say(f"\nBest of each engine by the free run on {judge} records, NRMSE")
        for line in best_lines(best, ["engine", *varied, "status", *scores]):
            say(line)


def _tell_so_far(folder: Path) -> None:
    try:
        say(f"  {describe_progress(find_run(folder))}")
    except JaxnarxError:  # interrupted before the folder was there
        pass


@contextmanager
def sweep_progress() -> Iterator[Progress]:
    """A callback for `run_sweep`: a bar on a terminal, else a line now and then."""
    if not sys.stdout.isatty():
        yield _Lines()
        return
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
    from rich.progress import Progress as Bar

    columns = (
        TextColumn("  sweeping"),
        BarColumn(bar_width=24),
        MofNCompleteColumn(),
        TextColumn("{task.description}"),
    )
    with Bar(*columns, transient=True) as bar:
        task = bar.add_task("compiling", total=None)

        def tell(row: dict[str, Any]) -> None:
            text = _pace(row) or "compiling"
            bar.update(task, description=text, total=row["of"], completed=row["done"])

        yield tell


class _Lines:
    """A line for every tenth of the members."""

    def __init__(self):
        self.next = 0.0

    def __call__(self, row: dict[str, Any]) -> None:
        share = row["done"] / row["of"]
        if share < self.next:
            return
        self.next = min(share + PROGRESS_SHARE, 1.0)
        pace = _pace(row)
        say(f"  {row['done']} of {row['of']} fits" + (f", {pace}" if pace else ""))


def _pace(row: dict[str, Any]) -> str:
    if row["rate"] is None:
        return ""
    seconds = round(row["left"])
    hours, minutes = divmod(seconds // 60, 60)
    left = f"{hours} h {minutes} min" if hours else f"{minutes} min {seconds % 60} s"
    return f"{row['rate']:.3g} a second, {left} left"
