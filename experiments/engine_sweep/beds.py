"""Records of perturbed engines of the four beds, simulated once and kept in a file."""

import dataclasses
import functools
import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import jaxnarx as jnx
from jaxnarx.engines import AbstractEngine, Diesel, Gtdi, Pfi, Vct, family
from jaxnarx.engines.bench import refuse_faults
from jaxnarx.engines.gtdi.operation import gtdi_demands
from jaxnarx.engines.gtdi.state import GtdiDrive

PARTS = ("train", "validation", "test")
SIDE_BY_SIDE = 32
"""Engines in one compiled loop."""


@dataclasses.dataclass(frozen=True)
class Bed:
    """A test bed, what of it is modelled, and from what.

    `down` is the distance of samples in events. `settings` are those of
    the identification that differ from bed to bed, by path.
    """

    make: Callable[[], AbstractEngine]
    output: str
    down: int
    settings: dict[str, Any]


BEDS = {
    "pfi": Bed(
        *(Pfi, "speed", 2),
        {
            "grow.scheduling": ("duty[t-2]", "speed[t-1]"),
            "pool.input_lags": (1, 2, 3, 4, 6, 8),
        },
    ),
    "diesel": Bed(
        *(Diesel, "p_im", 2),
        {
            "grow.scheduling": ("VGT[t-1]", "fuel[t-1]"),
            "pool.input_lags": (0, 1, 2, 4),
        },
    ),
    "gtdi": Bed(
        *(Gtdi, "TRQ", 4),
        {
            "grow.scheduling": ("speed[t]", "THR[t-1]"),
            "pool.input_lags": (0, 1, 2, 4),
        },
    ),
    "vct": Bed(
        *(Vct, "torque", 4),
        {
            "grow.scheduling": ("throttle[t-1]", "speed[t]"),
            "pool.input_lags": (0, 1, 2, 4),
        },
    ),
}


@dataclasses.dataclass(frozen=True)
class Size:
    """How many engines, repetitions of the nominal one, and samples of each part."""

    engines: int
    repetitions: int
    lengths: tuple[int, int, int]
    spread: float
    seed: int = 0


@dataclasses.dataclass(frozen=True, eq=False)
class Records:
    """Sampled inputs and noise-free outputs of every member, part by part.

    Members are the engines of the family, then the nominal engine again and again: with
    other noise, with another excitation. `factors` are the logarithms of the family's
    parameters over the nominal ones.
    """

    bed: Bed
    names: tuple[str, ...]
    inputs: dict[str, Float[np.ndarray, "members time inputs"]]
    outputs: dict[str, Float[np.ndarray, "members time outputs"]]
    factors: Float[np.ndarray, "engines varied"]


def records_of(name: str, size: Size, folder: Path) -> Records:
    """Simulate, or read what an earlier run has simulated."""
    asked = json.dumps([name, dataclasses.asdict(size), BEDS[name].down])
    digest = hashlib.sha256(asked.encode()).hexdigest()[:12]
    path = folder / f"{name}_{digest}.npz"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        temporary = path.with_suffix(".tmp.npz")
        np.savez_compressed(temporary, **_simulated(name, size))  # pyright: ignore
        os.replace(temporary, path)
    with np.load(path) as kept:
        held = {key: kept[key] for key in kept.files}
    inputs = {part: held[f"{part}_inputs"] for part in PARTS}
    outputs = {part: held[f"{part}_outputs"] for part in PARTS}
    return Records(BEDS[name], member_names(size), inputs, outputs, held["factors"])


def member_names(size: Size) -> tuple[str, ...]:
    """Names of all members in their order."""
    again = range(size.repetitions)
    return (
        *(f"engine {n}" for n in range(size.engines)),
        *(f"noise {n}" for n in again),
        *(f"excitation {n}" for n in again),
    )


def _simulated(name: str, size: Size) -> dict[str, np.ndarray]:
    """Every member under its inputs, every `down`-th event of it.

    Engines of the family and repetitions with other noise share their excitation.
    """
    bed, key = BEDS[name], jax.random.key(size.seed)
    nominal = bed.make()
    engines = family(nominal, key, size.engines, spread=size.spread)
    found: dict[str, np.ndarray] = {"factors": factors(nominal, engines)}
    for n, (part, length) in enumerate(zip(PARTS, size.lengths, strict=True)):
        keys = jax.random.split(jax.random.fold_in(key, n + 1), size.repetitions + 1)
        demand = jnp.stack([_demand(nominal, k, length * bed.down) for k in keys])
        many = [engines, *[_repeated(nominal, size.repetitions + 1)]]
        stacked = jax.tree.map(lambda *a: jnp.concatenate(a), *many)
        shared = jnp.broadcast_to(demand[:1], (size.engines, *demand.shape[1:]))
        u, y = _run(stacked, jnp.concatenate([shared, demand]))
        # The nominal engine under the shared excitation stands for all its noises.
        at = [*range(size.engines), *[size.engines] * size.repetitions]
        at += range(size.engines + 1, size.engines + 1 + size.repetitions)
        found[f"{part}_inputs"] = u[at, :: bed.down]
        found[f"{part}_outputs"] = y[at, :: bed.down]
    return found


