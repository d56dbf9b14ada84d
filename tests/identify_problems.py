"""Small engines, fleets and settings for the tests of the fused identification."""

import dataclasses

import numpy as np

from jaxnarx.data import Dataset, Fleet
from jaxnarx.settings import (
    ForwardOLS,
    Identification,
    Lolimot,
    Polynomial,
    SimulationError,
)
from jaxnarx.settings.tree import replace_at

METHOD = Identification(
    pool=Polynomial(input_lags=(0, 1), output_lags=(1, 2), degree=2),
    select=ForwardOLS(max_terms=5),
    grow=Lolimot(["a[t-1]"], max_models=3, criterion="none"),
    # Without a tolerance every search makes all its steps.
    refine=SimulationError(horizons=(), window_steps=5, max_steps=3, tolerance=0),
)
SMALL = replace_at(
    METHOD, {"select.max_terms": 3, "grow.max_models": 2, "refine.max_steps": 2}
)
CASES = [
    {
        "select.max_terms": 4,
        "grow.max_models": 2,
        "refine.ridge": 1e-4,
        "grow.k_sigma": 0.4,
    },
    {"refine.train": "coefficients", "refine.max_steps": 2, "grow.ridge": 1e-3},
]


def engine(seed: int, lengths=(90, 70, 70), scale: float = 1.0) -> Dataset:
    """A second-order process with a bent gain; a record for every part.

    Inputs of the later records are `scale` times as large.
    """
    rng = np.random.default_rng(seed)
    pole = 0.5 + 0.2 * rng.uniform()
    us, ys = [], []
    for n, length in enumerate(lengths):
        u = np.repeat(rng.uniform(-1, 1, (length // 5 + 1, 2)), 5, axis=0)[:length]
        u = u * (scale if n else 1.0)
        y = np.zeros(length)
        for t in range(2, length):
            bent = np.tanh(2 * u[t - 1, 0]) + 0.3 * u[t - 1, 1] ** 2
            y[t] = pole * y[t - 1] - 0.1 * y[t - 2] + bent
        us.append(u)
        ys.append((y + 0.02 * rng.normal(size=length))[:, None])
    return Dataset.from_arrays(
        us, ys, inputs=["a", "b"], outputs=["y"], sample_time=0.1
    )


def replaced(data: Dataset, record: int, **fields) -> Dataset:
    """With other arrays in one record, unchecked."""
    records = list(data.records)
    records[record] = dataclasses.replace(records[record], **fields)
    return dataclasses.replace(data, records=tuple(records))


def fleet_of(datasets: dict) -> Fleet:
    """The first record trains, the second judges, the third tests."""
    return Fleet.from_datasets(datasets, train=[0], validation=[1], test=[2])


def parts(data: Dataset) -> tuple[Dataset, Dataset, Dataset]:
    """The same parts of one dataset."""
    return data[0], data[1], data[2]
