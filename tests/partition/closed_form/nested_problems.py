"""Small records and nested regions for the tests of shared feedback.

Input `a` has many levels around 1000, `b` two, and the output stands far from zero.
"""

from functools import cache

import numpy as np

from jaxnarx.data import Dataset
from jaxnarx.partition.closed_form.design_matrix import BlockDesign, gates_on_path
from jaxnarx.partition.closed_form.growth import Box
from jaxnarx.partition.closed_form.signals import RunSignals, make_signals
from jaxnarx.regressors import LowPass, Pool, Variables, polynomial_pool

SAMPLE_TIME = 0.1
LENGTHS = 170, 150, 190, 160
LABELS = 0, 1, 0, 2
"""Groups of the records."""
A_INPUT, B_INPUT, OUTPUT = range(3)
"""RunSignals."""
LONGEST = 4
"""Largest lag of the pools below."""
FEEDBACK = np.array([1.0, -1.2, 0.45])
"""A pair of complex poles."""


def levels(rng: np.random.Generator, rows: int, hold: int) -> np.ndarray:
    """Steps of random height, 0 to 1."""
    return np.repeat(rng.uniform(size=rows // hold + 1), hold)[:rows]


def inputs(rng: np.random.Generator, rows: int) -> np.ndarray:
    """`a` and `b`."""
    a = 1000 + 4 * levels(rng, rows, 7) + 0.5 * rng.normal(size=rows)
    return np.stack([a, (levels(rng, rows, 11) > 0.5) * 1.0], axis=1)


@cache
def records() -> Dataset:
    """Four records of a system that no model of the tests makes exactly."""
    rng = np.random.default_rng(11)
    us = [inputs(rng, n) for n in LENGTHS]
    ys = []
    for u in us:
        y, x = np.zeros(len(u)), (u[:, 0] - 1002) / 2
        for t in range(2, len(u)):
            part = np.tanh(2 * x[t - 1]) + u[t - 1, 1] * x[t - 2]
            y[t] = 1.1 * y[t - 1] - 0.4 * y[t - 2] + part
        ys.append((300 + y + 0.5 * rng.normal(size=len(u)))[:, None])
    return dataset(us, ys)


def dataset(us, ys) -> Dataset:
    """Records of `a` and `b`, or as many inputs as there are."""
    names = ["a", "b"][: us[0].shape[1]]
    return Dataset.from_arrays(
        us, ys, inputs=names, outputs=["y"], sample_time=SAMPLE_TIME
    )


def pool() -> Pool:
    """Lags and a filter, and products of `a` with itself."""
    found = polynomial_pool(
        records().channels,
        input_lags={"a": (1, LONGEST), "b": (2,)},
        output_lags=(),
        degree=2,
        filters={"a": [LowPass(0.5)]},
    )
    rows = found.factor.tolist()  # variables a[t-1], a[t-4], b[t-2], lp(a)[t]
    keep = [n for n, row in enumerate(rows) if 0 in row or 3 not in row]
    return Pool(found.variables, found.factor[keep], found.channels, found.outputs)


SCHEDULING = Variables.of(
    [(A_INPUT, 1, None), (B_INPUT, 2, None), (A_INPUT, 0, LowPass(0.5))]
)


def labels(numbers=LABELS, data: Dataset | None = None) -> list[np.ndarray]:
    """Of whole records."""
    data = records() if data is None else data
    return [np.full(len(r), g) for r, g in zip(data, numbers, strict=True)]


@cache
def signals(every: int = 1) -> RunSignals:
    """What the dictionaries below are made of."""
    return make_signals(
        records(),
        pool(),
        SCHEDULING,
        labels(),
        np.eye(1 + max(LABELS), dtype=bool),
        history=LONGEST,
        every=every,
    )


def whole(dims: int) -> Box:
    """The root."""
    return Box((), np.zeros(dims), np.ones(dims))


@cache
def leaves() -> tuple[Box, ...]:
    """Halved across `a`, one half between the levels of `b`, another once more."""
    root = whole(3)
    upper, lower = _halved(root, 0)
    high, low = _halved(lower, 1, (0.0, 1.0))
    right, left = _halved(upper, 0)
    above, below = _halved(right, 2)
    return high, low, left, above, below


def _halved(leaf: Box, dim: int, at=None) -> tuple[Box, Box]:
    gate = leaf.gate(dim, at)
    assert gate is not None
    return leaf.halve(gate)


@cache
def nested(regions: int = 5) -> BlockDesign:
    """The root's columns and those of the upper half of every halving."""
    made = signals()
    found = BlockDesign.of(made, FEEDBACK)
    found = found.extend(found.block(()))
    if regions == 1:
        return found
    every = sorted(
        {leaf.region[: n + 1] for leaf in leaves() for n in range(len(leaf.region))},
        key=len,
    )
    for n, region in enumerate(
        r for r in every for g, _ in gates_on_path(r[-1:]) if g.side > 0
    ):
        # Blocks of regions may hold some of the terms alone.
        terms = np.arange(n % 2, len(made.factor))
        found = found.extend(found.block(region, terms))
    return found


def coefficients(found: BlockDesign, size: float = 0.1, seed: int = 0) -> np.ndarray:
    """Random ones, whose run stays within a few standard deviations."""
    columns = np.concatenate(found.rows(), axis=1)
    spread = np.maximum(columns.std(axis=1), 1e-9)
    return size * np.random.default_rng(seed).normal(size=len(columns)) / spread


def plant(change=None, lengths=LENGTHS, seed: int = 0) -> Dataset:
    """First order with a gain that bends, `b` binary; `change` makes (u, y) of it from
    a generator, u and y."""
    rng = np.random.default_rng(seed)
    us, ys = [], []
    for n in lengths:
        u = np.stack([2 * levels(rng, n, 7) - 1, levels(rng, n, 11) > 0.5], axis=1)
        y = np.zeros(n)
        for t in range(1, n):
            y[t] = 0.8 * y[t - 1] + np.tanh(2 * u[t - 1, 0]) + 0.3 * u[t - 1, 1]
        y += 0.02 * rng.normal(size=n)
        u, y = (u, y) if change is None else change(rng, u, y)
        us.append(u)
        ys.append(y[:, None])
    return dataset(us, ys)
