"""Entry point of the command line: parse, run, and turn errors into exit codes.

0: done. 1: the model is not usable (a record diverges, or no better than the mean), or
its fit is below `--require-fit`. 2: wrong usage. 3: data or model files that cannot be
used, or results that cannot be written. 70: a defect of this program. 130: interrupted.
143: ended by SIGTERM.

Little is imported here, so that an interrupt finds its handler from early on.
"""

import contextlib
import os
import re
import shlex
import signal
import sys
from collections.abc import Sequence

from jaxnarx.errors import DataFileError, JaxnarxError, SpecError
from jaxnarx.shell import interrupt
from jaxnarx.shell.messages import say, warn

EXIT_OK, EXIT_NOT_ACCEPTABLE, EXIT_USAGE, EXIT_DATA = 0, 1, 2, 3
EXIT_DEFECT, EXIT_INTERRUPTED = 70, 130

_DESCRIPTION_ADVICE = (
    (
        "Use missing='mask', 'split' or 'interpolate'.",
        'Fill the gap, or state missing = "mask", "split" or "interpolate" under '
        "[data] of a description.",
    ),
    ("root=...", "--root"),
    ("new=True (--new-run)", "--new-run"),
)
"""What messages of the library advise in Python, and how a description says it."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit."""
    interrupt.listen()
    _open_streams()
    code = run(arguments)
    for number in interrupt.ENDING_SIGNALS:  # nothing is left to be interrupted
        signal.signal(number, signal.SIG_IGN)
    sys.exit(code)


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    try:
        code = _run(arguments)
        say(end="")  # and what others have written, help for one
        return code
    except (Exception, KeyboardInterrupt) as error:
        with contextlib.suppress(DataFileError):
            say(end="")  # if it is standard output that fails, it goes silent here
        return _tell(error)


def _run(arguments: list[str]) -> int:
    if arguments == ["--version"]:
        import importlib.metadata

        say(f"jaxnarx {importlib.metadata.version('jaxnarx')}")
        return EXIT_OK
    if arguments[:1] in ([], ["-h"], ["--help"]):
        from jaxnarx.shell.commands.overview import overview

        say(overview())
        return EXIT_OK if arguments else EXIT_USAGE
    from jaxnarx.shell.commands.old_names import replace_old_names
    from jaxnarx.shell.commands.parse import parse

    arguments, advice = replace_old_names(arguments)
    for sentence in advice:
        warn(sentence)
    try:
        command = parse(arguments)
    except SystemExit as stop:
        return int(stop.code or 0)
    from jaxnarx.shell import dispatch

    return dispatch.run(command, typed=shlex.join(["jaxnarx", *arguments]))


def _tell(error: BaseException) -> int:
    """Tell what went wrong; returns the exit code.

    Whatever comes after an interrupt comes of it.
    """
    if isinstance(error, KeyboardInterrupt) or interrupt.requested_exit_code():
        code = interrupt.requested_exit_code() or EXIT_INTERRUPTED
        return _fail("interrupted; nothing half-written is left", code)
    if isinstance(error, BrokenPipeError):  # `jaxnarx --help | head`
        return EXIT_OK
    if isinstance(error, SpecError):
        return _fail(_name_option(error), EXIT_USAGE)
    if isinstance(error, JaxnarxError):
        return _fail(str(error), EXIT_DATA)
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return _fail(f"{where}{error.strerror or error}", EXIT_DATA)
    return _report_defect(error)


def _open_streams() -> None:
    """Let output to a closed stream go nowhere, and escape odd characters.

    In this order, so that no file of ours gets the number of a stream.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode))
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]


def _name_option(error: SpecError) -> str:
    """The message with the option it is about as it is typed."""
    from jaxnarx.shell.commands.flags import flag_of

    text, field = str(error), error.field
    return re.sub(rf"^{re.escape(field)}\b", flag_of(field), text) if field else text


def _fail(text: str, exit_code: int) -> int:
    for ours, theirs in _DESCRIPTION_ADVICE:
        text = text.replace(ours, theirs)
    warn(text)
    return exit_code


def _report_defect(error: BaseException) -> int:
    if isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error):
        return _fail(
            "the computer's memory does not suffice. Use fewer lags, a lower degree, "
            "or fewer records at a time.",
            EXIT_DATA,
        )
    import traceback

    traceback.print_exception(error)
    return _fail(
        "this is a defect of jaxnarx rather than of your data. Please report it with "
        "the lines above.",
        EXIT_DEFECT,
    )


if __name__ == "__main__":
    main()
