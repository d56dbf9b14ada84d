"""Entry point of the command line: parse, run, and turn errors into exit codes.

0: done. 1: the fit is not acceptable (`--require-fit`). 2: wrong usage. 3: data or model
files that cannot be used. 130: interrupted.
"""

import os
import sys
from collections.abc import Sequence

import tyro

from jaxnarx.errors import JaxnarxError, SpecError
from jaxnarx.shell.commands import Command

OK, NOT_ACCEPTABLE, USAGE, DATA, INTERRUPTED = 0, 1, 2, 3, 130


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit."""
    sys.exit(run(arguments))


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    try:
        command = tyro.cli(
            Command,
            args=arguments,
            prog="jaxnarx",
            description=(
                "Identify engines from measurements: polynomial NARX models, each valid "
                "in one operating region, refined on their own free run."
            ),
        )
    except SystemExit as stop:
        return int(stop.code or 0)
    try:
        from jaxnarx.shell import work

        return work.run(command)
    except SpecError as error:
        return _fail(error, USAGE)
    except JaxnarxError as error:
        return _fail(error, DATA)
    except OSError as error:
        return _fail(f"{error.filename or 'a file'}: {error.strerror or error}", DATA)
    except KeyboardInterrupt:
        print("interrupted; nothing half-written is left", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OK


def _fail(error: object, exit_code: int) -> int:
    print(f"jaxnarx: {error}", file=sys.stderr)
    return exit_code


if __name__ == "__main__":
    main()
