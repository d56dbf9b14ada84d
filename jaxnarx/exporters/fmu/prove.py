"""The binary of an FMU beside the model, through the functions of FMI."""

import ctypes
import subprocess
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from jaxnarx.exporters.a2l import addresses_in
from jaxnarx.exporters.compilers import WARNING_FLAGS, compiler
from jaxnarx.exporters.fmu.glue import read_template
from jaxnarx.exporters.fmu.pack import archive_name, place_of_binary
from jaxnarx.exporters.fmu.variables import quantities
from jaxnarx.exporters.fmu.xcp import FOLDER, symbols_of
from jaxnarx.exporters.form import SampleProgram
from jaxnarx.exporters.names import identifiers
from jaxnarx.exporters.proof import DOUBLE_TOLERANCE, Case, ExportError, Runner, worst
from jaxnarx.exporters.target import Proof


def prove_fmu2(program: SampleProgram, folder: Path, cases: Sequence[Case]) -> Proof:
    """Prove FMI 2.0: outputs behind the step that has taken their sample."""
    return _proven(program, folder, cases, 2)


def prove_fmu3(program: SampleProgram, folder: Path, cases: Sequence[Case]) -> Proof:
    """Prove FMI 3.0: outputs in event mode, without delay."""
    return _proven(program, folder, cases, 3)


def _proven(
    program: SampleProgram, folder: Path, cases: Sequence[Case], version: int
) -> Proof:
    run = fmu_runner(folder, program, version)
    if run is None:
        return {}, [f"fmu{version}: sources only, there is no C compiler here"]
    # What is loaded stays as the last run has left it.
    handle = ctypes.CDLL(str(_library(program, folder, version)))
    last = []

    def seen(u: np.ndarray, y: np.ndarray) -> np.ndarray:
        out = run(u, y)
        last[:] = u[-1], out[-1]
        return out

    found = {f"fmu{version}": worst(cases, seen, DOUBLE_TOLERANCE, f"FMU {version}.0")}
    return found | _prove_addresses(program, folder, version, handle, *last), []


def _library(program: SampleProgram, folder: Path, version: int) -> Path:
    """The binary beside the archive."""
    place = place_of_binary(program.name, version)
    assert place is not None
    return folder / f"fmi{version}" / Path(place).name


def load_memory(
    program: SampleProgram, folder: Path, version: int, handle: ctypes.CDLL
) -> Callable[[str, int], Any] | None:
    """A function that finds as many numbers of a loaded binary as are asked for, by
    what the A2L file calls them; None where there are no addresses."""
    place = place_of_binary(program.name, version)
    assert place is not None
    file = f"{FOLDER}/{Path(place).parent.name}/{program.name}.a2l"
    with zipfile.ZipFile(folder / archive_name(program, version)) as packed:
        if file not in packed.namelist():
            return None
        addresses = addresses_in(packed.read(file).decode("iso-8859-1"))
    entry = f"fmi{version}GetVersion"
    where = ctypes.cast(getattr(handle, entry), ctypes.c_void_p).value
    assert where is not None
    library = _library(program, folder, version).read_bytes()
    base = where - symbols_of(library)[entry]
    return lambda name, count: (ctypes.c_double * count).from_address(
        base + addresses[name]
    )


def _prove_addresses(
    program: SampleProgram,
    folder: Path,
    version: int,
    handle: ctypes.CDLL,
    u: np.ndarray,
    y: np.ndarray,
) -> dict[str, float]:
    """Compare memory, where the A2L file says so, with the model's tables and with a
    run that has ended: inputs `u`, which may be missing, and outputs `y`. Nothing is
    compared where there are no addresses."""
    memory = load_memory(program, folder, version, handle)
    if memory is None:
        return {}
    wanted = {f"{program.name}_{t.name}": t.values for t in program.tables}
    for kind, ports, values in (
        ("in", program.inputs, u),
        ("out", program.reported, y),
    ):
        words = identifiers(port.name for port in ports)
        for word, value in zip(words, values, strict=True):
            wanted[f"{program.name}_{kind}_{word}"] = np.atleast_1d(value)
    for name, values in wanted.items():
        numbers = memory(name, values.size) if values.size else ()
        if not np.array_equal(numbers, values.ravel(), equal_nan=True):
            raise ExportError(f"FMU {version}.0: the address of {name} is wrong")
    return {f"fmu{version}, addresses of the A2L file": 0.0}


def fmu_runner(
    folder: Path, program: SampleProgram, version: int, *, learns: bool = False
) -> Runner | None:
    """Runs the binary in the archive of `folder`, from measured history; None where it
    has none for this machine. One that `learns` runs over all samples, from the first
    one repeated, and learns from all of them."""
    place = place_of_binary(program.name, version)
    with zipfile.ZipFile(folder / archive_name(program, version)) as packed:
        if place is None or place not in packed.namelist():
            return None
        library = folder / f"fmi{version}" / Path(place).name
        library.parent.mkdir(exist_ok=True)
        library.write_bytes(packed.read(place))
        root = ET.fromstring(packed.read("modelDescription.xml"))
    token = root.get("guid") or root.get("instantiationToken") or ""
    call = _loop(library.parent, version).run
    reported = len(program.reported)
    kinds = [v.kind for v in quantities(program, version, learns=learns)]
    start = kinds.index("choice")

    def run(u: np.ndarray, y: np.ndarray) -> np.ndarray:
        past, rows = np.arange(program.history), u[program.history :]
        if learns:
            past, rows = 0 * past, np.column_stack([u, y, np.ones(len(u))])
        lags = np.concatenate([u[past][::-1].T, y[past][::-1].T]).ravel()
        rows = np.ascontiguousarray(rows, float)
        out = np.zeros((len(rows), reported))
        failed = call(
            str(library).encode(),
            token.encode(),
            (ctypes.c_long * 5)(*rows.shape, reported, start, lags.size),
            ctypes.c_double(program.sample_time),
            *(a.ctypes.data_as(ctypes.c_void_p) for a in (lags, rows, out)),
        )
        if failed:
            raise ExportError(f"FMU {version}.0 fails, loop{version}.c:{failed}")
        return out

    return run


def _loop(build: Path, version: int) -> ctypes.CDLL:
    """The loop over a record, in C: a call from here costs as much as a sample."""
    for file in (f"loop{version}.c", f"fmi{version}Functions.h"):
        (build / file).write_text(read_template(file))
    chosen, library = compiler(), build / f"loop{version}.so"
    assert chosen is not None, "there is a binary, so there was a compiler"
    command = [chosen, *WARNING_FLAGS, "-O2", "-fPIC", "-shared"]
    command += [str(build / f"loop{version}.c"), "-ldl", "-o", str(library)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(library))
