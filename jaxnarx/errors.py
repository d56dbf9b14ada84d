"""The error tree: every message says what is wrong, where, and what to do.

Jax-free, so that the command line can report bad input without importing jax.
"""

import contextlib
import difflib
import re
from collections.abc import Iterable, Iterator

__all__ = ["DataError", "DataFileError", "JaxnarxError", "ModelFileError", "SpecError"]


class JaxnarxError(ValueError):
    """Root of all errors this package raises on purpose.

    Messages quote what files hold, so characters that would act on a terminal are
    written as escapes.
    """

    def __init__(self, message: str = ""):
        super().__init__(printable(_shorten(message)))


class DataError(JaxnarxError):
    """The measurements cannot be used as they are.

    `channel` is a name, `row` the zero-based data row in its record, `time` the time of
    that row in seconds; each is `None` where it does not apply.
    """

    def __init__(
        self,
        message: str,
        *,
        channel: str | None = None,
        row: int | None = None,
        time: float | None = None,
    ):
        super().__init__(message)
        self.channel = channel
        self.row = row
        self.time = time


class DataFileError(JaxnarxError):
    """A data or description file cannot be read; `path` names it."""

    def __init__(self, message: str, *, path: object = None):
        super().__init__(message)
        self.path = path


class SpecError(JaxnarxError):
    """A request makes no sense; `field` names the offending argument or setting."""

    def __init__(self, message: str, *, field: str | None = None):
        super().__init__(message)
        self.field = field


class ModelFileError(JaxnarxError):
    """A model file is truncated, foreign or newer than this program; `path` names
    it.
    """

    def __init__(self, message: str, *, path: object = None):
        super().__init__(message)
        self.path = path


def printable(text: str) -> str:
    """`text` with all but printable characters and line ends as escapes."""
    return "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)


def _shorten(text: str) -> str:
    """`text` without the middle of words that no one reads."""
    return re.sub(r"(\S{200})\S{200,}(\S{50})", r"\1...\2", str(text))


@contextlib.contextmanager
def guard_reading(
    path: object,
    kind: str = "a data file",
    *,
    error: type[DataFileError] | type[ModelFileError] = DataFileError,
    advice: str = "Export it anew, or restore it from a copy.",
) -> Iterator[None]:
    """The guard at the edge of every reader: nothing but this package's own errors.

    Whatever a parser trips over inside (damaged files raise all kinds of exceptions, in
    places that nobody foresees) becomes an `error` that names `path`, says what was to
    be read and gives `advice`. It is the net below the messages that know better: our
    own errors pass as they are, and so do interrupts and a lack of memory.
    """
    try:
        yield
    except (JaxnarxError, MemoryError):
        raise
    except Exception as cause:
        if isinstance(cause, OSError) and cause.strerror:
            what = f"cannot be opened ({cause.strerror})."
        else:
            said = " ".join(f"{type(cause).__name__}: {cause}".split())
            said = said if len(said) <= 200 else said[:197] + "..."
            what = f"cannot be read as {kind} ({said}). {advice}"
        raise error(f"{path}: {what}", path=path) from cause


def nearest(name: str, known: Iterable[str]) -> str:
    """The sentence 'Did you mean ...' with the nearest names, or nothing."""
    near = difflib.get_close_matches(name, list(known), n=3, cutoff=0.5)
    return f"Did you mean {' or '.join(map(repr, near))}?" if near else ""


def suggest(name: str, known: Iterable[str]) -> str:
    """The sentence of `nearest`, or the list of names."""
    known = list(known)
    return nearest(name, known) or f"Known names: {', '.join(known)}."
