"""The archive: description, sources, documentation, and a binary where one is made."""

import dataclasses
import functools
import hashlib
import io
import platform
import subprocess
import uuid
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from jaxnarx.exporters import c99
from jaxnarx.exporters.compilers import WARNING_FLAGS, compilers
from jaxnarx.exporters.fmu import description
from jaxnarx.exporters.fmu.documentation import page
from jaxnarx.exporters.fmu.glue import read_template, wrapper
from jaxnarx.exporters.fmu.structure import structure_files, structure_maps
from jaxnarx.exporters.fmu.variables import quantities
from jaxnarx.exporters.fmu.xcp import writable, xcp_files
from jaxnarx.exporters.form import BOTH, ONLY_DOUBLE, ONLY_SINGLE, SampleProgram
from jaxnarx.exporters.maps import RestMap, rest_maps
from jaxnarx.exporters.proof import ExportError
from jaxnarx.exporters.target import Files, Golden, as_bytes
from jaxnarx.files import TemporaryFolder

LICENCE_NOTE = """The functions of FMI in sources/ are part of jaxnarx, Apache-2.0,
https://www.apache.org/licenses/LICENSE-2.0
The model belongs to whoever has identified it.
"""
MACHINE_NAMES = {"amd64": "x86_64", "x86_64": "x86_64", "arm64": "aarch64"}
SYSTEM_NAMES = {"Linux": ("linux", ".so"), "Darwin": ("darwin", ".dylib")}


def fmu(version: int) -> Callable[[SampleProgram, Golden], Files]:
    """The writer of an FMU of this version of FMI."""
    return functools.partial(_pack_files, version=version)


def _pack_files(program: SampleProgram, golden: Golden, *, version: int) -> Files:
    if program.precision == ONLY_SINGLE:  # the binary is of double
        program = dataclasses.replace(program, precision=BOTH)
    maps = rest_maps(program, golden["axes"]) if version == 3 else ()
    code = c99.sources(program, golden)
    return _pack(program, contents(program, code, version, maps=maps), version)


def learning_fmu(program: SampleProgram, code: Files, version: int) -> Files:
    """An FMU whose coefficients follow the engine; `code` is that of the model and what
    learns (`jaxnarx.exporters.c_adapt`)."""
    parts = contents(program, code, version, learns=True)
    return _pack(program, parts, version, learns=True)


def _pack(
    program: SampleProgram,
    parts: dict[str, str],
    version: int,
    *,
    learns: bool = False,
) -> Files:
    made = binary(program, parts, version)
    double = dataclasses.replace(program, precision=ONLY_DOUBLE)
    memory = xcp_files(double, made, learns=learns)
    return {archive_name(program, version): archive(parts | made | memory)}


def archive_name(program: SampleProgram, version: int) -> str:
    """The name of the file."""
    return f"{program.name}_fmi{version}.fmu"


def contents(
    program: SampleProgram,
    code: Files,
    version: int,
    *,
    learns: bool = False,
    maps: Sequence[RestMap] = (),
) -> dict[str, str]:
    """Everything but a binary, by its place in the archive."""
    name = program.name
    variables = quantities(program, version, learns=learns)
    structured = structure_maps(maps, program, variables)
    variables += tuple(v for one in structured for v in (*one.axes, one.values))
    memory = read_template("learns.c" if learns else "fixed.c")
    texts = [*code.values(), variables, read_template("unit.c"), memory, version]
    whole = "".join(map(str, texts))
    token = f"{{{uuid.UUID(bytes=hashlib.sha256(as_bytes(whole)).digest()[:16])}}}"
    sources = [f"{name}.c", f"{name}_fmi{version}.c"]
    files = [f"{name}.h", f"{name}.c"]
    if learns:
        files += [f"{name}_adapt.h", f"{name}_adapt.c"]
        sources.append(f"{name}_adapt.c")
    found = {
        **{f"sources/{file}": str(code[file]) for file in files},
        f"sources/{name}.h": writable(str(code[f"{name}.h"]), program, learns=learns),
        f"sources/{sources[1]}": wrapper(
            program, variables, token, version, learns=learns
        ),
        "documentation/index.html": page(program, variables, version, learns=learns),
        "documentation/licenses/license.txt": LICENCE_NOTE,
    }
    if version == 2:
        about = description.fmi2(program, variables, token, sources, slopes=not learns)
        return {
            "modelDescription.xml": about,
            **found,
            "sources/fmi2Functions.h": read_template("fmi2Functions.h"),
        }
    return {
        "modelDescription.xml": description.fmi3(
            program, variables, token, slopes=not learns
        ),
        **found,
        **structure_files(structured),
        "sources/buildDescription.xml": description.build(program, sources),
    }


def place_of_binary(name: str, version: int) -> str | None:
    """The folder of the binary for this machine; None where FMI has no name for it."""
    machine = MACHINE_NAMES.get(platform.machine().lower(), platform.machine().lower())
    if platform.system() not in SYSTEM_NAMES:
        return None
    system, end = SYSTEM_NAMES[platform.system()]
    folder = f"{machine}-{system}"
    if version == 2 and (machine == "x86_64" or system == "darwin"):
        folder = f"{system}64"
    return f"binaries/{folder}/{name}{end}"


def binary(
    program: SampleProgram, parts: Mapping[str, str], version: int
) -> dict[str, bytes]:
    """The library for this machine; nothing where there is no compiler."""
    place = place_of_binary(program.name, version)
    found = compilers()
    if place is None or not found:
        return {}
    with TemporaryFolder() as folder:
        sources = list_sources(parts)
        for name, text in sources.items():
            Path(folder, name).write_bytes(as_bytes(text))
        Path(folder, "fmi3Functions.h").write_text(read_template("fmi3Functions.h"))
        own = [name for name in sources if name.endswith(".c")]
        library = Path(folder, Path(place).name)
        command = [found[0], *WARNING_FLAGS, "-O2", "-fPIC", "-shared"]
        command += ["-fvisibility=hidden", *own, "-lm", "-o", str(library)]
        done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
        if done.returncode:
            raise ExportError(
                f"the FMU of {program.name} does not compile: {done.stderr[:500]}"
            )
        return {place: library.read_bytes()}


def list_sources(parts: Mapping[str, str]) -> dict[str, str]:
    """Files of the folder sources, without its name."""
    folder = "sources/"
    return {k[len(folder) :]: v for k, v in parts.items() if k.startswith(folder)}


def archive(parts: Mapping[str, str | bytes]) -> bytes:
    """The zip; the same parts make the same bytes."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in parts.items():
            entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = (0o755 if name.startswith("bin") else 0o644) << 16
            packed.writestr(entry, as_bytes(content))
    return stream.getvalue()
