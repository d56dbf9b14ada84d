"""What was typed, as a command. No jax here: help and usage errors come at once."""

from collections.abc import Sequence

import tyro

from jaxnarx.errors import SpecError, suggest
from jaxnarx.shell.commands import COMMANDS, Command, help_of
from jaxnarx.shell.commands.flags import add_options, settle_command


def parse(arguments: Sequence[str]) -> Command:
    """The command that was typed. Help and usage errors raise `SystemExit`."""
    name = arguments[0]
    if name in COMMANDS:
        parsed = tyro.cli(
            add_options(COMMANDS[name]),
            args=arguments[1:],
            prog=f"jaxnarx {name}",
            # given here because tyro drops the examples from a docstring it parses
            description=help_of(COMMANDS[name]),
            config=(tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone),
        )
        return settle_command(COMMANDS[name], parsed)
    if name.startswith("-"):
        raise SpecError(
            f"{name} is an option without a command; `jaxnarx --help` lists commands"
        )
    raise SpecError(f"there is no command {name!r}. {suggest(name, COMMANDS)}")
