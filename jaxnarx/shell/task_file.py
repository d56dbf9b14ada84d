"""TOML files that say what is to be done: maps, limits, commands."""

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxnarx.errors import DataFileError, SpecError


def read_task_file(path: str, keys: Sequence[str]) -> dict[str, Any]:
    """The tables of a file that may have these keys alone."""
    try:
        with Path(path).open("rb") as file:
            given = tomllib.load(file)
    except FileNotFoundError as error:
        raise DataFileError(f"{path}: there is no such file", path=path) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise DataFileError(f"{path} is no TOML: {error}", path=path) from error
    unknown = set(given) - set(keys)
    if unknown:
        raise SpecError(
            f"{path} has the unknown key {sorted(unknown)[0]!r}; there are "
            f"{', '.join(keys[:-1])} and {keys[-1]}"
        )
    return given
