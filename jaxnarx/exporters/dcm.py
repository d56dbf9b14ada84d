"""DCM 2.0: tables of parameters and maps at rest, as calibration tools read them.

Of a model that a control unit holds in an earlier state there are only the tables that
have changed. Every table is a FESTWERTEBLOCK of the name that its C array has, every
map a KENNFELD, or with one input a KENNLINIE. Numbers have the digits that read back
exactly in double precision, 17 at most; tools that hold single precision keep nine of
them. Texts are of ISO 8859-1.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxnarx.exporters.calibration import CalibrationBlock, read_dcm
from jaxnarx.exporters.code import digits
from jaxnarx.exporters.form import ParameterTable, Port, SampleProgram
from jaxnarx.exporters.maps import REST_NAME, RestMap, rest_maps
from jaxnarx.exporters.names import identifiers
from jaxnarx.exporters.proof import ExportError
from jaxnarx.exporters.target import Files, Golden, Proof


def dcm_files(program: SampleProgram, golden: Golden) -> Files:
    """The file; `golden["axes"]` has the inputs that maps go over."""
    maps = () if program.changed is not None else rest_maps(program, golden["axes"])
    text = "\n".join(_lines(program, maps)) + "\n"
    return {f"{program.name}.dcm": text.encode("iso-8859-1")}


def sanitise(text: str) -> str:
    """A text of ISO 8859-1 that stays inside of its quotation marks, and in its line
    and comment."""
    text = " ".join(text.replace('"', "'").replace("*/", "* /").split())
    return text.encode("iso-8859-1", "replace").decode("iso-8859-1")


def _lines(program: SampleProgram, maps: Iterable[RestMap]) -> Iterable[str]:
    name, names = program.name, map_names(program)
    yield f"* {name}: {_describe_ports(program)}"
    if program.changed is None:
        yield f"* Blocks {name}_{REST_NAME}_... are what the model does at rest. They"
        yield "* are for reading: who changes the other blocks changes the model."
    else:
        yield "* Only the tables that differ from those of the model before."
    yield ""
    yield "KONSERVIERUNG_FORMAT 2.0"
    yield ""
    yield "FUNKTIONEN"
    yield f'  FKT {name} "" "{_describe_ports(program)}"'
    yield "END"
    for table in written_tables(program):
        yield ""
        yield from _table(name, table)
    if program.changed is not None:
        return
    found = {one.output: one for one in maps}
    for port in program.reported:
        yield ""
        no_map = f"* no map of {sanitise(port.name)}:"
        if port not in found:
            yield f"{no_map} none of the inputs has been moved"
        elif np.all(np.isfinite(found[port].values)):
            yield from _map(names[port], name, found[port])
        else:
            yield f"{no_map} it does not come to rest everywhere"


def written_tables(program: SampleProgram) -> list[ParameterTable]:
    """The tables that the file holds."""
    some = program.changed
    return [
        table
        for table in program.tables
        if table.values.size and (some is None or table.name in some)
    ]


def map_names(program: SampleProgram) -> dict[Port, str]:
    """The names of an output's map and its axes."""
    words = identifiers(port.name for port in program.computed)
    return {
        port: f"{program.name}_{REST_NAME}_{word}"
        for port, word in zip(program.reported, words, strict=False)
    }


def _describe_ports(program: SampleProgram) -> str:
    outputs, inputs = (
        ", ".join(port.name for port in ports)
        for ports in (program.reported, program.inputs)
    )
    return sanitise(
        f"{outputs} from {inputs}, a sample every {program.sample_time:g} s"
    )


def _table(name: str, table: ParameterTable) -> Iterable[str]:
    values = np.atleast_2d(table.values)
    rows, columns = values.shape
    size = f"{columns} @ {rows}" if table.values.ndim > 1 else str(columns)
    yield f"FESTWERTEBLOCK {name}_{table.name} {size}"
    yield f'  LANGNAME "{sanitise(table.about)}"'
    yield f"  FUNKTION {name}"
    yield f'  EINHEIT_W "{sanitise(table.unit)}"'
    for k, column in enumerate(table.columns, start=1):
        yield f"  * column {k}: {sanitise(column)}"
    for row in values:
        yield f"  WERT {' '.join(map(digits, row))}"
    yield "END"


def _map(block: str, function: str, found: RestMap) -> Iterable[str]:
    over = " and ".join(port.name for port in found.axes)
    about = f"{found.output.name} at rest over {over}"
    pairs = zip(found.points, found.axes, strict=True)
    axes = [(points, port.unit) for points, port in pairs]
    yield from map_lines(block, function, about, axes, found.output.unit, found.values)


def map_lines(
    block: str,
    function: str,
    about: str,
    axes: Sequence[tuple[Float[np.ndarray, " _"], str]],
    unit: str,
    values: Float[np.ndarray, "*shape"],
) -> Iterable[str]:
    """A scalar, curve or map: its points and their units by axis, and its values, first
    axis first."""
    kind = ("FESTWERT", "KENNLINIE", "KENNFELD")[len(axes)]
    yield " ".join([kind, block, *(str(len(points)) for points, _ in axes)])
    yield f'  LANGNAME "{sanitise(about)}"'
    yield f"  FUNKTION {function}"
    for letter, (_, own) in zip("XY", axes, strict=False):
        yield f'  EINHEIT_{letter} "{sanitise(own)}"'
    yield f'  EINHEIT_W "{sanitise(unit)}"'
    if not axes:
        yield f"  WERT {digits(float(values))}"
        yield "END"
        return
    (first, _), *second = axes
    yield f"  ST/X {' '.join(map(digits, first))}"
    columns = np.asarray(values).reshape(len(first), -1).T
    for k, column in enumerate(columns):
        if second:
            yield f"  ST/Y {digits(second[0][0][k])}"
        yield f"  WERT {' '.join(map(digits, column))}"
    yield "END"


def prove_dcm(program: SampleProgram, folder: Path, cases: object) -> Proof:
    """The file read back: all tables to the last digit; and which maps there are."""
    del cases
    text = (folder / f"{program.name}.dcm").read_bytes().decode("iso-8859-1")
    blocks = {block.name: block for block in read_dcm(text, "the export as DCM")}
    for table in written_tables(program):
        if not _equal(blocks, program.name, table):
            raise ExportError(f"the export as DCM does not hold {table.name}")
    if program.changed is not None:
        return {"dcm, changed parameters read back": 0.0}, []
    missing = [
        f"dcm: there is no map of {port.name}; the file says why"
        for port, name in map_names(program).items()
        if name not in blocks
    ]
    return {"dcm, parameters read back": 0.0}, missing


def _equal(
    blocks: dict[str, CalibrationBlock], name: str, table: ParameterTable
) -> bool:
    block = blocks.get(f"{name}_{table.name}")
    return block is not None and np.array_equal(block.values, table.values.ravel())
