"""The command line's own help as pages, and the keys of a description of records."""

import inspect
import os
import re
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager

import tyro

from jaxnarx.settings.description import DESCRIPTION
from jaxnarx.shell.commands import COMMANDS, help_of
from jaxnarx.shell.commands.flags import add_options


def made() -> dict[str, str]:
    """A page of all commands and one of the description file."""
    lines = ["# Command line", "", "What `jaxnarx COMMAND --help` says.", ""]
    for name, command in COMMANDS.items():
        usage, options = _help(command, name)
        lines += [f"## jaxnarx {name}", "", _words(command), ""]
        lines += ["```text", usage, "", options, "```", ""]
    return {"commands.md": "\n".join(lines), "description.md": _description()}


def _words(command: type) -> str:
    """What a command does, its examples as blocks."""
    words = inspect.getdoc(command) or ""
    return re.sub(
        r"((?:^    .*\n?)+)",
        lambda found: f"\n```console\n{textwrap.dedent(found[1]).rstrip()}\n```\n",
        words,
        flags=re.M,
    )


def _help(command: type, name: str) -> tuple[str, str]:
    """Usage and options of a command; what stands between them is told elsewhere."""
    text = plain(command, name)
    return text.partition("\n\n")[0].strip(), text[text.index("╭─") :].strip()


def plain(command: type, name: str) -> str:
    """The help as tyro makes it, 88 characters wide, without colours."""
    with _columns("88"):
        parser = tyro.extras.get_parser(
            add_options(command),
            prog=f"jaxnarx {name}",
            description=help_of(command),
            config=(tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone),
        )
        return re.sub(r"\x1b\[[0-9;]*m", "", parser.format_help())


@contextmanager
def _columns(width: str) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in ("COLUMNS", "NO_COLOR")}
    os.environ.update(COLUMNS=width, NO_COLOR="1")
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value


def _description() -> str:
    """The keys as the help shows them, and the rules in words."""
    keys, rules = DESCRIPTION.split("\n\n", 1)
    head, _, block = keys.partition("\n")
    block = re.sub(r"^    ", "", block, flags=re.M)
    return (
        f"# The description of records\n\n{head}\n\n```toml\n{block}\n```\n\n{rules}\n"
    )
