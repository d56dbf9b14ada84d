"""Entry point of the command line: parse, run, and turn errors into exit codes.

0: done. 1: the model is not usable (a record diverges, or no better than the mean), or
its fit is below `--require-fit`. 2: wrong usage. 3: data or
model files that cannot be used, or results that cannot be written. 70: a defect of this
program. 130: interrupted.
"""

import importlib.metadata
import os
import re
import shlex
import signal
import sys
import threading
from collections.abc import Sequence
from typing import Annotated, Any, Union

import tyro

from jaxnarx.errors import JaxnarxError, SpecError, suggest
from jaxnarx.shell.commands import COMMANDS, Command, help_of

OK, NOT_ACCEPTABLE, USAGE, DATA, DEFECT, INTERRUPTED = 0, 1, 2, 3, 70, 130

_ABOUT = (
    "Identify engines from measurements: polynomial NARX models, each valid in one "
    "operating region, refined on their own free run.\n\n"
    "Exit codes: 0 done, 1 model not usable (a record diverges, or no better than the "
    "mean) or fit below --require-fit, 2 usage, 3 data or model files, 130 interrupted."
)
_FLAGS = {
    "max_terms": "--terms",
    "max_models": "--models",
    "scheduling": "--schedule",
    "max_steps": "--steps",
    "outputs": "--output",
}
"""Options by the name the library has for them, where it is not the same."""
_WORDS = (
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
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    signal.signal(signal.SIGINT, _interrupt)
    sys.exit(run(arguments))


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    try:
        code = _run(arguments)
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # `jaxnarx ... | head`; later output goes nowhere
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OK
    except SpecError as error:
        return _fail(_as_flag(error), USAGE)
    except JaxnarxError as error:
        return _fail(str(error), DATA)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _fail(f"{where}{error.strerror or error}", DATA)
    except KeyboardInterrupt:
        return _fail("interrupted; nothing half-written is left", INTERRUPTED)
    except Exception as error:
        return _unforeseen(error)


def _run(arguments: list[str]) -> int:
    if arguments == ["--version"]:
        print(f"jaxnarx {importlib.metadata.version('jaxnarx')}")
        return OK
    try:
        command = _parse(arguments)
    except SystemExit as stop:
        return int(stop.code or 0) if arguments else USAGE
    from jaxnarx.shell import work

    return work.run(command, typed=shlex.join(["jaxnarx", *arguments]))


def _parse(arguments: list[str]) -> Command:
    """The command that was typed. Help and usage errors raise `SystemExit`."""
    name = arguments[0] if arguments else ""
    if name in COMMANDS:
        return tyro.cli(
            COMMANDS[name],
            args=arguments[1:],
            prog=f"jaxnarx {name}",
            # given here because tyro drops the examples from a docstring it parses
            description=help_of(COMMANDS[name]),
            config=(tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone),
        )
    if name and not name.startswith("-"):
        raise SpecError(f"there is no command {name!r}. {suggest(name, COMMANDS)}")
    listed: Any = tuple(
        Annotated[
            c, tyro.conf.subcommand(n, description=(c.__doc__ or "").split("\n")[0])
        ]
        for n, c in COMMANDS.items()
    )
    union: Any = Union[listed]  # noqa: UP007
    tyro.cli(union, args=arguments or ["--help"], prog="jaxnarx", description=_ABOUT)
    raise AssertionError("an option cannot come before the command")


def _as_flag(error: SpecError) -> str:
    """The message with the option it is about as it is typed."""
    text, field = str(error), error.field or ""
    flag = _FLAGS.get(field, "--" + field.replace("_", "-"))
    return re.sub(rf"^{re.escape(field)}\b", flag, text) if field else text


def _fail(text: str, exit_code: int) -> int:
    for ours, theirs in _WORDS:
        text = text.replace(ours, theirs)
    print(f"jaxnarx: {text}", file=sys.stderr)
    return exit_code


def _unforeseen(error: Exception) -> int:
    if isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error):
        return _fail(
            "the computer's memory does not suffice. Use fewer lags, a lower degree, "
            "or fewer records at a time.",
            DATA,
        )
    import traceback

    traceback.print_exception(error)
    return _fail(
        "this is a defect of jaxnarx rather than of your data. Please report it with "
        "the lines above.",
        DEFECT,
    )


def _interrupt(number: int, frame: Any) -> None:
    """Ctrl-C. Where Python would drop the exception, it is sent again a little later.

    jax has a callback in the garbage collector, out of which no exception comes.
    """
    if frame is not None and frame.f_code.co_name == "_xla_gc_callback":
        threading.Timer(0.05, signal.raise_signal, (number,)).start()
        return
    raise KeyboardInterrupt


if __name__ == "__main__":
    main()
