"""One offline HTML file without scripts, from a heading and its parts."""

from collections.abc import Sequence
from pathlib import Path

from markupsafe import Markup, escape

STYLE = Path(__file__).parent / "report" / "templates" / "style.css"
POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"


def plain_page(heading: str, parts: Sequence[Markup]) -> str:
    """The page as text."""
    body = Markup("\n").join([Markup("<h1>{}</h1>").format(heading), *parts])
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{escape(heading)}</title>\n<style>\n{STYLE.read_text()}</style>\n"
        f"</head>\n<body>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )


def figure(text: str) -> Markup:
    """A figure of SVG."""
    return Markup("<figure>{}</figure>").format(Markup(text))


def heading(text: str) -> Markup:
    """The heading of a part."""
    return Markup("<h2>{}</h2>").format(text)


def paragraph(text: str) -> Markup:
    """A paragraph."""
    return Markup("<p>{}</p>").format(text)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Markup:
    """A table of texts."""

    def cells(kind: str, texts: Sequence[str]) -> Markup:
        cell = Markup(f"<{kind}>{{}}</{kind}>")
        return Markup("<tr>{}</tr>").format(
            Markup("").join(cell.format(text) for text in texts)
        )

    body = Markup("").join(cells("td", row) for row in rows)
    whole = Markup("<table><thead>{}</thead><tbody>{}</tbody></table>")
    return whole.format(cells("th", head), body)
