"""Marks in SVG: paths in whole tenths of a point, strokes and fills."""

import base64
import itertools
import math
import struct
import zlib
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from jaxnarx.evaluation import Cells, Colour, Curve, Number, RegionMap
from jaxnarx.shell.figures.palette import (
    DARKENING,
    DIVERGING,
    channels,
    on_scale,
    tone,
)

STEPS = 32
"""Steps of a scale of colours."""
FAR = 3.0
"""Panels beyond its own that a line is followed to."""
VARIABLES = {
    "ink": "currentColor",
    "grey": "var(--soft)",
    **{n: f"var(--{n})" for n in ("blue", "orange", "green", "red", "purple", "sky")},
}
CYCLE = ("blue", "orange", "green", "purple", "red", "sky")
SHAPES = {
    "s": ((-0.45, -0.45), (0.45, -0.45), (0.45, 0.45), (-0.45, 0.45)),
    "D": ((0, -0.6), (0.6, 0), (0, 0.6), (-0.6, 0)),
    "^": ((-0.55, 0.45), (0, -0.55), (0.55, 0.45)),
    "v": ((-0.55, -0.45), (0, 0.55), (0.55, -0.45)),
    "*": tuple(
        (r * math.sin(math.pi * n / 5), -r * math.cos(math.pi * n / 5))
        for n, r in zip(range(10), itertools.cycle((0.7, 0.3)), strict=False)
    ),
}
"""Corners of filled markers, in their size."""
STROKES = {
    "x": ((-0.45, -0.45, 0.45, 0.45), (-0.45, 0.45, 0.45, -0.45)),
    "X": ((-0.45, -0.45, 0.45, 0.45), (-0.45, 0.45, 0.45, -0.45)),
    "P": ((-0.5, 0, 0.5, 0), (0, -0.5, 0, 0.5)),
    "|": ((0, -0.5, 0, 0.5),),
}
"""Lines of drawn markers, in their size."""
DASHES = {"dashed": (3, 1.5), "dotted": (0.8, 1.4)}
"""Points of ink and of gap."""


def tenths(share: Float[np.ndarray, " _"], length: Number) -> Float[np.ndarray, " _"]:
    """Whole tenths of a point; what lies far outside stands a few panels away, and
    what is infinite nowhere (NaN)."""
    known = np.where(np.isfinite(share), share, np.nan)
    return np.round(np.clip(known, -FAR, 1 + FAR) * 10 * length)


def _pieces(*values: Float[np.ndarray, " _"]) -> Iterator[tuple[np.ndarray, ...]]:
    """Stretches of points that are all known."""
    known = np.all(np.isfinite(values), axis=0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], known.astype(int), [0]])))
    for start, stop in edges.reshape(-1, 2):
        yield tuple(v[start:stop].astype(int) for v in values)


def line_path(x: Float[np.ndarray, " _"], y: Float[np.ndarray, " _"]) -> str:
    """A path through the points, each told from the one before."""
    parts = []
    for a, b in _pieces(x, y):
        steps = zip(np.diff(a).tolist(), np.diff(b).tolist(), strict=True)
        moves = [f"{u} {v}" for u, v in steps if u or v]
        parts.append(f"M{a[0]} {b[0]}" + ("l" + " ".join(moves) if moves else "h0"))
    return "".join(parts).replace(" -", "-")


def area_paths(
    x: Float[np.ndarray, " _"],
    low: Float[np.ndarray, " _"],
    high: Float[np.ndarray, " _"],
) -> Iterator[str]:
    """Closed paths of the area between two lines."""
    for a, b, c in _pieces(x, low, high):
        ends = np.concatenate([a, a[::-1]]), np.concatenate([c, b[::-1]])
        yield line_path(*(e.astype(float) for e in ends)) + "z"


