"""Readers of what calibration tools write: DCM 2.0, and arrays of C.

They take numbers and nothing else: what is not a number, not finite, not closed or
there twice is a `DataFileError` that names the block and the line.
"""

import dataclasses
import math
import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxnarx.errors import DataFileError, guard_reading

MAX_FILE_BYTES = 64 * 2**20
"""Bytes of a file that are read."""
NUMBER_PATTERN = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


@dataclasses.dataclass(frozen=True, eq=False)
class CalibrationBlock:
    """A block of a file: its kind, name, size as told, numbers, and the lines where it
    begins and where each number stands; `points` of a curve or map, by axis."""

    kind: str
    name: str
    size: tuple[int, ...]
    values: Float[np.ndarray, " numbers"]
    line: int
    lines: tuple[int, ...]
    points: tuple[Float[np.ndarray, " _"], ...] = ()


VALUE_BLOCKS = ("FESTWERT", "FESTWERTEBLOCK")
"""Blocks of nothing but values."""
MAP_BLOCKS = (
    *("KENNLINIE", "FESTKENNLINIE", "GRUPPENKENNLINIE", "KENNFELD", "FESTKENNFELD"),
    *("GRUPPENKENNFELD", "STUETZSTELLENVERTEILUNG"),
)
"""Blocks that have points as well, of curves and maps."""
TEXT_BLOCKS = ("TEXTSTRING",)
OTHER_LINES = (
    *("LANGNAME", "DISPLAYNAME", "FUNKTION", "EINHEIT_X", "EINHEIT_Y", "EINHEIT_W"),
    *("VAR", "ST_TX/X", "ST_TX/Y"),
)
"""Lines of a block that are no values."""
AXIS_LINES = ("ST/X", "ST/Y")
"""Lines of the points of an axis."""


def read_text(path: str | os.PathLike[str]) -> str:
    """The text of a DCM file or C source, of ISO 8859-1, in which every byte is a
    letter; DataFileError where there is none, or too much."""
    with guard_reading(path, "a DCM file or C source"):
        if Path(path).stat().st_size > MAX_FILE_BYTES:
            raise DataFileError(
                f"{path}: larger than {MAX_FILE_BYTES >> 20} MB", path=path
            )
        return Path(path).read_bytes().decode("iso-8859-1")


def read_dcm(text: str, source: str) -> list[CalibrationBlock]:
    """The blocks of a DCM file; `source` is what errors call it."""
    lines = _written_lines(text)
    number, first = next(lines, (1, ""))
    if not re.match(r"KONSERVIERUNG_FORMAT\s+2\.\d+$", first):
        raise _wrong(source, number, "a DCM file begins with KONSERVIERUNG_FORMAT 2.0")
    blocks = []
    for number, line in lines:
        kind, *words = line.split()
        if kind == "FUNKTIONEN":
            _skip(lines, source, number)
        elif kind in (*VALUE_BLOCKS, *MAP_BLOCKS, *TEXT_BLOCKS):
            blocks.append(_block(kind, words, lines, source, number))
        else:
            raise _wrong(source, number, f"{kind[:40]!r} begins no block of DCM 2.0")
    return _single(blocks, source)


def _written_lines(text: str) -> Iterator[tuple[int, str]]:
    """Lines with their numbers, without comments and empty ones."""
    # not splitlines, which ends a line at letters of Windows-1252 as well
    lines = re.split(r"\r\n|\r|\n", text.lstrip("\ufeff"))
    for number, line in enumerate(lines, start=1):
        line = line.strip()
        if line and line[0] not in "*!.":
            yield number, line


def _skip(lines: Iterator[tuple[int, str]], source: str, begun: int) -> None:
    for _, line in lines:
        if line == "END":
            return
    raise _wrong(source, begun, "FUNKTIONEN has no END")


def _block(kind, words, lines, source: str, begun: int) -> CalibrationBlock:
    if not words or not all(re.fullmatch(r"\d{1,9}|@", w) for w in words[1:]):
        raise _wrong(source, begun, f"{kind} has not a name and sizes")
    name, *sizes = words
    size = tuple(int(w) for w in sizes if w != "@")
    values: list[float] = []
    places: list[int] = []
    axes: dict[str, list[float]] = {}
    for number, line in lines:
        field, *rest = line.split()
        if field == "END":
            found = CalibrationBlock(
                *(kind, name, size, np.array(values), begun, tuple(places)),
                points=tuple(np.array(axes[a]) for a in AXIS_LINES if a in axes),
            )
            return _count_values(found, source)
        if field == "WERT":
            values += [parse_number(w, source, number, name) for w in rest]
            places += [number] * len(rest)
        elif field in AXIS_LINES:
            own = [parse_number(w, source, number, name) for w in rest]
            axes.setdefault(field, []).extend(own)
        elif field == "TEXT" and kind in VALUE_BLOCKS:
            raise _wrong(source, number, f"block {name} has a text in place of numbers")
        elif field not in (*OTHER_LINES, "TEXT"):
            raise _wrong(source, number, f"block {name} has a line {field[:40]!r}")
    raise _wrong(source, begun, f"block {name} has no END")


