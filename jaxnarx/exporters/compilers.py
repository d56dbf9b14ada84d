"""The C compilers of this machine."""

import ctypes
import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from jaxnarx.exporters.proof import ExportError

WARNING_FLAGS = (
    "-std=c99",
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Wconversion",
    "-Werror",
)
"""Flags that every exported file is compiled with."""


def compilers() -> tuple[str, ...]:
    """The compilers of this machine, the system's own first, each once."""
    found: dict[str, str] = {}
    for path in filter(None, map(shutil.which, ("cc", "gcc", "clang"))):
        found.setdefault(os.path.realpath(path), path)
    return tuple(found.values())


def compiler() -> str | None:
    """The first, where there is one."""
    return next(iter(compilers()), None)


def load_library(
    sources: Sequence[Path],
    library: Path,
    options: Sequence[str] = ("-O2",),
    cc: str | None = None,
) -> ctypes.CDLL:
    """C files compiled beside the first of them, and loaded; warnings are errors."""
    chosen = cc or compiler()
    if chosen is None:
        raise ExportError("there is no C compiler here")
    command = [chosen, *WARNING_FLAGS, *options, "-fPIC", "-shared"]
    command += [f"-I{sources[0].parent}", *map(str, sources)]
    command += ["-lm", "-o", str(library)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        text = done.stderr.strip()[:500]
        raise ExportError(f"{sources[0].name} does not compile: {text}")
    return ctypes.CDLL(str(library))
