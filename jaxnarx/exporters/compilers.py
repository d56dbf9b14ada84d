"""The C compilers of this machine."""

import os
import shutil

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
