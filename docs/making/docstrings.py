"""Docstrings as Markdown: they use backticks, indented formulas and sections."""

import re
import textwrap
from collections.abc import Mapping

SECTIONS = ("Args", "Returns", "Raises", "Example", "Yields")
CODE = re.compile(r"(`+[^`]+`+)")
LISTED = re.compile(r"^(\s*)([-+#]|\d+\.) ")


def markdown(text: str, known: Mapping[str, str]) -> str:
    """A docstring, already freed of its indentation, as Markdown.

    `known` maps what may stand in backticks to the path of the public name it means.
    """
    parts = re.split(rf"^({'|'.join(SECTIONS)}):\n", text, flags=re.M)
    told = [prose(parts[0], known)]
    for title, body in zip(parts[1::2], parts[2::2], strict=True):
        # A section ends where the indentation does.
        inside = re.match(r"(?:[ ]{4}.*\n?|\s*\n)*", body)
        own = textwrap.dedent(inside.group() if inside else "").strip("\n")
        rest = body[inside.end() :] if inside else body
        told.append(_section(title, own, known))
        told.append(prose(rest, known))
    return "\n\n".join(part.strip("\n") for part in told if part.strip()) + "\n"


def _section(title: str, body: str, known: Mapping[str, str]) -> str:
    if title == "Example":
        return f"Example:\n\n```python\n{body}\n```"
    if title in ("Args", "Raises"):
        entries = re.split(r"^(?=[*\w]+(?:, [*\w]+)*: )", body, flags=re.M)
        return f"{title}:\n\n" + "\n".join(
            _entry(entry, known) for entry in entries if entry.strip()
        )
    return f"{title}: {prose(body, known)}"


def _entry(entry: str, known: Mapping[str, str]) -> str:
    name, _, text = entry.partition(": ")
    first, *more = text.rstrip().split("\n")
    body = textwrap.dedent("\n".join(more))
    words = f"{first}\n{body}" if more else first
    return f"- `{name}`: " + textwrap.indent(prose(words, known), "  ").strip()


def prose(text: str, known: Mapping[str, str]) -> str:
    """Paragraphs with what Markdown would misread escaped; indented lines stay."""
    lines, before, listing = [], "", False
    for line in text.split("\n"):
        formula = line.startswith("    ") and (
            not before.strip() or before[:4] == "    "
        )
        if not before.strip():
            listing = bool(LISTED.match(line))
        lines.append(line if formula else _line(line, listing or not before.strip()))
        before = line
    joined = "\n".join(lines)
    # Code spans may go over a line's end, so references are made in the whole.
    return "".join(
        _reference(part, known) if n % 2 else part
        for n, part in enumerate(CODE.split(joined))
    )


def _line(line: str, listed: bool) -> str:
    marked = LISTED.match(line)
    if marked and not listed:
        # A sentence or formula that goes on in this line: lists follow an empty one.
        at = marked.end(1)
        line = line[:at] + "\\" + line[at:]
    return "".join(
        part if n % 2 else re.sub(r"([$<\[\]]|(?<!\*)\*(?!\*))", r"\\\1", part)
        for n, part in enumerate(CODE.split(line))
    )


def _reference(span: str, known: Mapping[str, str]) -> str:
    inside = span.strip("`")
    name = inside.removeprefix("jnx.").removeprefix("jaxnarx.").removesuffix("()")
    return f"{{py:obj}}`{inside} <{known[name]}>`" if name in known else span