def factors(
    nominal: AbstractEngine, engines: AbstractEngine
) -> Float[np.ndarray, "engines varied"]:
    """log(p / p_0) of every varied parameter."""

    def values(engine):
        parts = [
            functools.reduce(getattr, name.split("."), engine)
            for name in nominal.varied
        ]
        return np.stack([np.asarray(p) for p in parts], axis=-1)

    return np.log(values(engines) / values(nominal)[None])


def _repeated(engine: AbstractEngine, count: int) -> AbstractEngine:
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (count,)), engine)


def _demand(engine: AbstractEngine, key, length: int) -> Float[Array, "time inputs"]:
    if isinstance(engine, Gtdi):
        return gtdi_demands(key, length)
    return engine.excite(key, length)


def _run(engines: AbstractEngine, demands: Float[Array, "members time inputs"]):
    """Inputs and outputs of all, some engines side by side."""
    count, found = len(demands), []
    for first in range(0, count, SIDE_BY_SIDE):
        # The last ones are filled up, so that one program serves all.
        at = np.minimum(np.arange(first, first + SIDE_BY_SIDE), count - 1)
        part = jax.tree.map(lambda leaf, at=at: leaf[at], engines)
        u, y = _run_some(part, demands[at])
        found.append((np.asarray(u)[: count - first], np.asarray(y)[: count - first]))
    inputs, outputs = zip(*found, strict=True)
    return np.concatenate(inputs), np.concatenate(outputs)


@eqx.filter_jit
def _run_some(engines: AbstractEngine, demands: Float[Array, "some time inputs"]):
    def one(engine, demand):
        if isinstance(engine, Gtdi):
            return _scheduled_run(engine, demand)
        return demand, engine.run(demand)

    return jax.vmap(one)(engines, demands)


def _scheduled_run(engine: Gtdi, demands: Float[Array, "time inputs"]):
    """Inputs whose fuel and spark follow this very engine, and its outputs.

    As `scheduled` and then `run`, in one pass: fuel of the nominal engine would leave
    the others without a mixture that burns.
    """

    def drive(row):
        richness, offset, throttle, speed = row
        return GtdiDrive(throttle, speed, richness=richness, offset=offset)

    def inputs(now, row):
        return jnp.concatenate([jnp.stack([now.fuel, now.spark]), row[2:]])

    def event(carry, row):
        u = inputs(engine.quantities(carry[0], drive(row)), row)
        carry, y = engine.advance(carry, u)
        return carry, (u, y)

    state = engine.balance(drive(demands[0]))
    first = inputs(engine.quantities(state, drive(demands[0])), demands[0])
    carry = engine.settled_bench(state, first)
    return jax.lax.scan(event, carry, demands)[1]


def fleet_of(records: Records, seed: int) -> jnx.Fleet:
    """All members measured with noise of their own; a broken engine is an error."""
    bed = records.bed
    engine = bed.make()
    column = engine.channels.output_names.index(bed.output)
    noise = engine.noise[bed.output]
    data: dict[str, jnx.Dataset | jnx.DataError] = {}
    for n, name in enumerate(records.names):
        random = np.random.default_rng([seed, n])
        rows = []
        try:
            for part in PARTS:
                u, y = records.inputs[part][n], records.outputs[part][n]
                refuse_faults(engine, u, y, part)
                clean = y[:, column]
                deviation = noise.absolute + noise.relative * np.abs(clean)
                measured = clean + deviation * random.normal(size=len(clean))
                rows.append((u, measured[:, None]))
        except jnx.DataError as error:
            data[name] = error
            continue
        data[name] = jnx.Dataset.from_arrays(
            [u for u, _ in rows],
            [y for _, y in rows],
            inputs=list(engine.channels.inputs),
            outputs=[engine.channels.outputs[column]],
            sample_time=bed.down * engine.sample_time,
            names=PARTS,
        )
    return jnx.Fleet.from_datasets(
        data, train=["train"], validation=["validation"], test=["test"]
    )
