"""Descriptions of records as commands are given them."""

from typing import TYPE_CHECKING

from jaxnarx.errors import SpecError
from jaxnarx.shell.messages import about, say

if TYPE_CHECKING:
    from jaxnarx.data import Dataset, Split


def read_description(path: str, root: str | None) -> "Split":
    """The records of a TOML description, by what they are for."""
    from jaxnarx.data import read_split

    if not path.lower().endswith(".toml"):
        raise SpecError(
            f"{path} is not a TOML description. Write one that names channels, units, "
            "sample time and files; `jaxnarx check --help` shows the smallest."
        )
    with about(path):
        split = read_split(path, root=root)
    tell_notes(split.all)
    return split


def tell_findings(data: "Dataset") -> None:
    """Tell what a first look at training records turns up, before work begins."""
    from jaxnarx.data import first_look

    found = first_look(data)
    if len(found):
        say(f"{found}\nMore: jaxnarx check")


def tell_notes(data: "Dataset") -> None:
    """Tell what reading did to the samples, beside the output."""
    for note in data.notes:
        say(note, aside=True)
