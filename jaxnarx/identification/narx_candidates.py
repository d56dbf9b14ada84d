"""Candidates whose terms hold past outputs, each trained on the free run."""

import math
from collections.abc import Iterator

from jaxnarx.data import Dataset
from jaxnarx.partition import DataProfile
from jaxnarx.regressors import Pool, polynomial_pool
from jaxnarx.settings import (
    ForwardOLS,
    Global,
    Identification,
    Lolimot,
    SimulationError,
)

WINDOW_HORIZONS = (10, 100)
LAGS_DEGREES_TERMS = (
    *((3, 3, 20), (2, 3, 12), (2, 2, 10), (2, 1, 0), (2, 3, 30)),
    *((3, 2, 20), (4, 3, 30), (4, 2, 30), (3, 1, 0), (2, 3, 6), (4, 3, 50)),
)
"""Longest lag, degree and number of terms; of degree one local models. The order is
that of `experiments/open_sets/order.py`: what lowered errors most for its seconds."""
LARGEST_POOL = 600
"""Candidate terms of a pool."""


def propose_narx(
    data: Dataset, profile: DataProfile
) -> Iterator[tuple[str, list[str], Identification]]:
    """(family, its one name, method), those that pay most often first."""
    for lags, degree, terms in LAGS_DEGREES_TERMS:
        if degree == 1:
            yield from _local(data, profile, lags)
            continue
        pool = make_narx_pool(data, profile, lags, degree)
        if pool is not None and len(pool) > terms:
            name = f"degree {degree}, {terms} terms, lags up to {lags}"
            yield "polynomial NARX", [name], _method(pool, terms, Global())


def _local(
    data: Dataset, profile: DataProfile, lags: int
) -> Iterator[tuple[str, list[str], Identification]]:
    """Affine local models over inputs and the last output."""
    pool = make_narx_pool(data, profile, lags, 1)
    assert pool is not None
    over = [
        f"{n}[t-{d}]" if d else f"{n}[t]"
        for n, d in zip(data.channels.input_names, profile.dead_time, strict=True)
    ]
    for models in (3, 6):
        scheduling = [*over, f"{profile.output}[t-1]"]
        method = Lolimot(scheduling, max_models=models)
        name = f"{models} models, lags up to {lags}"
        yield "LOLIMOT", [name], _method(pool, len(pool), method)


def make_narx_pool(
    data: Dataset, profile: DataProfile, lags: int, degree: int
) -> Pool | None:
    """Inputs from their dead time on and outputs, all products; None if too many.

    An input that seems to act late has its last sample in place of the oldest: a dead
    time is an estimate.
    """
    names = data.channels.input_names
    variables = len(names) * (lags + 1) + lags
    if math.comb(variables + degree, degree) > LARGEST_POOL and degree > 1:
        return None
    return polynomial_pool(
        data.channels,
        outputs=[profile.output],
        input_lags={
            n: range(d, d + lags + 1) if d < 2 else (1, *range(d, d + lags))
            for n, d in zip(names, profile.dead_time, strict=True)
        },
        output_lags=range(1, lags + 1),
        degree=degree,
    )


def _method(pool: Pool, terms: int, grow) -> Identification:
    refine = SimulationError(
        horizons=WINDOW_HORIZONS, window_steps=8, max_steps=20, train="coefficients"
    )
    return Identification(
        pool=pool, select=ForwardOLS(max_terms=terms), grow=grow, refine=refine
    )
