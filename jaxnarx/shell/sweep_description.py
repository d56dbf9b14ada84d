"""The TOML description of a sweep: which engines, identified how, under which cases.

```toml
[data]                                # relatives of a virtual engine
bed = "pfi-dyno"
count = 64                            # engines
spread = 0.05                         # their parameters are off by about this
length = 1000                         # samples of each record
seed = 1                              # of engines, excitation and noise
noise = 1.0                           # as a multiple of the bed's own
# or measured ones, one description (see `jaxnarx check`) per engine:
# engines = ["engines/*.toml"]
# root = "."                          # folder of their data

[identification]                      # fields of jaxnarx.Identification
output = "MAP"
scheduling = ["speed[t]"]
max_models = 4

[cases]                               # fields of jaxnarx.Case: all combinations
ridge = [1e-6, 1e-4]
train = ["coefficients", "joint"]
# or points drawn at random:
# [random]
# count = 20
# seed = 1
# ridge = ["log", 1e-8, 1e-2]         # or "uniform", "integer", or a list of values
```
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from jaxnarx.errors import DataFileError, SpecError, reading, suggest
from jaxnarx.methods import Case, Identification

SECTIONS = ("data", "identification", "cases", "random")
SCALES = (["log"], ["uniform"], ["integer"])
SHORTEST = 50
"""Samples of the shortest record of a virtual engine."""


@dataclasses.dataclass(frozen=True)
class Relatives:
    """Engines that are random relatives of a virtual one; see the module."""

    bed: str
    count: int = 16
    spread: float = 0.05
    length: int = 1000
    seed: int = 1
    noise: float = 1.0

    def __post_init__(self):
        for name, least in (("count", 1), ("length", SHORTEST), ("seed", 0)):
            if getattr(self, name) < least:
                raise SpecError(
                    f"{name} must be at least {least}, got {getattr(self, name)}",
                    field=name,
                )
        for name in ("spread", "noise"):
            if not 0 <= getattr(self, name) < float("inf"):
                raise SpecError(
                    f"{name} must be a number of at least 0, got {getattr(self, name)}",
                    field=name,
                )


@dataclasses.dataclass(frozen=True)
class Measured:
    """Engines that are described by files, found by patterns."""

    engines: tuple[str, ...]
    root: str | None = None


@dataclasses.dataclass(frozen=True)
class Description:
    """A parsed description of a sweep; `folder` is that of its file."""

    data: Relatives | Measured
    method: Identification
    cases: tuple[Case, ...]
    folder: Path


def load_sweep(path: Path) -> Description:
    """Parse a description. What is wrong in it is a DataFileError naming file and key.

    Points at random are drawn here, so the same file gives the same sweep.
    """
    from jaxnarx.data import load_toml

    table = load_toml(path)
    with reading(path, "a description of a sweep", advice="Correct it."):
        try:
            _require_known(table, SECTIONS, "the description")
            return Description(
                data=_data(_section(table, "data")),
                method=_made(
                    Identification,
                    _section(table, "identification"),
                    "[identification]",
                ),
                cases=tuple(_cases(table)),
                folder=path.parent,
            )
        except (SpecError, TypeError) as error:
            raise DataFileError(f"{path}: {error}", path=path) from error


def _data(data: dict[str, Any]) -> Relatives | Measured:
    if "engines" in data:
        patterns = data["engines"]
        texts = isinstance(patterns, list) and all(isinstance(p, str) for p in patterns)
        if not patterns or not texts:
            raise SpecError(
                f"[data] engines must be a list of files, got {patterns!r}",
                field="engines",
            )
        for name in [*patterns, data.get("root", "")]:
            if not isinstance(name, str) or Path(name).is_absolute():
                raise SpecError(
                    f"[data] files are relative to the description, got {name!r}",
                    field="engines",
                )
        return _made(Measured, {**data, "engines": tuple(patterns)}, "[data]")
    if "bed" not in data:
        raise SpecError(
            "[data] needs bed, a virtual engine, or engines, descriptions of measured "
            "ones",
            field="data",
        )
    return _made(Relatives, data, "[data]")


def _cases(table: Mapping[str, Any]) -> list[Case]:
    from jaxnarx.sweep import grid_cases, random_cases

    if "cases" in table and "random" in table:
        raise SpecError("give [cases] or [random], not both", field="cases")
    if "random" not in table:
        _require_values(_section(table, "cases", {}))
        return grid_cases(**_section(table, "cases", {}))
    settings = dict(_section(table, "random"))
    count, seed = settings.pop("count", 10), settings.pop("seed", 1)
    for name, value in (("count", count), ("seed", seed)):
        if type(value) is not int or value < 0:
            raise SpecError(
                f"[random] {name} must be a whole number, got {value!r}", field=name
            )
    _require_values(
        {
            k: v[1:] if isinstance(v, list) and v[:1] in SCALES else v
            for k, v in settings.items()
        }
    )
    return random_cases(seed, count, **settings)


def _require_values(settings: Mapping[str, Any]) -> None:
    """SpecError unless every setting has a list of values of its kind."""
    fields = {f.name: f for f in dataclasses.fields(Case)}
    _require_known(settings, fields, "[cases]")
    for name, values in settings.items():
        if not isinstance(values, list) or not values:
            raise SpecError(f"{name} must be a list, got {values!r}", field=name)
        for value in values:
            _require_kind(fields[name], value)
            if fields[name].default is None and isinstance(value, str | float | bool):
                raise SpecError(
                    f"{name} must be whole numbers, got {value!r}", field=name
                )


def _made(kind: type, settings: dict[str, Any], where: str) -> Any:
    """An object of settings, its fields' kinds checked against their defaults."""
    fields = {f.name: f for f in dataclasses.fields(kind) if f.name != "_"}
    _require_known(settings, fields, where)
    for name, value in settings.items():
        _require_kind(fields[name], value)
    return kind(**settings)


def _require_kind(field: dataclasses.Field, value: Any) -> None:
    """SpecError unless `value` is of the kind of the field's default, or a choice."""
    usual, name = type(field.default), field.name
    if get_origin(field.type) is Literal:
        known = get_args(field.type)
        if value not in known:
            raise SpecError(
                f"{name} must be one of {', '.join(known)}, got {value!r}", field=name
            )
    elif usual in _KINDS and (
        isinstance(value, bool) or not isinstance(value, _KINDS[usual])
    ):
        raise SpecError(f"{name} must be {_WORDS[usual]}, got {value!r}", field=name)


_KINDS = {int: int, float: (int, float), str: str, tuple: (list, tuple, dict, str)}
_WORDS = {int: "a whole number", float: "a number", str: "text", tuple: "a list"}


def _section(
    table: Mapping[str, Any], name: str, otherwise: dict[str, Any] | None = None
) -> dict[str, Any]:
    if name not in table and otherwise is not None:
        return otherwise
    if not isinstance(table.get(name), dict):
        raise SpecError(f"the section [{name}] is missing", field=name)
    return table[name]


def _require_known(table: Mapping[str, Any], known, where: str) -> None:
    for key in table:
        if key not in known:
            raise SpecError(
                f"{where} has the unknown key {key!r}. {suggest(key, known)}", field=key
            )
