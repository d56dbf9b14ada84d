"""The structure of `references.py`: partition, feedback, delay and terms by
cross-validation.

Nothing here sees a test record. Every choice is by the free run of training records
left out, which the closed form of `output_error.py` makes cheap.
"""

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np

import jaxnarx as jnx
from jaxnarx.models import scheduling_values

sys.path.insert(0, str(Path(__file__).resolve().parent))
from output_error import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    Boxes,
    Prepared,
    cross_validated,
    denominator,
    equations,
    network,
    whole,
)

INPUTS = ("speed", "load", "lambda", "ignition", "fuel_cutoff")
LAGS, TIME_CONSTANTS = (0, 4, 8, 12, 16, 24, 32), (1.0, 4.0, 16.0, 60.0)
FEEDBACK = ((0.5, 0.3), (0.7, 0.3), (1.2, 0.5), (2.0, 0.5), (6.0, 0.5), (8.0, 1.0))
"""Pairs of time constants of the common feedback [s]."""
DELAYS = (4, 0, 8, 12, 16)
"""Of products and scheduling [samples]; the first while the feedback is chosen."""
SIZES, RIDGES = (40, 60, 80, 110, 140, 180, 220, 260), (1e-4, 1e-3, 1e-2)
MODELS = 10
START = ((0, 4), (0, 1), (0, 0), (0, 1), (0, 1), (3, 1), (0, 1), (2, 3))
"""Region and input of every halving (the upper half becomes the last region) of the
partition that serves while feedback and delay are chosen. Found while exploring NOx."""
WIDTH, CUT_WIDTH = 0.5, 1 / 3
"""Width of a Gaussian as a share of its box: of inputs, and of fuel cut-off."""
THIN, FINE = 20, 5
"""Samples from one that counts to the next: in choices, and at the end."""


@dataclasses.dataclass(frozen=True)
class Choice:
    """One structure and what cross-validation makes of it."""

    feedback: tuple[float, float]
    delay: int
    splits: tuple[tuple[int, int], ...]
    size: int
    ridge: float
    score: float


def dealings(records: int) -> list[np.ndarray]:
    """Groups of records that are left out together, see the module's docstring."""
    half = records // 2
    series, place = np.divmod(np.arange(records), max(half, 1))
    return [np.minimum(series, 1), (place + 2 * series) % min(5, max(half, 2))]


def pool_of(data: jnx.Dataset, output: str, delay: int) -> jnx.Pool:
    """Linear terms of all variables, products of the four continuous inputs at a
    delay; the output's lags last."""
    pool = jnx.polynomial_pool(
        data.channels,
        outputs=[output],
        input_lags=LAGS,
        output_lags=(1, 2),
        degree=2,
        filters=[jnx.LowPass(tau) for tau in TIME_CONSTANTS],
    )
    entries = pool.variables.entries
    free = [
        n + 1
        for n, (signal, lag, filter_) in enumerate(entries)
        if lag == delay and filter_ is None and signal < len(INPUTS) - 1
    ]
    linear = pool.factor[:, 0] == 0
    own = linear | np.isin(pool.factor, free).all(axis=1)
    factor = pool.factor[own]
    fed = factor[:, 1] > len(entries) - 2
    return eqx.tree_at(lambda p: p.factor, pool, np.vstack([factor[~fed], factor[fed]]))


def scheduling(delay: int) -> list[str]:
    """All inputs at the delay."""
    at = f"t-{delay}" if delay else "t"
    return [f"{name}[{at}]" for name in INPUTS]


def validity(boxes: Boxes):
    """Gaussians of the boxes."""
    return boxes.gaussians(np.array([WIDTH] * (len(INPUTS) - 1) + [CUT_WIDTH]))


class Search:
    """Choices for one output; columns of a delay are formed once."""

    def __init__(self, train: jnx.Dataset, output: str, *, thin: int = THIN):
        self.train, self.output, self.thin = train, output, thin
        self.dealings = dealings(len(train))
        self.kept: dict[int, Prepared] = {}

    def empty(self, boxes: Boxes, feedback, delay: int) -> jnx.Network:
        """The structure, all coefficients but the feedback zero."""
        pool = pool_of(self.train, self.output, delay)
        a = denominator(feedback, self.train.sample_time)
        return network(pool, self.train, scheduling(delay), validity(boxes), a)

    def equations(self, boxes: Boxes, feedback, delay: int, thin: int | None = None):
        """Its normal equations."""
        net = self.empty(boxes, feedback, delay)
        if delay not in self.kept:
            self.kept[delay] = Prepared.of(net, self.train)
        a = denominator(feedback, self.train.sample_time)
        return equations(net, self.kept[delay], a, thin=thin or self.thin)

    def full(self, boxes: Boxes, feedback, delay: int) -> float:
        """Cross-validated error with all terms, the best of the ridges."""
        found = self.equations(boxes, feedback, delay)
        return min(float(cross_validated(found, self.dealings, r)[0]) for r in RIDGES)


