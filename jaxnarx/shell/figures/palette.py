"""Colours and texts of every figure, without what draws them."""

from collections.abc import Sequence

from jaxnarx.evaluation import Colour

INK_COLOUR = "#24292f"
GRID_COLOUR = "#d5dae0"
GREY = "#7a828c"
BLUE, ORANGE, GREEN, RED = "#0072b2", "#e69f00", "#009e73", "#d55e00"
PURPLE, SKY = "#cc79a7", "#56b4e9"
COLOUR_CYCLE = (BLUE, ORANGE, GREEN, PURPLE, RED, SKY)
"""Okabe and Ito's palette: told apart with any common colour blindness."""
NAMED_COLOURS = {
    "ink": INK_COLOUR,
    "grey": GREY,
    "blue": BLUE,
    "orange": ORANGE,
    "green": GREEN,
    "red": RED,
    "purple": PURPLE,
    "sky": SKY,
}

_CYCLE_SHADES = (
    ("#000000", 0.0),
    ("#000000", 0.45),
    ("#ffffff", 0.5),
    ("#000000", 0.7),
)
"""The palette is mixed with so much of these each time it is used up."""

DARKENING = ("#eaf3f9", "#a3cce4", "#4b9fcd", "#0a6aa5", "#06324f")
DIVERGING = ("#0b4f85", "#6fb1da", "#f4f4f4", "#efa36b", "#a63c00")
"""Colours at even steps of a scale: of values, and of values with a sign."""


def tone(number: int) -> str:
    """The colour of a local model, counted from 0, the same in every figure.

    Behind the palette come its darker and lighter shades: 24 colours, then again.
    """
    other, share = _CYCLE_SHADES[number // len(COLOUR_CYCLE) % len(_CYCLE_SHADES)]
    return mix(COLOUR_CYCLE[number % len(COLOUR_CYCLE)], other, share)


def colour_code(colour: Colour) -> str:
    """The `#rrggbb` of a colour of a chart."""
    return tone(colour) if isinstance(colour, int) else NAMED_COLOURS[colour]


def channels(code: str) -> tuple[int, int, int]:
    """Red, green and blue of a `#rrggbb`."""
    return int(code[1:3], 16), int(code[3:5], 16), int(code[5:7], 16)


def mix(one: str, other: str, share: float) -> str:
    """A colour between two: `share` of the other."""
    pairs = zip(channels(one), channels(other), strict=True)
    return "#" + "".join(f"{round((1 - share) * a + share * b):02x}" for a, b in pairs)


def on_scale(colours: Sequence[str], share: float) -> str:
    """The colour at a share of the way along a scale."""
    at = min(max(share, 0.0), 1.0) * (len(colours) - 1)
    first = min(int(at), len(colours) - 2)
    return mix(colours[first], colours[first + 1], at - first)


def shorten(text: object, width: int = 48) -> str:
    """`text` on one line, without control characters, cut at `width` letters."""
    line = "".join(c if c.isprintable() else " " for c in str(text))
    return line if len(line) <= width else line[: width - 1] + "…"
