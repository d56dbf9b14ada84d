"""Descriptions of records as commands are given them."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from jaxnarx.errors import SpecError
from jaxnarx.shell.messages import about, say

if TYPE_CHECKING:
    from jaxnarx.data import Dataset, Split
    from jaxnarx.models import Network


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


def read_records(
    files: Sequence[str], root: str | None, network: "Network"
) -> "Dataset":
    """The records of one description or of data files, with the model's channels."""
    from jaxnarx.data import match_channels, read_files

    if not files:
        raise SpecError("give data files or one TOML description")
    first = files[0]
    if any(f.lower().endswith(".toml") for f in files):
        if len(files) > 1:
            raise SpecError("give one description, or data files, not both")
        split = read_description(first, root)
        with about(first):
            return match_channels(split.all, network.channels.measured)[0]
    step = float(network.sample_time)
    data = read_files(
        files, network.channels.measured, sample_time=step, missing="mask"
    )
    tell_notes(data)
    return data


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
