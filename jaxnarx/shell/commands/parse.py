"""What was typed, as a command. No jax here: help and usage errors come at once."""

from collections.abc import Sequence
from typing import Annotated, Any, Union

import tyro

from jaxnarx.errors import SpecError, suggest
from jaxnarx.shell.commands import COMMANDS, Command, help_of
from jaxnarx.shell.commands.flags import settle_command, with_options

_ABOUT = (
    "Identify engines from measurements: polynomial NARX models, each valid in one "
    "operating region, refined on their own free run.\n\n"
    "Exit codes: 0 done, 1 model not usable (a record diverges, or no better than the "
    "mean) or fit below --require-fit, 2 usage, 3 data or model files, 130 "
    "interrupted, 143 ended by SIGTERM."
)


def parse(arguments: Sequence[str]) -> Command:
    """The command that was typed. Help and usage errors raise `SystemExit`."""
    name = arguments[0] if arguments else ""
    if name in COMMANDS:
        parsed = tyro.cli(
            with_options(COMMANDS[name]),
            args=arguments[1:],
            prog=f"jaxnarx {name}",
            # given here because tyro drops the examples from a docstring it parses
            description=help_of(COMMANDS[name]),
            config=(tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone),
        )
        return settle_command(COMMANDS[name], parsed)
    if name and not name.startswith("-"):
        raise SpecError(f"there is no command {name!r}. {suggest(name, COMMANDS)}")
    listed: Any = tuple(
        Annotated[
            with_options(c),
            tyro.conf.subcommand(n, description=(c.__doc__ or "").split("\n")[0]),
        ]
        for n, c in COMMANDS.items()
    )
    union: Any = Union[listed]  # noqa: UP007
    tyro.cli(union, args=arguments or ["--help"], prog="jaxnarx", description=_ABOUT)
    raise AssertionError("an option cannot come before the command")
