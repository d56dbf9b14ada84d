"""Notes on the model's policies for whoever calls exported code."""

import textwrap
from collections.abc import Iterable, Sequence

from jaxnarx.exporters.form import INDEX_FLAG
from jaxnarx.models import (
    LARGEST_INDEX,
    Network,
    describe_limits,
    describe_missing,
)


def policy_notes(network: Network, flags: Iterable[str]) -> tuple[str, ...]:
    """A paragraph for each policy."""
    index = f", its index is {LARGEST_INDEX:g}" if INDEX_FLAG in flags else ""
    missing = describe_missing(network, index)
    return (
        f"{missing} Measured outputs of the start are treated alike.",
        " ".join(describe_limits(network)),
        _bound_note(network),
    )


def _bound_note(network: Network) -> str:
    hidden = " or on a hidden channel, which enters it" if network.hidden else ""
    return (
        "limited is 1 where the bound of what is fed back has acted on an output"
        f"{hidden}."
    )


def wrap_paragraphs(notes: Sequence[str], lead: str, width: int = 80) -> list[str]:
    """The paragraphs as lines of a comment, an empty one before each."""
    lines = []
    for note in notes:
        lines += [lead.rstrip()]
        lines += [lead + line for line in textwrap.wrap(note, width - len(lead))]
    return lines