def markers(
    x: Float[np.ndarray, " _"], y: Float[np.ndarray, " _"], mark: Curve, colour: Colour
) -> str:
    """All marks of a curve as one path."""
    known = np.isfinite(x) & np.isfinite(y)
    at = zip(*(v[known].astype(int).tolist() for v in (x, y)), strict=True)
    places = list(dict.fromkeys(at))  # marks on one another are one
    size = 10 * mark.size
    if mark.marker in STROKES:
        lines = [
            "M{} {}L{} {}".format(
                *(round(p + size * d) for p, d in zip((a, b, a, b), s, strict=True))
            )
            for a, b in places
            for s in STROKES[mark.marker]
        ]
        look = stroke(colour, 1.1, "solid", mark.opacity)
        return f'<path d="{"".join(lines)}" {look}/>'
    if mark.marker in SHAPES:
        shapes = [
            "M"
            + "L".join(
                f"{round(a + size * u)} {round(b + size * v)}"
                for u, v in SHAPES[mark.marker]
            )
            + "z"
            for a, b in places
        ]
        return f'<path d="{"".join(shapes)}" {fill(colour, mark.opacity)}/>'
    if mark.hollow:
        half = round(size / 2)
        arc = f"a{half} {half} 0 1 0"
        round_trip = f"{arc} {2 * half} 0{arc}-{2 * half} 0"
        rings = "".join(f"M{a - half} {b}{round_trip}" for a, b in places)
        return f'<path d="{rings}" {stroke(colour, 1.3, "solid", mark.opacity)}/>'
    dots = "".join(f"M{a} {b}h0" for a, b in places)
    width = mark.size * (0.6 if mark.marker == "." else 1.0)
    look = stroke(colour, width, "solid", mark.opacity)
    return f'<path d="{dots}" {look} stroke-linecap="round"/>'


def css(colour: Colour) -> str:
    """A colour of the page, which knows light and dark."""
    if isinstance(colour, int):
        return VARIABLES[CYCLE[colour]] if colour < len(CYCLE) else tone(colour)
    return VARIABLES[colour]


def stroke(
    colour: Colour, width: Number, line: str, opacity: Number = 1.0, *, unit: int = 10
) -> str:
    """Attributes of a line of that many points, of which each is `unit` units."""
    text = f'style="stroke:{css(colour)}" stroke-width="{unit * width:g}"'
    if line in DASHES:
        dashes = " ".join(f"{unit * part:g}" for part in DASHES[line])
        text += f' stroke-dasharray="{dashes}"'
    return text + (f' stroke-opacity="{opacity:g}"' if opacity < 1 else "")


def fill(colour: Colour, opacity: Number) -> str:
    """Attributes of an area."""
    return f'style="fill:{css(colour)}" fill-opacity="{opacity:g}"'


def cell_colour(mark: Cells, share: Number) -> str:
    """The colour at a share of the way along the scale of cells."""
    return on_scale(DIVERGING if mark.signed else DARKENING, share)


MAP_POINTS = 81
"""Points along each side of a map of regions."""


def png_of(mark: RegionMap) -> str:
    """The map as a PNG with a palette: a colour for each model, an alpha for each step
    of its lead."""
    rows, columns = (
        np.unique(np.linspace(0, n - 1, MAP_POINTS).round().astype(int))
        for n in mark.lead.shape
    )
    lead = mark.lead[np.ix_(rows, columns)].T[::-1] % 24
    step = np.round(9 * np.clip(mark.strength[np.ix_(rows, columns)].T[::-1], 0, 1))
    code = (10 * lead + step).astype(np.uint8)
    colours = b"".join(bytes(channels(tone(n // 10))) for n in range(240))
    alpha = bytes(round(255 * 0.45 * (n % 10) / 9) for n in range(240))
    high, wide = code.shape
    lines = np.concatenate([np.zeros((high, 1), np.uint8), code], axis=1).tobytes()
    chunks = [
        (b"IHDR", struct.pack(">IIBBBBB", wide, high, 8, 3, 0, 0, 0)),
        (b"PLTE", colours),
        (b"tRNS", alpha),
        (b"IDAT", zlib.compress(lines, 9)),
        (b"IEND", b""),
    ]
    body = b"".join(
        struct.pack(">I", len(data))
        + name
        + data
        + struct.pack(">I", zlib.crc32(name + data))
        for name, data in chunks
    )
    return base64.b64encode(b"\x89PNG\r\n\x1a\n" + body).decode()
