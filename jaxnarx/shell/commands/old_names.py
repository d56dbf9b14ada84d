"""Commands and options of version 0.2 by their new names. No jax here."""

from collections.abc import Sequence

COMMAND_NAMES = {"take": "choose"}
"""Old and new names of commands; the old ones work for one release more."""
OPTION_NAMES = {
    "report": {"--beside": "--compare", "--over": "--map"},
    "export": {"--over": "--map"},
}
"""Old and new options of every command that has some."""


def replace_old_names(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """The arguments by their new names, and a sentence for every old one."""
    if not arguments:
        return [], []
    command = COMMAND_NAMES.get(arguments[0], arguments[0])
    current, advice = [command], []
    if command != arguments[0]:
        advice.append(_advise(f"jaxnarx {command}", f"jaxnarx {arguments[0]}"))
    for word in arguments[1:]:
        option, *value = word.split("=", 1)
        new = OPTION_NAMES.get(command, {}).get(option, option)
        if new != option:
            advice.append(_advise(new, option))
        current.append("=".join([new, *value]))
    return current, advice


def _advise(new: str, old: str) -> str:
    return f"type `{new}` instead of `{old}`, which works for one release more"
