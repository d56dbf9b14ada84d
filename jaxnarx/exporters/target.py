"""Targets of an export: how their files are written, and how they are proven."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxnarx.exporters.form import SampleProgram
from jaxnarx.exporters.proof import Case

Golden = Mapping[str, np.ndarray]
"""A stretch of a record: `inputs`, `measured` (the history and one sample more) and
`outputs`, what the free run behind it reports, a row for every sample; and `axes`, the
inputs that maps at rest go over (`jaxnarx.exporters.maps.choose_axes`)."""
Files = dict[str, str | bytes]
"""Texts and packed files by name."""
Proof = tuple[dict[str, float], list[str]]
"""Largest difference to the model by what was run, in shares of an output's largest
value, and what could not be run here and why."""


def as_bytes(content: str | bytes) -> bytes:
    """The bytes of a file: texts in UTF-8, and what has no place there as its
    number."""
    text = isinstance(content, str)
    return content.encode("utf-8", "backslashreplace") if text else content


@dataclasses.dataclass(frozen=True)
class Target:
    """A kind of files that a model is exported to.

    `write` makes them from the program and golden vectors; `prove` runs them, written
    to a folder, beside the model and raises `ExportError` where they differ.
    """

    about: str
    write: Callable[[SampleProgram, Golden], Files]
    prove: Callable[[SampleProgram, Path, Sequence[Case]], Proof]
