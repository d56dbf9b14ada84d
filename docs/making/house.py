"""The house with its floors, drawn from the imports of the package."""

import ast
import html

from names import PACKAGE

FLOORS = {
    "4 the shell": ["shell", "contracts"],
    "3 verbs": [
        *("control", "fleet", "calibration", "sweep", "identification"),
        *("linear", "inverse", "design", "evaluation", "exporters"),
        *("partition", "selection", "confidence", "refinement", "simulation"),
    ],
    "2 data and models": ["models", "regressors", "excitation", "data", "engines"],
    "1 arrays": ["arrays", "metrics"],
    "ground": [
        *("solution", "settings", "formatting", "docstrings", "extensions"),
        *(
            "checks",
            "child_process",
            "deprecation",
            "files",
            "argument_checks",
            "errors",
        ),
    ],
}
"""The rooms of every floor, the highest first; a test holds the imports to it."""
WIDE, HIGH, LEFT, ROW = 112, 34, 150, 6


def imports() -> set[tuple[str, str]]:
    """Which room imports which, by their names."""
    found: set[tuple[str, str]] = set()
    for path in PACKAGE.rglob("*.py"):
        here = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            module = node.module if isinstance(node, ast.ImportFrom) else None
            if here != "__init__" and module and module.startswith("jaxnarx."):
                found.add((here, module.split(".")[1]))
    return {(above, below) for above, below in found if above != below}


def drawing() -> str:
    """The house as an SVG: rooms on their floors, imports as lines pointing down."""
    places, parts, y = {}, [], 20
    for floor, rooms in FLOORS.items():
        begin = y
        for n, room in enumerate(rooms):
            row, column = divmod(n, ROW)
            places[room] = (
                LEFT + column * (WIDE + 14),
                begin + 12 + row * (HIGH + 22),
            )
        y = begin + 24 + (len(rooms) - 1) // ROW * (HIGH + 22) + HIGH
        parts.append(_floor(floor, begin, y))
        y += 36
    parts += [_line(places, a, b) for a, b in sorted(imports())]
    parts += [_room(room, at) for room, at in places.items()]
    width = LEFT + ROW * (WIDE + 14) + 10
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {y}" '
        f'width="{width}" height="{y}" font-family="sans-serif" font-size="13">\n'
        f'<rect width="{width}" height="{y}" fill="white"/>\n'
        + "\n".join(parts)
        + "\n</svg>\n"
    )


def _floor(name: str, top: int, bottom: int) -> str:
    width = LEFT + ROW * (WIDE + 14) - 10
    return (
        f'<rect x="10" y="{top}" width="{width}" height="{bottom - top}" rx="6" '
        f'fill="#f2f4f7" stroke="#c9d0da"/>'
        f'<text x="22" y="{(top + bottom) // 2 + 4}" fill="#333">'
        f"{html.escape(name)}</text>"
    )


def _room(name: str, at: tuple[int, int]) -> str:
    x, y = at
    return (
        f'<rect x="{x}" y="{y}" width="{WIDE}" height="{HIGH}" rx="4" fill="white" '
        f'stroke="#35557c"/><text x="{x + WIDE // 2}" y="{y + 22}" '
        f'text-anchor="middle">{html.escape(name)}</text>'
    )


def _line(places: dict[str, tuple[int, int]], above: str, below: str) -> str:
    if above not in places or below not in places:
        return ""
    (xa, ya), (xb, yb) = places[above], places[below]
    xa, xb = xa + WIDE // 2, xb + WIDE // 2
    down = yb > ya
    start, end = (ya + HIGH, yb) if down else (ya + HIGH // 2, yb + HIGH // 2)
    return (
        f'<path d="M{xa} {start} C{xa} {start + 30 * down} {xb} {end - 30 * down} '
        f'{xb} {end}" fill="none" stroke="#35557c" stroke-opacity="0.3"/>'
    )
