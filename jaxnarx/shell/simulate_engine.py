"""Records of a virtual engine: simulated, written as files, and told about."""

import math
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

import jaxnarx.excitation as signals
from jaxnarx.data import Dataset, ToTime, prepare
from jaxnarx.engines import BEDS, AbstractEngine
from jaxnarx.errors import SpecError, suggest
from jaxnarx.shell.commands import SimulateEngine
from jaxnarx.shell.messages import count, say
from jaxnarx.shell.output import run_folder, write_text, write_together
from jaxnarx.shell.record_files import describe, record_csv

DESCRIPTION_FILE, FIGURE_FILE = "engine.toml", "excitation.png"
MIN_RECORD_SAMPLES = 20
"""Samples of the shortest record."""

EXCITATION_EVENTS = 2000
"""Events of the usual excitation that tell operating point and range."""

STAIRCASE_LEVELS = 8
"""Levels of the staircase, up and down again."""


def simulate_engine(command: SimulateEngine, typed: str) -> Path:
    """Simulate, write, report; returns the description's path."""
    _require(command)
    engine = BEDS[command.engine]()
    if command.sample_time is not None and engine.event is None:
        raise SpecError(
            "--sample-time is for beds sampled by crank angle; this one samples every "
            f"{engine.sample_time:g} s"
        )
    parts = _parts(command.records)
    names = [f"{name}.csv" for part in parts.values() for name in part]
    marks = [*names, DESCRIPTION_FILE, FIGURE_FILE]
    with run_folder(command.out, "", force=command.force, marks=marks) as folder:
        data, flags = _simulate(engine, command, [n[:-4] for n in names])
        by_event = engine.event is not None and command.sample_time is None
        say(f"\n{signals.assess(data, ranges=engine.ranges)}")
        texts = {
            file: record_csv(data, n, by_event=by_event, flags=_columns(flags[n]))
            for n, file in enumerate(names)
        }
        files = {part: [f"{n}.csv" for n in group] for part, group in parts.items()}
        remarks = _remarks(engine, by_event)
        texts[DESCRIPTION_FILE] = describe(data, files, by=typed, remarks=remarks)
        with write_together(folder) as place:
            for name, text in texts.items():
                write_text(place / name, text)
            _draw(engine, data, place / FIGURE_FILE)
    count_of = count(len(names), "record")
    say(f"\nwrote {count_of}, {DESCRIPTION_FILE} and {FIGURE_FILE} to {folder}")
    return folder / DESCRIPTION_FILE


def _simulate(
    engine: AbstractEngine, command: SimulateEngine, names: list[str]
) -> tuple[Dataset, list[dict[str, Any]]]:
    """The records, and which samples of each break a limit."""
    keys = jax.random.split(jax.random.key(command.seed), 3)
    if command.spread:
        engine = engine.perturb(keys[0], command.spread)
    length = round(command.duration / engine.sample_time)
    if length < MIN_RECORD_SAMPLES:
        raise SpecError(
            f"--duration {command.duration:g} is {count(length, 'sample')} of "
            f"{engine.sample_time:g} s; give at least {MIN_RECORD_SAMPLES}"
        )
    inputs = [
        _inputs(engine, command, jax.random.fold_in(keys[1], i), length, i)
        for i in range(len(names))
    ]
    say(
        f"Simulating {command.engine}: {count(len(names), 'record')} of "
        f"{count(length, 'sample')}"
    )
    data = engine.simulate(inputs, keys[2], noise=command.noise, names=names)
    flags = [engine.flags(u) for u in inputs]
    for name, found in zip(names, flags, strict=True):
        _tell_limits(name, found)
    if command.sample_time is None:
        return data, flags
    assert engine.event is not None
    step = ToTime(speed="speed", degrees=engine.event, sample_time=command.sample_time)
    return prepare(data, [step])[0], [{} for _ in names]


def _require(command: SimulateEngine) -> None:
    for option in ("duration", "noise", "spread"):
        value = getattr(command, option)
        if not 0 <= value < math.inf:
            raise SpecError(f"--{option} must be a number of at least 0, got {value}")
    if command.sample_time is not None and not 0 < command.sample_time < math.inf:
        raise SpecError(f"--sample-time must be positive, got {command.sample_time}")
    if command.records < 1:
        raise SpecError(f"--records must be at least 1, got {command.records}")
    if command.hold < 1:
        raise SpecError(f"--hold must be at least 1 sample, got {command.hold}")
    if command.input is not None and command.signal == "aprbs":
        raise SpecError(
            "--input belongs to the signals of one input; aprbs excites all of them"
        )


