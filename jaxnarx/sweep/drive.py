"""The verb of a sweep: compute every member once, in a folder that survives."""

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.errors import SpecError
from jaxnarx.solution import RESULTS, Solution
from jaxnarx.sweep.analysis.table import SweepTable
from jaxnarx.sweep.folder.claims import clear_dead
from jaxnarx.sweep.folder.manifest import make_manifest, other_versions
from jaxnarx.sweep.folder.run_folder import RunFolder, find_run, open_run
from jaxnarx.sweep.loop import work_through
from jaxnarx.sweep.precision import is_float64
from jaxnarx.sweep.progress import Progress, Throughput
from jaxnarx.sweep.work import Work

if TYPE_CHECKING:
    from typing import Any


@guard_arguments
def run_sweep(
    work: Work,
    folder: str | Path,
    *,
    chunk: int = 32,
    workers: int = 1,
    client: "Any" = None,
    new: bool = False,
    progress: Progress | None = None,
) -> Solution[SweepTable]:
    """Compute all members of a sweep; the folder is its record.

    Each finished chunk is a file in the folder, so that the same call continues a sweep
    that was stopped, at the loss of the chunks in flight; a folder with other settings
    or data is refused, and one with chunks of another size keeps them. Several calls,
    of other processes or machines too, may share the folder: each chunk is computed by
    one of them.

    A member that fails is a row with status `crashed` and its message. The solution's
    status is `ok` once all rows are there, whatever they say. An interrupted call keeps
    what is finished and says so in a note of its KeyboardInterrupt. Files that cannot
    be written raise a DataFileError.

    Args:
        work: The members and how to compute them, `IdentificationWork` say.
        folder: Folder of the sweep.
        chunk: Members computed together.
        workers: If more than 1, so many processes, each with a core of its own, compute
            instead of this one; a script that asks for them needs the guard `if
            __name__ == "__main__"`. They are a dask cluster whose ports other accounts
            of this machine can reach: use it where those are trusted.
        client: A dask.distributed `Client`, on whose workers chunks are computed.
        new: Set an earlier sweep in the folder aside.
        progress: A function called with a dictionary whenever chunks were added, see
            `jaxnarx.sweep.Progress`.

    Returns:
        `value` is the table, one row per member; `stats` has the number of `members`,
        `statuses` with their counts, the `seconds` all members took together, `redone`
        chunks whose files were damaged, and `notes`.
    """
    _require(work, chunk, workers, client)
    asked = make_manifest(work, chunk=chunk, float64=is_float64())
    run = open_run(Path(folder), asked, new=new)
    notes = other_versions(run.manifest)
    if run.manifest.chunk != chunk:
        notes.append(f"chunks are of {run.manifest.chunk} members, as they were begun")
    redone = run.discard_damaged()
    pace = Throughput(run, progress)
    pace()
    try:
        if client is not None:
            from jaxnarx.sweep.cluster import compute_on_cluster

            notes += compute_on_cluster(run, work, client, pace)
        elif workers > 1 and (left := len(run.unfinished_chunks())):
            from jaxnarx.sweep.processes import compute_in_processes

            notes += compute_in_processes(run, work, min(workers, left), pace)
        else:
            work_through(run, work, pace)
    except KeyboardInterrupt as stop:
        stop.add_note(describe_progress(run))
        raise
    clear_dead(run.claims)
    return _solution(run, redone, notes)


@guard_arguments
def read_sweep(folder: str | Path) -> SweepTable:
    """The rows of a sweep's folder: all, or those that are finished so far.

    DataFileError where the folder holds no sweep, or not one finished chunk.
    """
    run = find_run(Path(folder))
    if not run.finished_chunks():
        raise SpecError(f"{run.path}: no chunk is finished yet", field="folder")
    return SweepTable(run.table(), run.path)


@guard_arguments
def describe_progress(run: RunFolder) -> str:
    """A sentence on how much of a sweep is finished, and how to go on."""
    done = run.finished_chunks()
    members = sum(len(run.members(n)) for n in done)
    return (
        f"{len(done)} of {run.chunks} chunks ({members} of {run.manifest.members} "
        f"members) are finished in {run.path}; the same command continues"
    )


def _require(work: Work, chunk: int, workers: int, client) -> None:
    for name, value in (("chunk", chunk), ("workers", workers)):
        if value < 1:
            raise SpecError(f"{name} must be at least 1, got {value}", field=name)
    if client is not None and workers > 1:
        raise SpecError(
            "workers are processes of this machine, a client has its own; give one of "
            "them",
            field="workers",
        )
    if not work.members:
        raise SpecError("the sweep has no members", field="work")


def _solution(
    run: RunFolder, redone: list[int], notes: list[str]
) -> Solution[SweepTable]:
    table = SweepTable(run.table(keep=True), run.path)
    statuses = dict(Counter(table.column("status").tolist()).most_common())
    said = [f"{len(table)} members: " + _list_statuses(statuses)]
    if redone:
        were = "chunk was" if len(redone) == 1 else "chunks were"
        said.append(f"{len(redone)} damaged {were} computed again")
    stats = {
        "members": len(table),
        "statuses": statuses,
        "seconds": float(table.numbers("seconds").sum()),
        "redone": redone,
        "notes": notes,
    }
    return Solution(table, RESULTS.ok, stats, ". ".join([*said, *notes]) + ".")


def _list_statuses(statuses: dict[str, int]) -> str:
    return ", ".join(f"{count} {name}" for name, count in statuses.items())
