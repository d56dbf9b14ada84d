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

[identification.pool]                 # the settings of jaxnarx.Identification
outputs = ["MAP"]
[identification.grow]
method = "lolimot"
scheduling = ["speed[t]"]
max_models = 4

[cases]                               # any of them, by path: all combinations
refine.ridge = [1e-6, 1e-4]
refine.train = ["coefficients", "joint"]
# or points drawn at random:
# [random]
# count = 20
# seed = 1
# refine.ridge = ["log", 1e-8, 1e-2]  # or "uniform", "integer", or a list of values

# Calibrations by what a fleet has taught, in place of all sections but [data]:
# [fleet]
# prior = "prior.fleet"               # written by `jaxnarx fleet learn`
# samples = [10, 20, 50, 100]         # of every engine's first record
```
"""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxnarx.errors import DataFileError, SpecError, guard_reading, suggest
from jaxnarx.settings import Identification, flatten_table, from_dict, replace_at

DESCRIPTION_SECTIONS = ("data", "identification", "cases", "random", "fleet")
Case = Mapping[str, Any]
MIN_RECORD_SAMPLES = 50
"""Samples of the shortest record of a virtual engine."""


@dataclasses.dataclass(frozen=True)
class Relatives:
    """Engines that are random relatives of a virtual one; see the module."""

    bed: str
    count: int = 16
    spread: float | int = 0.05
    length: int = 1000
    seed: int = 1
    noise: float | int = 1.0

    def __post_init__(self):
        for name, least in (("count", 1), ("length", MIN_RECORD_SAMPLES), ("seed", 0)):
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

    engines: Sequence[str]
    root: str | None = None


@dataclasses.dataclass(frozen=True)
class Calibrations:
    """Calibrations of every engine by a prior, from so many samples each."""

    prior: str
    samples: Sequence[int] = (10, 20, 50, 100)


@dataclasses.dataclass(frozen=True)
class SweepDescription:
    """A parsed description of a sweep; `folder` is that of its file."""

    data: Relatives | Measured
    method: Identification
    cases: tuple[Case, ...]
    folder: Path
    method_given: bool = True
    fleet: Calibrations | None = None


def load_sweep(path: Path, *, needed: bool = True) -> SweepDescription:
    """Parse a description. What is wrong in it is a DataFileError naming file and key;
    without `needed` it may lack an identification.

    Points at random are drawn here, so the same file gives the same sweep.
    """
    from jaxnarx.data import load_toml

    table = load_toml(path)
    with guard_reading(path, "a description of a sweep", advice="Correct it."):
        try:
            for key in table:
                if key not in DESCRIPTION_SECTIONS:
                    raise SpecError(
                        f"the description has the unknown key {key!r}. "
                        f"{suggest(key, DESCRIPTION_SECTIONS)}",
                        field=key,
                    )
            data = _data(_section(table, "data"))
            fleet = _fleet(table)
            given = "identification" in table
            needed = needed and fleet is None
            settings = _section(table, "identification", None if needed else {})
            method = from_dict(Identification, settings)
            cases = tuple(_cases(table))
            for case in cases:
                replace_at(method, case)  # what does not fit is said now
            return SweepDescription(data, method, cases, path.parent, given, fleet)
        except SpecError as error:
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
        return from_dict(Measured, data, "data")
    if "bed" not in data:
        raise SpecError(
            "[data] needs bed, a virtual engine, or engines, descriptions of measured "
            "ones",
            field="data",
        )
    return from_dict(Relatives, data, "data")


def _fleet(table: Mapping[str, Any]) -> Calibrations | None:
    if "fleet" not in table:
        return None
    beside = [f"[{s}]" for s in ("identification", "cases", "random") if s in table]
    if beside:
        raise SpecError(
            f"[fleet] calibrates, {' and '.join(beside)} identify; give one of both",
            field="fleet",
        )
    found = from_dict(Calibrations, _section(table, "fleet"), "fleet")
    if Path(found.prior).is_absolute():
        raise SpecError(
            f"[fleet] prior is relative to the description, got {found.prior!r}",
            field="fleet.prior",
        )
    return found


def _cases(table: Mapping[str, Any]) -> list[Case]:
    from jaxnarx.sweep import grid_cases, random_cases

    if "cases" in table and "random" in table:
        raise SpecError("give [cases] or [random], not both", field="cases")
    if "random" not in table:
        return grid_cases(flatten_table(_section(table, "cases", {})))
    settings = dict(_section(table, "random"))
    count, seed = settings.pop("count", 10), settings.pop("seed", 1)
    for name, value in (("count", count), ("seed", seed)):
        if type(value) is not int or value < 0:
            raise SpecError(
                f"[random] {name} must be a whole number, got {value!r}", field=name
            )
    return random_cases(seed, count, flatten_table(settings))


def _section(
    table: Mapping[str, Any], name: str, otherwise: dict[str, Any] | None = None
) -> dict[str, Any]:
    if name not in table and otherwise is not None:
        return otherwise
    if not isinstance(table.get(name), dict):
        raise SpecError(f"the section [{name}] is missing", field=name)
    return table[name]