def divided(splits: Sequence[tuple[int, int]]) -> Boxes:
    """The partition that these halvings make."""
    boxes = whole(len(INPUTS))
    for model, dim in splits:
        boxes = boxes.halved(model, dim)
    return boxes


def choose(search: Search, models: int = MODELS) -> tuple[Choice, list[dict[str, Any]]]:
    """Steps 1 to 3: the best structure, and the history of the growth."""
    feedback, delay = memory(search, divided(START))
    stages = grown(search, feedback, delay, models)
    tried = [
        choice
        for stage in stages
        for choice in sized(search, stage["splits"], feedback, delay)
    ]
    return min(tried, key=lambda one: one.score), stages


def memory(search: Search, boxes: Boxes) -> tuple[tuple[float, float], int]:
    """Feedback and delay, one after the other."""
    delay = DELAYS[0]
    scores = {f: search.full(boxes, f, delay) for f in FEEDBACK}
    feedback = min(scores, key=scores.__getitem__)
    by_delay = {d: search.full(boxes, feedback, d) for d in DELAYS[1:]}
    by_delay[delay] = scores[feedback]
    return feedback, min(by_delay, key=by_delay.__getitem__)


def grown(search: Search, feedback, delay: int, models: int) -> list[dict[str, Any]]:
    """The stages of the growth: the splits so far and what they score."""
    splits = START[:1]
    score = search.full(divided(splits), feedback, delay)
    stages = [{"models": 2, "score": score, "splits": splits}]
    while stages[-1]["models"] < models:
        splits = stages[-1]["splits"]
        tried = []
        for model in worst(search, divided(splits), feedback, delay):
            for dim in range(len(INPUTS) - 1):
                new = (*splits, (model, dim))
                tried.append((search.full(divided(new), feedback, delay), new))
        score, splits = min(tried)
        stages.append({"models": len(splits) + 1, "score": score, "splits": splits})
        print(search.output, len(splits) + 1, f"{score:.4f}", splits[-1], flush=True)
    return stages


def worst(
    search: Search, boxes: Boxes, feedback, delay: int, count: int = 2
) -> list[int]:
    """Regions with the largest sum of squared errors, weighted by validity.

    The cut-off region is not divided.
    """
    found = search.equations(boxes, feedback, delay)
    theta = found.solve(np.ones(len(search.train), bool), RIDGES[0])
    net = filled(search, boxes, feedback, delay, theta)
    loss = region_losses(net, search.train, search.kept[delay], search.thin)
    loss[boxes.low[:, -1] > 0] = -np.inf
    return np.argsort(-loss)[:count].tolist()


def region_losses(
    net: jnx.Network, data: jnx.Dataset, prepared: Prepared, thin: int
) -> np.ndarray:
    """Sum over samples of validity times squared free-run error, by region."""
    (o,), (model,) = net.modelled, net.models
    run = jnx.simulate(net, data).value
    total = np.zeros(model.active.shape[0])
    for n, one in enumerate(data):
        at = np.flatnonzero(run.scored[n][:, 0])[::thin]
        z = scheduling_values(model, prepared.drive.x[0][n][:, at])
        error = one.y[at, o] - run.outputs[n][at, 0]
        total += np.asarray(model.validity(z, model.active)) @ error**2
    return total


def filled(search: Search, boxes: Boxes, feedback, delay: int, theta) -> jnx.Network:
    """The network with these coefficients; terms without one are left out."""
    pool = pool_of(search.train, search.output, delay)
    a = denominator(feedback, search.train.sample_time)
    table = theta.reshape(len(boxes.low), -1)
    return network(
        pool, search.train, scheduling(delay), validity(boxes), a, table, sparse=True
    )


def sized(search: Search, splits, feedback, delay: int) -> list[Choice]:
    """All numbers of terms and ridges on this partition."""
    boxes, tried = divided(splits), []
    found = search.equations(boxes, feedback, delay)
    first = constants(found, boxes)
    for ridge in RIDGES:
        figures = cross_validated(found, search.dealings, ridge, SIZES, first)
        for size, score in zip(SIZES, figures.tolist(), strict=True):
            tried.append(Choice(feedback, delay, splits, size, ridge, score))
    return tried


def constants(found, boxes: Boxes) -> list[int]:
    """Columns of the regions' constants, which are always there."""
    models = len(boxes.low)
    return [m * (found.right.shape[1] // models) for m in range(models)]


def closed(search: Search, chosen: Choice) -> jnx.Network:
    """Step 4 before the refinement: coefficients from all training records."""
    boxes = divided(chosen.splits)
    found = search.equations(boxes, chosen.feedback, chosen.delay, FINE)
    rows = np.ones(len(search.train), bool)
    first = constants(found, boxes)
    order = found.forward(rows, chosen.ridge, chosen.size, first)
    theta = found.solve(rows, chosen.ridge, order)
    return filled(search, boxes, chosen.feedback, chosen.delay, theta)
