"""The text of a value for `print` and notebooks, by its `__str__`.

A class says what it is in `__str__`; `_repr_html_ = page` shows the same text in a
notebook, and `__repr__ = brief` keeps arrays out of a traceback or a list.
"""

import html
from collections.abc import Iterable, Sequence
from typing import Any


def page(self: Any) -> str:
    """Its text as a notebook shows it: one block, nothing in it is markup."""
    return f"<pre>{html.escape(str(self))}</pre>"


def brief(self: Any) -> str:
    """The first line of its text in angle brackets, `<Dataset: 3 records, ...>`."""
    kind, lines = type(self).__name__, str(self).splitlines()
    text = (lines or [""])[0].removeprefix(kind).lstrip(" :")
    return f"<{kind}: {text}>"


def align_columns(
    lines: Iterable[Sequence[str]], left: Sequence[bool] | None = None
) -> list[str]:
    """Cells in columns; text left (by default the first column), figures right."""
    lines = list(lines)
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    sides = [n == 0 for n in range(len(widths))] if left is None else left
    return [
        "  ".join(
            cell.ljust(w) if at_left else cell.rjust(w)
            for cell, w, at_left in zip(line, widths, sides, strict=True)
        ).rstrip()
        for line in lines
    ]


def count(number: int, noun: str) -> str:
    """`"1 record"`, `"2 records"`."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def ratio_text(value: float) -> str:
    """Three digits; `1.00` for 1, which would look like a number of something."""
    text = f"{value:.3g}"
    return f"{value:#.3g}" if text in map(str, range(1, 100)) else text


def span_text(start: float, end: float) -> tuple[str, str]:
    """Both ends of a span, with so many digits that its width is right to a tenth."""
    for digits in range(4, 16):
        ends = f"{start:.{digits}g}", f"{end:.{digits}g}"
        width = float(ends[1]) - float(ends[0])
        if abs(width - (end - start)) <= 0.1 * abs(end - start):
            return ends
    return f"{start:.16g}", f"{end:.16g}"


def list_names(names: Sequence[str], most: int = 6) -> str:
    """`"a, b and 3 more"`."""
    shown = ", ".join(map(str, names[:most]))
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"


def some(lines: Sequence[str], most: int = 12) -> list[str]:
    """The first `most` lines, and how many more there are."""
    if len(lines) <= most + 1:
        return list(lines)
    return [*lines[:most], f"  and {len(lines) - most} more"]
