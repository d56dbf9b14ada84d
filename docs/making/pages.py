"""All pages that are made rather than written, and how they are put on disk.

The parts of other pages (their names begin with `_`) are in the tree, so that a page
read as text has its tables; `python docs/making/pages.py` makes them anew.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import commands
import figures
import house
import messages
import reference
import thesis

MADE = "made"
"""Folder of made pages beside those that are written; git ignores what is no part of
another page."""


def setup(app: Any) -> dict[str, Any]:
    """Of the extension: the pages are made before Sphinx looks for any."""
    make(Path(app.confdir))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def make(docs: Path) -> None:
    """Write all made pages under the folder of the documentation."""
    put(docs / "figures" / MADE, figures.made())
    put(
        docs / "reference" / MADE,
        {**reference.made(), **messages.made(), **commands.made()},
    )
    put(docs / "thesis" / MADE, thesis.made())
    write(docs / "project" / "house.svg", house.drawing())


def put(folder: Path, texts: Mapping[str, str]) -> None:
    """The files of a made folder: unchanged ones keep their time, others go."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in folder.iterdir():
        if path.name not in texts:
            path.unlink()
    for name, text in texts.items():
        write(folder / name, text)


def write(path: Path, text: str) -> None:
    """Write a file unless it says so already."""
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    make(Path(__file__).parents[1])
