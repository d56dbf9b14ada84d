"""A2L 1.71: what the arrays and outputs of the C files are, for calibration tools.

Addresses are those of a binary, or zero until a tool finds them by the names of the
symbols in the program that was built. Parameters are those of the C source. Measured
values must exist in memory: the program keeps the last inputs in `NAME_real
NAME_in[...]` and the last outputs in `NAME_out NAME_now`.
"""

import math
import re
import shutil
import subprocess
import sysconfig
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from jaxnarx.exporters.code import digits
from jaxnarx.exporters.dcm import sanitise
from jaxnarx.exporters.form import ONLY_DOUBLE, ParameterTable, Port, SampleProgram
from jaxnarx.exporters.names import identifiers
from jaxnarx.exporters.proof import ExportError
from jaxnarx.exporters.target import Files, Golden, Proof

LARGEST_SINGLE = 3.4e38
"""Range where none is known: all of single precision."""


def a2l_files(program: SampleProgram, golden: Golden) -> Files:
    """The file, of ISO 8859-1."""
    del golden
    return {f"{program.name}.a2l": a2l_text(program)}


def a2l_text(program: SampleProgram, symbols: Mapping[str, int] | None = None) -> bytes:
    """The file's content, with the addresses of a binary's `symbols` if there are."""
    return ("\n".join(_lines(program, symbols)) + "\n").encode("iso-8859-1")


def _lines(program: SampleProgram, symbols: Mapping[str, int] | None) -> Iterable[str]:
    name = program.name
    about = quote(
        f"{', '.join(p.name for p in program.reported)} by jaxnarx, a sample every "
        f"{program.sample_time:g} s"
    )
    tables = [t for t in program.tables if t.values.size]
    inputs = len(program.inputs)
    single = f"single precision ({name.upper()}_SINGLE)"
    kind = "double precision" if program.precision == ONLY_DOUBLE else single
    yield f"/* For {name}.c in {kind}, in a program"
    yield f"   that holds {name}_real {name}_in[{inputs}] and {name}_out {name}_now."
    if symbols is None:
        yield f"   Addresses: a2ltool {name}.a2l --elffile PROGRAM --update ADDRESSES"
        yield f"   --output {name}_linked.a2l."
        yield f"   Changes count at once if {name.upper()}_PARAMETER is volatile. */"
    else:
        yield "   Addresses are relative to the base of the binary. */"
    yield "ASAP2_VERSION 1 71"
    yield f"/begin PROJECT {name} {about}"
    yield f"/begin MODULE {name} {about}"
    yield '/begin MOD_COMMON ""'
    yield "  BYTE_ORDER MSB_LAST"
    yield "/end MOD_COMMON"
    yield f"/begin RECORD_LAYOUT {name}_numbers"
    yield f"  FNC_VALUES 1 {_type(program)} ROW_DIR DIRECT"
    yield "/end RECORD_LAYOUT"
    measured = list(_measurements(program))
    for unit in dict.fromkeys(port.unit for _, port, _ in measured):
        yield f'/begin COMPU_METHOD {_method(program, unit)} "" IDENTICAL "%12.6"'
        yield f"  {quote(unit)}"
        yield "/end COMPU_METHOD"
    for table in tables:
        at = 0 if symbols is None else symbols[f"{name}_{table.name}"]
        yield from _characteristic(name, table, at)
    for one in measured:
        at = 0 if symbols is None else _address(program, one[2], symbols)
        yield from _measurement(program, *one, at)
    yield f"/begin FUNCTION {name} {about}"
    yield from _list_block("DEF_CHARACTERISTIC", [f"{name}_{t.name}" for t in tables])
    count = len(program.inputs)
    words = [word for word, *_ in measured]
    yield from _list_block("IN_MEASUREMENT", words[:count])
    yield from _list_block("OUT_MEASUREMENT", words[count:])
    yield "/end FUNCTION"
    yield "/end MODULE"
    yield "/end PROJECT"


def addresses_in(text: str) -> dict[str, int]:
    """Addresses by what stands in a file of ours."""
    place = r"(?:VAL_BLK|ECU_ADDRESS) 0x([0-9a-f]+)$"
    what = rf'/begin (?:CHARACTERISTIC|MEASUREMENT) (\w+) ".*?{place}'
    found = re.findall(what, text, re.DOTALL | re.MULTILINE)
    return {name: int(at, 16) for name, at in found}


def quote(text: str) -> str:
    """A text in quotation marks that it cannot leave."""
    return '"' + sanitise(text).replace("\\", "/").replace("/*", "/ *") + '"'