def _parts(records: int) -> dict[str, list[str]]:
    """Names of the records by part; the last two validate and test."""
    if records < 3:
        return {"files": [f"record_{i + 1}" for i in range(records)]}
    train = [f"train_{i + 1}" for i in range(records - 2)] if records > 3 else ["train"]
    return {"train": train, "validate": ["validate"], "test": ["test"]}


def _inputs(
    engine: AbstractEngine, command: SimulateEngine, key: PRNGKeyArray, length: int, i
) -> Float[Array, "time inputs"]:
    """The bed's usual excitation, or one input moved about a usual operating point."""
    if command.signal == "aprbs":
        return engine.excite(key, length)
    known = engine.channels.input_names
    name = known[0] if command.input is None else command.input
    if name not in known:
        raise SpecError(f"--input: no input {name!r}. {suggest(name, known)}")
    usual = np.asarray(engine.excite(jax.random.key(0), EXCITATION_EVENTS))
    j = known.index(name)
    span = (float(usual[:, j].min()), float(usual[:, j].max()))
    # The event nearest to the middle of all: a mean of events may be none itself.
    away = (usual - np.median(usual, axis=0)) / np.maximum(usual.std(axis=0), 1e-12)
    base = usual[int(np.argmin(np.sum(away**2, axis=1)))]
    moved = _signal(command, key, length, span, engine.sample_time, i)
    return jnp.tile(jnp.asarray(base), (length, 1)).at[:, j].set(moved)


def _signal(
    command: SimulateEngine,
    key: PRNGKeyArray,
    length: int,
    span: tuple[float, float],
    sample_time: float,
    i: int,
) -> Float[Array, " time"]:
    """One input over time; `i` counts records, whose realisations differ."""
    hold = command.hold
    highest = 0.5 / sample_time / hold
    if command.signal == "prbs":
        return signals.prbs(length, amplitude=span, clock=hold, shift=37 * i)
    if command.signal == "random-walk":
        step = (span[1] - span[0]) / 4
        return signals.random_walk(key, length, amplitude=span, step=step, hold=hold)
    if command.signal == "multisine":
        top = max(1, int(highest * length * sample_time))
        harmonics = range(1, top + 1)
        return signals.multisine(length, harmonics=harmonics, amplitude=span, key=key)
    if command.signal == "chirp":
        slowest = 2 / (length * sample_time)
        return signals.chirp(
            length,
            frequency=(slowest, max(highest, 2 * slowest)),
            amplitude=span,
            sample_time=sample_time,
        )
    levels = np.linspace(*span, STAIRCASE_LEVELS)
    stairs = [*levels, *levels[-2::-1]]
    each = -(-length // len(stairs))
    return signals.steps([float(x) for x in stairs], hold=each)[:length]


def _columns(flags: dict[str, Any]) -> dict[str, Any]:
    """Limits that are broken somewhere, as columns."""
    return {f"{name} limit": found for name, found in flags.items() if found.any()}


def _tell_limits(record: str, flags: dict[str, Any]) -> None:
    for name, broken in flags.items():
        if broken.any():
            share = 100 * float(np.mean(broken))
            say(
                f"  {record}: the {name} limit is broken in "
                f"{count(int(broken.sum()), 'sample')} ({share:.2g} %), first in row "
                f"{int(np.argmax(broken))}"
            )


def _remarks(engine: AbstractEngine, by_event: bool) -> list[str]:
    if not by_event:
        return []
    return [
        f"One row per {engine.event:g} degrees crank angle; sample_time is nominal.",
        "`jaxnarx simulate-engine --sample-time S` resamples to time.",
    ]


def _draw(engine: AbstractEngine, data: Dataset, path: Path) -> None:
    from jaxnarx.shell.figures.excitation import excitation

    figure = excitation(data, ranges=engine.ranges, outputs=True)
    figure.savefig(path, dpi=110, facecolor="white")
