"""What was typed, as a command. No jax here: help and usage errors come at once."""

from collections.abc import Sequence

import tyro

from jaxnarx.errors import SpecError, suggest
from jaxnarx.shell.commands import COMMANDS, Command, help_of
from jaxnarx.shell.commands.flags import add_options, settle_command


def parse(arguments: Sequence[str]) -> Command:
    """The command that was typed. Help and usage errors raise `SystemExit`."""
    words = 2 if " ".join(arguments[:2]) in COMMANDS else 1
    name, rest = " ".join(arguments[:words]), arguments[words:]
    if name in COMMANDS:
        parsed = tyro.cli(
            add_options(COMMANDS[name]),
            args=rest,
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
    if under := [known for known in COMMANDS if known.startswith(f"{name} ")]:
        if rest[:1] in (["-h"], ["--help"]):
            lines = [help_of(COMMANDS[k]).splitlines()[0] for k in under]
            rows = [f"jaxnarx {k}: {t}" for k, t in zip(under, lines, strict=True)]
            print("\n".join([*rows, f"`jaxnarx {under[0]} --help` has its options."]))
            raise SystemExit(0)
        raise SpecError(f"{name} needs one of: {', '.join(under)}")
    raise SpecError(f"there is no command {name!r}. {suggest(name, COMMANDS)}")