def _type(program: SampleProgram) -> str:
    return "FLOAT64_IEEE" if program.precision == ONLY_DOUBLE else "FLOAT32_IEEE"


def _measurements(program: SampleProgram) -> Iterable[tuple[str, Port, str]]:
    """Inputs, reported outputs and flags: name, port and symbol."""
    name = program.name
    units = program.flag_units
    flags = [Port(flag, units.get(flag, ""), 0.0, 0.0) for flag in program.flags]
    lists = (
        ("in", program.inputs, lambda k, word: f"{name}_in[{k}]"),
        ("out", program.reported, lambda k, word: f"{name}_now.reported[{k}]"),
        ("flag", flags, lambda k, word: f"{name}_now.{word}"),
    )
    for kind, ports, symbol in lists:
        words = identifiers(port.name for port in ports)
        for k, (word, port) in enumerate(zip(words, ports, strict=True)):
            yield f"{name}_{kind}_{word}", port, symbol(k, word)


def _address(program: SampleProgram, symbol: str, symbols: Mapping[str, int]) -> int:
    """The address of what is measured in double precision: `NAME_in[k]`, or a part of
    `NAME_now`, whose numbers come first and last, with whole ones between."""
    numbers, whole = len(program.reported) + len(program.computed), len(program.limited)
    head, _, part = symbol.partition(".")
    if part in program.flags:
        behind = 8 * numbers + 8 * math.ceil(4 * whole / 8)
        return symbols[head] + behind + 8 * list(program.flags).index(part)
    array, place = symbol.removesuffix("]").split("[")
    return symbols[array.removesuffix(".reported")] + 8 * int(place)


def _method(program: SampleProgram, unit: str) -> str:
    units = [port.unit for _, port, _ in _measurements(program)]
    return f"{program.name}_unit_{units.index(unit)}"


def _characteristic(name: str, table: ParameterTable, at: int) -> Iterable[str]:
    symbol = f"{name}_{table.name}"
    size = " ".join(map(str, table.values.shape[::-1]))
    yield f"/begin CHARACTERISTIC {symbol} {quote(table.about)} VAL_BLK {at:#x}"
    yield f"  {name}_numbers 0 NO_COMPU_METHOD {-LARGEST_SINGLE} {LARGEST_SINGLE}"
    yield f"  MATRIX_DIM {size}"
    yield f'  SYMBOL_LINK "{symbol}" 0'
    yield "/end CHARACTERISTIC"


def _measurement(
    program: SampleProgram, word: str, port: Port, symbol: str, at: int
) -> Iterable[str]:
    low, high = -LARGEST_SINGLE, LARGEST_SINGLE
    wide = np.abs([port.low, port.high]).max() < LARGEST_SINGLE / 4
    if port.high > port.low and wide:
        low, high = 2 * port.low - port.high, 2 * port.high - port.low
    yield f"/begin MEASUREMENT {word} {quote(port.name)} {_type(program)}"
    yield f"  {_method(program, port.unit)} 0 0 {digits(low)} {digits(high)}"
    yield f"  ECU_ADDRESS {at:#x}"
    yield f'  SYMBOL_LINK "{symbol}" 0'
    yield "/end MEASUREMENT"


def _list_block(what: str, words: list[str]) -> Iterable[str]:
    if words:
        yield f"/begin {what}"
        yield from (f"  {word}" for word in words)
        yield f"/end {what}"


def a2ltool() -> str | None:
    """The program that reads A2L files, where there is one."""
    return shutil.which("a2ltool", path=sysconfig.get_path("scripts")) or shutil.which(
        "a2ltool"
    )


def complaints(text: str) -> list[str]:
    """The complaints in a2ltool's output about a file: it ends with 0 either way."""
    return re.findall(r"(?im)^.*\b(?:error|warning|problem|invalid)\b.*$", text)


def prove_a2l(program: SampleProgram, folder: Path, cases: object) -> Proof:
    """The file read and checked by a2ltool."""
    del cases
    tool = a2ltool()
    if tool is None:
        return {}, ["a2l: there is no a2ltool here"]
    words = [tool, "--strict", "--check", str(folder / f"{program.name}.a2l")]
    done = subprocess.run(words, capture_output=True, text=True)
    found = complaints(done.stdout + done.stderr)
    if done.returncode or found:
        raise ExportError(f"a2ltool says of the export: {' '.join(found)[:300]}")
    return {"a2l, checked by a2ltool": 0.0}, []
