"""Fleets on which partitions are compared: members differ in excitation and noise.

Every member has records for training, validation and test; those of simulated systems
are made from a seed, and their test output is free of noise, so that a test error is
that of the model. Members of `gengine1` are measured: one only.

`Nelles' processes`: the four of `nelles/processes.py`, 5 % noise on the output.
`gtdi`: torque of the turbocharged bed. `diesel`: intake pressure of the diesel bed,
every second sample; both under their usual excitation. `gengine1`: exhaust temperature
of a measured engine, means over one second.
"""

import dataclasses
import functools
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import jax
import numpy as np

import jaxnarx as jnx
from jaxnarx.data import Record
from jaxnarx.engines import AbstractEngine, Diesel, Gtdi, records
from jaxnarx.errors import DataFileError
from jaxnarx.sweep import Fleet

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "nelles"))
import processes  # noqa: E402 # pyright: ignore[reportMissingImports]

BLOCK = 10
"""Samples of gengine1 that are averaged into one."""
SHARES = {
    "train": slice(0, 14),
    "validation": slice(14, 20),
    "test": slice(20, 26),
}
"""Records of gengine1 after `dealt`."""


@dataclasses.dataclass(frozen=True)
class Problem:
    """Records by seed, and how they are identified where nothing else is said."""

    make: Callable[[int, int], jnx.Dataset]
    method: jnx.Identification
    _: dataclasses.KW_ONLY
    length: int = 1000
    """Most samples of a record."""
    measured: bool = False

    def fleet(self, seeds: int, length: int | None = None) -> Fleet:
        """A member for every seed, or the only one."""
        names = ["measured"] if self.measured else [f"seed {n}" for n in range(seeds)]
        length = length or self.length
        made = {name: self.make(n, length) for n, name in enumerate(names)}
        parts = {"train": slice(0, 1), "validation": slice(1, 2), "test": slice(2, 3)}
        return Fleet.from_datasets(made, **(SHARES if self.measured else parts))


def of_process(name: str, seed: int, length: int) -> jnx.Dataset:
    """The three records of one of Nelles' processes, cut to a length."""
    parts = processes.records(processes.PROCESSES[name], seed)
    kept = [p.records[0] for p in parts]
    return jnx.Dataset.from_arrays(
        [r.u[:length] for r in kept],
        [r.y[:length] for r in kept],
        inputs=["u"],
        outputs=["y"],
        sample_time=1.0,
        names=["train", "validation", "test"],
    )


def simulated(
    engine: AbstractEngine,
    seed: int,
    length: int,
    *,
    output: str,
    down: int,
) -> jnx.Dataset:
    """Three records of one output of a bed, every `down`-th event, the last without
    noise."""
    made = [
        records(
            *(engine, jax.random.key(seed), [length * down] * 3),
            noise=noise,
            outputs=[output],
        )
        for noise in (1.0, 0.0)
    ]
    kept = [made[0].records[0], made[0].records[1], made[1].records[2]]
    return jnx.Dataset.from_arrays(
        [r.u[::down] for r in kept],
        [r.y[::down] for r in kept],
        inputs=list(made[0].channels.inputs),
        outputs=list(made[0].channels.outputs),
        sample_time=down * made[0].sample_time,
        names=["train", "validation", "test"],
    )


def of_gtdi(seed: int, length: int) -> jnx.Dataset:
    """Torque."""
    return simulated(Gtdi(), seed, length, output="TRQ", down=1)


def of_diesel(seed: int, length: int) -> jnx.Dataset:
    """Intake manifold pressure."""
    return simulated(Diesel(), seed, length, output="p_im", down=2)


def dealt(count: int) -> list[int]:
    """Training records with those that judge behind: every third, up to six."""
    judging = list(range(count))[2::3][:6]
    return [n for n in range(count) if n not in judging] + judging


def averaged(record: Record, block: int) -> tuple[np.ndarray, np.ndarray]:
    """Means over blocks of samples; a rest is left out."""
    blocks = len(record) // block
    tables = [np.asarray(t)[: blocks * block] for t in (record.u, record.y)]
    means = [t.reshape(blocks, block, -1).mean(axis=1) for t in tables]
    return means[0], means[1]


@functools.cache
def of_gengine1(_: int, length: int) -> jnx.Dataset:
    """Fourteen records to train on, six to judge by, the official six to test with."""
    split = jnx.read_split(ROOT / "gengine1" / "gengine1.toml")
    assert split.train is not None and split.test is not None
    known, test = split.train, split.test
    every = [known.records[n] for n in dealt(len(known))] + list(test.records)
    pairs = [averaged(r, BLOCK) for r in every]
    place = [c.name for c in known.channels.outputs].index("T_exhaust")
    return jnx.Dataset.from_arrays(
        [u[:length] for u, _ in pairs],
        [y[:length, [place]] for _, y in pairs],
        inputs=list(known.channels.inputs),
        outputs=[known.channels.outputs[place]],
        sample_time=BLOCK * known.sample_time,
        names=[r.name for r in every],
    )


def missing(problem: Problem) -> str:
    """Why a problem cannot be posed here; empty where it can."""
    if not problem.measured:
        return ""
    try:
        of_gengine1(0, 2**30)
    except DataFileError as error:
        name = Path(os.environ.get("JAXNARX_DATA", "shared/data")).name
        return f"measured data is not there ({type(error).__name__}, folder {name})"
    return ""


def _affine(
    scheduling: Sequence[str],
    input_lags: Sequence[int],
    max_terms: int,
    output_lags: Sequence[int] = (1, 2),
) -> jnx.Identification:
    """Affine local models, as many as LOLIMOT is asked for."""
    return jnx.Identification(
        pool=jnx.Polynomial(input_lags=input_lags, output_lags=output_lags, degree=1),
        select=jnx.ForwardOLS(max_terms=max_terms),
        grow=jnx.Lolimot(scheduling, criterion="none"),
        # A search makes all its steps.
        refine=jnx.SimulationError(
            horizons=(), window_steps=5, max_steps=10, tolerance=0, patience=1000
        ),
    )


PROCESSES = {
    name: Problem(
        functools.partial(of_process, name),
        _affine(p.scheduling, p.input_lags, 3 + len(p.input_lags)),
    )
    for name, p in processes.PROCESSES.items()
}
ENGINES = {
    "gtdi": Problem(
        of_gtdi, _affine(("speed[t]", "THR[t]"), (0, 1, 2, 4, 8), 12), length=3000
    ),
    "diesel": Problem(
        of_diesel,
        _affine(("VGT[t-1]", "fuel[t-1]"), (0, 1, 2, 4), 10),
        length=2000,
    ),
}
MEASURED = {
    "gengine1": Problem(
        of_gengine1,
        _affine(("speed[t]", "load[t]"), (0, 1, 2, 4, 8), 12),
        length=2000,
        measured=True,
    )
}
PROBLEMS = PROCESSES | ENGINES | MEASURED
