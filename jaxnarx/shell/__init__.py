"""Command line, figures, HTML report. Heavy imports live inside functions."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxnarx.shell import plot as plot


def __getattr__(name: str) -> Any:
    """`plot` on first use: it loads matplotlib."""
    if name != "plot":
        raise AttributeError(f"module 'jaxnarx.shell' has no attribute {name!r}")
    return importlib.import_module("jaxnarx.shell.plot")
