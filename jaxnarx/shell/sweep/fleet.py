"""The engines of a described sweep: simulated relatives of a bed, or files."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import jax

from jaxnarx.data import Dataset, Split, read_split
from jaxnarx.engines import BEDS, AbstractEngine
from jaxnarx.errors import DataError, DataFileError, SpecError, suggest
from jaxnarx.fleet import CalibrationWork, load_prior
from jaxnarx.shell.output import slug
from jaxnarx.shell.progress import count, say
from jaxnarx.shell.sweep.description import (
    Calibrations,
    Measured,
    Relatives,
    SweepDescription,
)
from jaxnarx.sweep import Fleet

RECORD_PARTS = ("train", "validate", "test")


def make_fleet(description: SweepDescription) -> Fleet:
    """The fleet of a description: every engine with records for the same parts."""
    if isinstance(description.data, Relatives):
        return _simulate(description.data)
    return _read(description.data, description.folder)


def _simulate(data: Relatives) -> Fleet:
    """A fleet of relatives of a bed."""
    train, validate, test = RECORD_PARTS
    found = simulate_relatives(data)
    return Fleet.from_datasets(found, train=train, validation=validate, test=test)


def simulate_relatives(data: Relatives) -> dict[str, Dataset | DataError]:
    """Engines under the same excitation; one that stalls has no data but a reason."""
    if data.bed not in BEDS:
        raise SpecError(
            f"there is no bed {data.bed!r}. {suggest(data.bed, BEDS)}", field="bed"
        )
    engine = BEDS[data.bed]()
    relatives, signals, noise = jax.random.split(jax.random.key(data.seed), 3)
    inputs = [
        engine.excite(jax.random.fold_in(signals, i), data.length)
        for i in range(len(RECORD_PARTS))
    ]
    say(
        f"Simulating {count(data.count, 'relative')} of {data.bed}: 3 records of "
        f"{count(data.length, 'sample')} each"
    )

    def simulate_relative(n: int) -> Dataset | DataError:
        own: AbstractEngine = engine.perturb(
            jax.random.fold_in(relatives, n), data.spread
        )
        key = jax.random.fold_in(noise, n)
        try:
            return own.simulate(inputs, key, noise=data.noise, names=RECORD_PARTS)
        except DataError as error:
            say(f"  engine {n:04d} is left out: {error}")
            return error

    found: dict[str, Dataset | DataError] = {
        f"{data.bed}-{n:04d}": simulate_relative(n) for n in range(data.count)
    }
    if not any(isinstance(d, Dataset) for d in found.values()):
        raise DataError(
            f"none of the {data.count} relatives of {data.bed} runs; use a smaller "
            "spread"
        )
    return found


def engine_files(data: Measured, folder: Path) -> tuple[dict[str, Path], str | None]:
    """The engines that patterns find, by the names of their descriptions, and the
    folder of their data."""
    paths = sorted({path for text in data.engines for path in folder.glob(text)})
    if not paths:
        raise DataFileError(
            f"no file matches {', '.join(data.engines)} in {folder}", path=folder
        )
    named: dict[str, Path] = {}
    for path in paths:
        name = slug(path.stem)
        named[name if name not in named else f"{name}-{len(named)}"] = path
    return named, None if data.root is None else str(folder / data.root)


def _read(data: Measured, folder: Path) -> Fleet:
    paths, root = engine_files(data, folder)
    say(f"Reading {count(len(paths), 'engine')}")
    return _join({name: read_split(p, root=root) for name, p in paths.items()})


def calibration_work(
    description: SweepDescription, asked: Calibrations
) -> CalibrationWork:
    """Calibrations of all engines of a description by the prior that it names."""
    prior, data = load_prior(description.folder / asked.prior), description.data
    if isinstance(data, Relatives):
        engines = simulate_relatives(data)
    else:
        paths, root = engine_files(data, description.folder)
        say(f"Reading {count(len(paths), 'engine')}")
        engines = {name: _records(path, root) for name, path in paths.items()}
    return CalibrationWork(prior, engines, tuple(asked.samples))


def _records(path: Path, root: str | None) -> Dataset | DataError:
    """All records of an engine, or why there are none."""
    try:
        return read_split(path, root=root).all
    except (DataError, DataFileError, SpecError) as error:
        return DataError(str(error))


def _join(splits: Mapping[str, Split]) -> Fleet:
    """A fleet whose engines may have different numbers of records in a part."""
    first = next(iter(splits.values()))
    parts = [p for p in RECORD_PARTS if getattr(first, p) is not None]
    for name, split in splits.items():
        own = [p for p in RECORD_PARTS if getattr(split, p) is not None]
        if own != parts or "train" not in own:
            raise SpecError(
                f"every engine needs records to train, and the same parts as the "
                f"first; {name} has {', '.join(own) or 'none'}",
                field="engines",
            )
    fleets = {
        part: Fleet.from_datasets(
            {name: getattr(split, part) for name, split in splits.items()},
            train=slice(None),
        )
        for part in parts
    }
    whole = fleets.pop("train")
    for part, other in fleets.items():
        rows = zip(whole.status, whole.detail, other.status, other.detail, strict=True)
        told = [(a, b) if a != "ok" else (c, d) for a, b, c, d in rows]
        whole = dataclasses.replace(
            whole,
            status=tuple(status for status, _ in told),
            detail=tuple(detail for _, detail in told),
            **{"validation" if part == "validate" else part: other.train},
        )
    return whole