def _count_values(block: CalibrationBlock, source: str) -> CalibrationBlock:
    """A block of values with as many as it says."""
    right = math.prod(block.size)
    if block.kind in VALUE_BLOCKS and len(block.values) != right:
        raise _wrong(
            source,
            block.line,
            f"block {block.name} says {right} values and has {len(block.values)}",
        )
    return block


def map_of(
    block: CalibrationBlock, source: str
) -> tuple[tuple[Float[np.ndarray, " _"], ...], Float[np.ndarray, "*shape"]]:
    """Points by axis, and values, first axis first; DataFileError where the block is no
    scalar, curve or map of numbers."""
    shape = tuple(len(axis) for axis in block.points)
    fits = block.size == shape and len(block.values) == math.prod(shape)
    if block.kind not in ("FESTWERT", *MAP_BLOCKS) or not fits:
        raise _wrong(
            source,
            block.line,
            f"block {block.name} is no scalar, curve or map: it has "
            f"{len(block.values)} values over {' x '.join(map(str, shape)) or 'no'} "
            "points",
        )
    for axis in block.points:
        if np.any(np.diff(axis) <= 0):
            raise _wrong(
                source, block.line, f"points of block {block.name} do not rise"
            )
    return block.points, block.values.reshape(shape[::-1]).T


def _single(blocks: list[CalibrationBlock], source: str) -> list[CalibrationBlock]:
    known: dict[str, int] = {}
    for block in blocks:
        if block.name in known:
            raise _wrong(
                source,
                block.line,
                f"block {block.name} is there twice, first in line {known[block.name]}",
            )
        known[block.name] = block.line
    return blocks


def parse_number(word: str, source: str, line: int, block: str) -> float:
    """A finite number with a decimal point."""
    value = float(word) if NUMBER_PATTERN.fullmatch(word) else math.nan
    if not math.isfinite(value):
        raise _wrong(
            source, line, f"block {block} has {word[:40]!r} in place of a finite number"
        )
    return value


ARRAY_PATTERN = re.compile(
    r"\b(?:const|\w+_PARAMETER)(?:\s+volatile)?\s+\w+\s+(\w+)\s*\[\s*(\d{1,9})\s*\]\s*=\s*\{([^{}]*)\}\s*;"
)
CAST_PATTERN = re.compile(r"\(\s*\w+\s*\)")
COMMENT_PATTERN = re.compile(r'"(?:\\.|[^"\\\n])*"|/\*.*?\*/|//[^\n]*', re.DOTALL)


def read_arrays(text: str, source: str, names: Iterable[str]) -> list[CalibrationBlock]:
    """Constant arrays of numbers in a C source whose names end with one of `names`."""
    bare = COMMENT_PATTERN.sub(
        lambda m: '""' if m[0][0] == '"' else "\n" * m[0].count("\n"), text
    )
    endings, blocks = tuple(names), []
    for found in ARRAY_PATTERN.finditer(bare):
        name, size, body = found[1], int(found[2]), found[3]
        if not name.endswith(endings):
            continue
        line = bare.count("\n", 0, found.start()) + 1
        at = bare.count("\n", 0, found.start(3)) + 1
        values, places = [], []
        entries = body.rstrip().removesuffix(",").split(",")
        for entry in entries:
            at += entry[: len(entry) - len(entry.lstrip())].count("\n")
            word = CAST_PATTERN.sub("", entry).strip()
            word = re.sub(r"(?<=[\d.])[fFlL]$", "", word)
            values.append(parse_number(word, source, at, name))
            places.append(at)
            at += entry.lstrip().count("\n")
        block = CalibrationBlock(
            *("FESTWERTEBLOCK", name, (size,), np.array(values), line, tuple(places))
        )
        blocks.append(_count_values(block, source))
    return _single(blocks, source)


def _wrong(source: str, line: int, what: str) -> DataFileError:
    return DataFileError(f"{source}, line {line}: {what}", path=source)
