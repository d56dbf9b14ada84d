"""All pages that are made rather than written, and how they are put on disk."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import commands
import messages
import reference

MADE = "made"
"""Folder of made pages, in `reference/` and `figures/`; git ignores it."""


def setup(app: Any) -> dict[str, Any]:
    """Of the extension: the pages are made before Sphinx looks for any."""
    make(Path(app.confdir))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def make(docs: Path) -> None:
    """Write all made pages under the folder of the documentation."""
    put(
        docs / "reference" / MADE,
        {**reference.made(), **messages.made(), **commands.made()},
    )


def put(folder: Path, texts: Mapping[str, str | bytes]) -> None:
    """The files of a made folder: unchanged ones keep their time, others go."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in folder.iterdir():
        if path.name not in texts:
            path.unlink()
    for name, text in texts.items():
        data = text.encode() if isinstance(text, str) else text
        path = folder / name
        if not path.exists() or path.read_bytes() != data:
            path.write_bytes(data)


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table; bars inside of cells are escaped."""
    lines = [list(head)]
    lines += [["---"] * len(lines[0]), *map(list, rows)]
    return "".join(
        "| " + " | ".join(c.replace("|", r"\|") for c in line) + " |\n"
        for line in lines
    )
