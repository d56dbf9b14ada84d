"""Messages of the commands: lines, warnings, next commands, whose fault it is."""

import os
import shlex
import sys
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from jaxnarx.errors import DataFileError, SpecError, printable
from jaxnarx.files import unwritable
from jaxnarx.formatting import count as count

if TYPE_CHECKING:
    from jaxnarx.data import Dataset
    from jaxnarx.evaluation import Report


def say(text: str = "", *, end: str = "\n", aside: bool = False) -> None:
    """One line to the user, at once; to standard error where it is said `aside`.

    Lines quote what files hold: characters that would act on a terminal are escaped.

    Where nobody reads any longer (`jaxnarx ... | head`), the work goes on in silence,
    so that its files and its exit code do not depend on who watches. Of what else keeps
    standard output from being written, a full disk, only standard error can tell.
    """
    to = sys.stderr if aside else sys.stdout
    try:
        print(printable(text), file=to, end=end, flush=True)
    except OSError as error:
        # what is written from now on, and what waits to be, goes nowhere
        os.dup2(os.open(os.devnull, os.O_WRONLY), to.fileno())
        if not aside and not isinstance(error, BrokenPipeError):
            raise unwritable("standard output", error) from error


def warn(text: str) -> None:
    """One line to standard error."""
    say(f"jaxnarx: {text}", aside=True)


def quote_command(*words: str, remark: str = "") -> str:
    """A command as it is typed, and a remark behind it."""
    return f"{shlex.join(words)}{remark}"


def first_lines(report: "Report") -> str:
    """The first lines of a report: may it be used, where, why, and what helps."""
    return "\n".join(report.summary.lines())


@contextmanager
def about(source: str, *, but: Collection[str] = ()) -> Iterator[None]:
    """Name the contents of a file as the cause, which is not wrong usage; the fields of
    `but`, which were typed, are."""
    try:
        yield
    except SpecError as error:
        if error.field in but:
            raise
        lead = "" if source in str(error) else f"{source}: "
        raise DataFileError(f"{lead}{error}", path=source) from error


def size(data: "Dataset") -> str:
    """The number of records and samples, their distance, and whether all runs in
    float32."""
    single = len(data) > 0 and data.records[0].u.dtype == "float32"
    return (
        f"{count(len(data), 'record')}, {count(data.samples, 'sample')} at "
        f"{data.sample_time:g} s" + ", in float32" * single
    )
