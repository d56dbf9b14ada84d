"""Ten records of every virtual engine: eight train, two test.

As `jaxnarx simulate-engine` writes them: one row an event, the bed's usual excitation,
all outputs. The measurement noise is not the bed's own but white with 2 % of the
standard deviation of each output over the training records. The test is scored twice:
against the measurement, noise and all, and against the noise-free output.
"""

import dataclasses
from typing import Any

from sets import FRONT, OpenSet, Part

TRAIN, TEST, LENGTH = 8, 2, 2500
"""Records of both kinds, and samples of each."""

NOISE, SEED = 0.02, 19
"""Standard deviation of the noise over that of the output; seed of all draws."""

BEDS = ("pfi", "pfi-cc", "pfi-dyno", "gtdi", "vct", "diesel")
"""The engines, those with few outputs first."""


def engine(bed: str, *, length: int = LENGTH, train: int = TRAIN) -> OpenSet:
    """Measured records of one bed; the same seed, the same records."""
    import jax
    import numpy as np

    from jaxnarx.engines import BEDS as MAKERS
    from jaxnarx.engines import records

    key = jax.random.fold_in(jax.random.key(SEED), sorted(MAKERS).index(bed))
    names = [f"train {n + 1}" for n in range(train)]
    names += [f"test {n + 1}" for n in range(TEST)]
    clean = records(MAKERS[bed](), key, [length] * len(names), names=names, noise=0)
    random = np.random.default_rng([SEED, sorted(MAKERS).index(bed)])
    deviation = NOISE * np.concatenate([r.y for r in clean[:train]]).std(axis=0)
    noisy = _measured(clean, deviation, random)
    truth = tuple(r.y for r in clean[train:])
    return OpenSet(
        name=f"engine-{bed}",
        train=noisy[:train],
        parts={
            "test": Part(noisy[train:], FRONT),
            "noise-free": Part(noisy[train:], FRONT, truth),
        },
        unit={c.name: c.unit for c in clean.channels.outputs},
        split=f"{train} records of {length} events train, {TEST} are scored",
        published="nothing",
    )


def _measured(clean: Any, deviation: Any, random: Any) -> Any:
    """The records with noise of this standard deviation, (outputs,)."""
    noisy = [
        dataclasses.replace(r, y=r.y + deviation[None] * random.normal(size=r.y.shape))
        for r in clean
    ]
    return dataclasses.replace(clean, records=tuple(noisy))
