"""Whether built pages load anything from outside; they must read without a network.

    python docs/making/outside.py docs/_build

Links that a reader may follow are no matter; what a browser fetches by itself is:
scripts, style sheets, pictures, frames, fonts, imports.
"""

import re
import sys
from html.parser import HTMLParser
from pathlib import Path

FETCHED = {
    "audio": "src",
    "embed": "src",
    "iframe": "src",
    "image": "href",
    "img": "src",
    "input": "src",
    "link": "href",
    "object": "data",
    "script": "src",
    "source": "src",
    "track": "src",
    "use": "href",
    "video": "src",
}
HARMLESS = {"canonical", "license", "author", "next", "prev", "search", "index"}
"""Relations of `<link>` that nothing is fetched for."""
AWAY = re.compile(r"(?:https?:)?//", re.I)
IN_STYLE = re.compile(
    r"url\(\s*['\"]?((?:https?:)?//[^)'\"]+)|@import\s+['\"]((?:https?:)?//[^'\"]+)",
    re.I,
)


class _Page(HTMLParser):
    """Addresses outside that a page fetches."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self.styled = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        told = {name.split(":")[-1]: value or "" for name, value in attrs}
        self.styled = tag == "style"
        self.found += in_style(told.get("style", ""))
        for part in told.get("srcset", "").split(","):
            self.found += [part.strip()] if AWAY.match(part.strip()) else []
        address = told.get(FETCHED.get(tag, ""), "")
        fetched = tag != "link" or not set(told.get("rel", "").split()) <= HARMLESS
        if AWAY.match(address) and fetched:
            self.found.append(address)

    def handle_data(self, data: str) -> None:
        self.found += in_style(data) if self.styled else []
        self.styled = False


def in_style(text: str) -> list[str]:
    """Addresses outside in the text of a style sheet."""
    return [a or b for a, b in IN_STYLE.findall(text)]


def in_page(text: str) -> list[str]:
    """Addresses outside that the text of a page makes a browser fetch."""
    page = _Page()
    page.feed(text)
    page.close()
    return page.found


def in_folder(folder: Path) -> dict[str, list[str]]:
    """What pages and style sheets of a built documentation fetch, by file."""
    readers = {".html": in_page, ".css": in_style}
    found = {
        path.relative_to(folder).as_posix(): readers[path.suffix](
            path.read_text(encoding="utf-8")
        )
        for path in sorted(folder.rglob("*"))
        if path.suffix in readers
    }
    if not found:
        raise SystemExit(f"{folder}: no pages are built here")
    return {name: addresses for name, addresses in found.items() if addresses}


def main() -> None:
    """Say what was found; exit code 1 where there is something."""
    found = in_folder(Path(sys.argv[1]))
    for name, addresses in found.items():
        print(f"{name} fetches {', '.join(addresses)}")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
