"""Names that every language takes."""

import re
from collections.abc import Iterable


def identifier(text: str, taken: set[str] | None = None) -> str:
    """A name that every language takes, different from those that are taken."""
    word = re.sub(r"\W+", "_", text, flags=re.ASCII).strip("_") or "x"
    word = word if word[0].isalpha() else f"x{word}"
    word, n = word[:40], 2
    found = word
    while taken is not None and found.lower() in taken:
        found, n = f"{word}_{n}", n + 1
    if taken is not None:
        taken.add(found.lower())
    return found


def identifiers(texts: Iterable[str]) -> list[str]:
    """One for each, no two alike."""
    taken: set[str] = set()
    return [identifier(text, taken) for text in texts]
