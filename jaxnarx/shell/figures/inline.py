"""Figures as `<svg>` elements of an HTML page, as short as they can be.

matplotlib writes the same style to every mark and an identifier to every group; a page
of eight outputs would be twice as long with them.
"""

import re
from collections import Counter
from collections.abc import Iterator
from xml.etree import ElementTree

from matplotlib.figure import Figure

from jaxnarx.shell.figures.style import BLUE, GRID_COLOUR, INK_COLOUR, svg

Element = ElementTree.Element
_URL_LINK = re.compile(r"url\(#([^)]*)\)")
_LONG_DECIMALS = re.compile(r"(\.\d\d)\d+")
_NUMERIC_ATTRIBUTES = "d", "points", "x", "y", "width", "height", "transform"


def inline_svg(figure: Figure, prefix: str, title: str) -> str:
    """The figure as an `<svg>` element to stand in an HTML page.

    Namespaces and metadata are gone, so that the page names no address; identifiers and
    classes carry `prefix`, so that figures do not meet; ink takes the text colour of
    the page, grid and blue its `--grid` and `--blue`, so that it reads on light and
    dark; `title` is for readers that cannot see it. Coordinates keep two decimals.
    """
    prefix = re.sub(r"[^\w-]", "_", prefix)
    root = ElementTree.fromstring(svg(figure))
    _strip_metadata(root)
    _name_links(root, prefix)
    for element in root.iter():
        for name, value in element.attrib.items():
            if name in _NUMERIC_ATTRIBUTES:
                element.set(name, _shorten_value(name, value))
    _share_styles(root, prefix)
    _unwrap_groups(root)
    for name in ("width", "height", "version"):
        root.attrib.pop(name, None)
    root.attrib |= {"role": "img", "aria-label": title}
    return ElementTree.tostring(root, encoding="unicode")


def _strip_metadata(root: Element) -> None:
    """Without metadata, namespaces and white space between elements."""
    for element in list(root.iter()):
        for child in list(element):
            if child.tag.endswith("}metadata"):
                element.remove(child)
            elif not (child.tail or "").strip():
                child.tail = None
        if len(element) and not (element.text or "").strip():
            element.text = None
        element.tag = element.tag.split("}")[-1]
        kept = {k.split("}")[-1]: v for k, v in element.attrib.items()}
        element.attrib.clear()
        element.attrib.update(kept)


def _name_links(root: Element, prefix: str) -> None:
    """Short names for what is linked to; other identifiers go."""
    names: dict[str, str] = {}

    def rename(old: str) -> str:
        return names.setdefault(old, f"{prefix}{len(names)}")

    for element in root.iter():
        for name, value in element.attrib.items():
            if name == "href" and value.startswith("#"):
                element.set(name, f"#{rename(value[1:])}")
            elif "url(#" in value:
                element.set(
                    name, _URL_LINK.sub(lambda m: f"url(#{rename(m[1])})", value)
                )
    for element in root.iter():
        old = element.attrib.pop("id", None)
        if old in names:
            element.set("id", names[old])


def _share_styles(root: Element, prefix: str) -> None:
    """Styles that stand several times, clips among them, become classes."""
    for element in root.iter():
        parts = [element.attrib.pop("style", "")]
        if "clip-path" in element.attrib:
            parts.append(f"clip-path: {element.attrib.pop('clip-path')}")
        if style := "; ".join(filter(None, parts)):
            style = style.replace(INK_COLOUR, "currentColor").replace(
                GRID_COLOUR, "var(--grid)"
            )
            element.set("style", style.replace(BLUE, "var(--blue)"))
    counts = Counter(e.get("style") for e in root.iter() if e.get("style"))
    shared = [style for style, number in counts.items() if number > 1]
    classes = {style: f"{prefix}s{n}" for n, style in enumerate(shared)}
    for element in root.iter():
        if (style := element.get("style")) in classes:
            del element.attrib["style"]
            element.set("class", classes[style])
    if classes:
        sheet = ElementTree.Element("style")
        sheet.text = "".join(f".{name}{{{style}}}" for style, name in classes.items())
        root.insert(0, sheet)


def _unwrap_groups(element: Element) -> None:
    """Groups without attributes give way to what they hold."""
    element[:] = list(_iterate_without_groups(element))


def _iterate_without_groups(element: Element) -> Iterator[Element]:
    for child in element:
        _unwrap_groups(child)
        if child.tag == "g" and not child.attrib and not (child.tail or "").strip():
            yield from child
        else:
            yield child


def _shorten_value(name: str, value: str) -> str:
    """Two decimals; of a path no space that it can do without."""
    value = _LONG_DECIMALS.sub(r"\1", value)
    if name != "d":
        return value.replace("\n", " ")
    value = re.sub(r"\s*([A-Za-z])\s*", r"\1", " ".join(value.split()))
    # Behind a move, pairs of numbers are lines.
    return value if re.search("[^MLz0-9. e-]|zL", value) else value.replace("L", " ")
