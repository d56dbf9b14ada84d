"""The loop of one process over a run folder: claim a chunk, compute it, write it."""

import time
from collections.abc import Callable

from jaxnarx.sweep.folder.claims import Claims
from jaxnarx.sweep.folder.run_folder import RunFolder
from jaxnarx.sweep.rows import compute_rows
from jaxnarx.sweep.work import Work

PAUSE_SECONDS = 0.2
"""Seconds between two looks at a folder whose open chunks others compute."""


def work_through(run: RunFolder, work: Work, tell: Callable[[], None]) -> None:
    """Compute chunks until the folder has all of them, whoever made them.

    Chunks that others have claimed are left to them; once only such are open, this
    process waits, and takes over what a process that died has left. `tell` is called
    after every chunk and every pause.
    """
    labels, whole = work.members, run.manifest.chunk
    piece = whole
    with Claims(run.claims) as claims:
        while open_chunks := run.unfinished_chunks():
            took = False
            for number in open_chunks:
                if not claims.take(number):
                    continue
                try:
                    if not run.is_finished(number):
                        members, took = run.members(number), True
                        named = [labels[i] for i in members]
                        rows, piece = compute_rows(work, members, named, piece, whole)
                        run.write(number, rows)
                finally:
                    claims.release(number)
                tell()
            if not took:
                time.sleep(PAUSE_SECONDS)
                tell()
