"""FMI-LS-XCP 1.0: a calibration tool reads and writes the memory of an FMU.

An importer's own XCP service takes addresses from an A2L file in the archive, those of
the model's parameters, inputs and outputs. They are relative to the base of the binary;
for sources, symbols stand in their place. Modelica Association Project FMI, FMI Layered
Standard for XCP, 1.0.0: the manifest, the structure of the archive, external services.
"""

import struct
from collections.abc import Mapping
from pathlib import PurePosixPath
from xml.etree import ElementTree as ET

from jaxnarx.exporters.a2l import a2l_text
from jaxnarx.exporters.c99 import parameter_line
from jaxnarx.exporters.fmu.markup import layered_manifest, xml_text
from jaxnarx.exporters.form import SampleProgram

NAME, VERSION = "org.fmi-standard.fmi-ls-xcp", "1.0.0"
FOLDER = f"extra/{NAME}"
ABOUT = (
    "Layered standard based on FMI 2.0 and FMI 3.0 for describing and implementing XCP "
    "support for FMUs, which can either provide an XCP service or allow direct memory "
    "access via A2L files."
)
"""The description that the standard demands."""
USE = """How to calibrate this FMU by XCP

The importer's XCP service reads and writes the memory of the binary. Addresses in
{folder}/{target} are relative to its base.
{sources}
Parameters may be written between steps; nothing is checked then: certificates, ranges
and proofs are those of the model that was exported. A sample whose outputs were asked
for before it was taken keeps its parameters. Measured values are those of the last
sample that was taken. All instances share them, so that an FMU that is calibrated must
be instantiated once.
"""
SOURCES = """
The A2L file beside the manifest has symbols in place of addresses, for binaries that
are built from the sources, without optimisation at link time.
"""
LEARNING = """
Coefficients that are learnt belong to an instance and are not among the parameters:
what is written to their tables is what learning begins from.
"""
ELF = b"\x7fELF\x02\x01"  # 64 bits, little end first
SYMBOLS = 2


def writable(header: str, program: SampleProgram, *, learns: bool) -> str:
    """The header of the C files, with parameters that may be written at any time; of a
    model that learns with tables that learning begins from."""
    line = parameter_line(program)
    assert line in header, "tables of another header would stay constant"
    kind = "" if learns else "volatile"
    return header.replace(line, parameter_line(program, kind).rstrip())


def xcp_files(
    program: SampleProgram, binaries: Mapping[str, bytes], *, learns: bool = False
) -> dict[str, str | bytes]:
    """Manifest and A2L files by their place in the archive; nothing where there is a
    binary of which no addresses are known, as the standard wants them."""
    file = f"{program.name}.a2l"
    found: dict[str, str | bytes] = {
        f"{FOLDER}/fmi-ls-manifest.xml": _manifest(file),
        f"{FOLDER}/{file}": a2l_text(program),
    }
    target = "TARGET"
    for place, content in binaries.items():
        symbols = symbols_of(content)
        if not symbols:
            return {}
        target = PurePosixPath(place).parent.name
        found[f"{FOLDER}/{target}/{file}"] = a2l_text(program, symbols)
    more = SOURCES + (LEARNING if learns else "")
    about = USE.format(folder=FOLDER, target=f"{target}/{file}", sources=more)
    return found | {"documentation/fmi-ls-xcp.txt": about}


def _manifest(file: str) -> str:
    root = layered_manifest(NAME, VERSION, ABOUT)
    ET.SubElement(
        root,
        "Interface",
        definition=file,
        description="Parameters, inputs and outputs of the model",
        supportsDirectMemoryAccess="true",
    )
    return xml_text(root)


def symbols_of(library: bytes) -> dict[str, int]:
    """Addresses of a library's symbols, relative to its base; none where the file is
    not ELF of 64 bits (Tool Interface Standard, ELF 1.2, 1995)."""
    if not library.startswith(ELF):
        return {}
    (start,) = struct.unpack_from("<Q", library, 0x28)
    size, count = struct.unpack_from("<HH", library, 0x3A)
    form = "<IIQQQQIIQQ"
    sections = [
        struct.unpack_from(form, library, start + n * size) for n in range(count)
    ]
    found = {}
    for _, kind, _, _, place, length, link, _, _, each in sections:
        if kind != SYMBOLS:
            continue
        names = sections[link][4]
        for at in range(place, place + length, each):
            name, _, _, where, address, _ = struct.unpack_from("<IBBHQQ", library, at)
            end = library.index(b"\0", names + name)
            if where:
                found[library[names + name : end].decode("ascii", "replace")] = address
    return found
