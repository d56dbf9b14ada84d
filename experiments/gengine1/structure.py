"""The structure of `references.py`: partition, feedback, delay and terms by
cross-validation.

Nothing here sees a test record. Every choice is by the free run of training records
left out, which the closed form of `output_error.py` makes cheap.
"""

import dataclasses
import sys
from pathlib import Path

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
LAGS, TIME_CONSTANTS = (0, 4, 8, 16), (1.0, 4.0, 16.0, 60.0)
FEEDBACK = ((0.5, 0.3), (0.7, 0.3), (1.2, 0.5), (2.0, 0.5), (6.0, 0.5), (8.0, 1.0))
"""Pairs of time constants of the common feedback [s]."""
DELAYS = (4, 0, 8)
"""Of products and scheduling [samples]; the first while the feedback is chosen."""
SIZES, RIDGES = (80, 110, 140, 180, 220), (1e-4, 1e-3, 1e-2)
GUIDE, GUIDE_FEEDBACK, MODELS = "NOx", (0.7, 0.3), 9
SPLITS = ((0, 4), (0, 1), (0, 0), (0, 1), (0, 1), (3, 1), (0, 1), (2, 3))
"""Region and input of every halving; the upper half becomes the last region."""
WIDTH, CUT_WIDTH = 0.5, 1 / 3
"""Width of a Gaussian as a share of its box: of inputs, and of fuel cut-off."""
THIN, FINE = 20, 5
"""Samples from one that counts to the next: in choices, and at the end."""


@dataclasses.dataclass(frozen=True)
class Choice:
    """One structure and what cross-validation makes of it."""

    feedback: tuple[float, float]
    delay: int
    size: int
    ridge: float
    score: float


def dealings(records: int) -> list[np.ndarray]:
    """Groups of records that are left out together, see the module's docstring."""
    half = records // 2
    series, place = np.divmod(np.arange(records), max(half, 1))
    return [np.minimum(series, 1), (place + 2 * series) % min(5, max(half, 2))]


def pool_of(data: jnx.Dataset, output: str, delay: int, memory: bool) -> jnx.Pool:
    """Linear terms of all variables, products of the four continuous inputs at a
    delay; the output's lags last. Without `memory` the inputs at the delay alone."""
    pool = jnx.polynomial_pool(
        data.channels,
        outputs=[output],
        input_lags=LAGS if memory else (delay,),
        output_lags=(1, 2),
        degree=2,
        filters=[jnx.LowPass(tau) for tau in TIME_CONSTANTS] if memory else (),
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

    def __init__(
        self, train: jnx.Dataset, output: str, *, memory: bool = True, thin: int = THIN
    ):
        self.train, self.output, self.thin = train, output, thin
        self.memory = memory
        self.dealings = dealings(len(train))
        self.kept: dict[int, Prepared] = {}

    def empty(self, boxes: Boxes, feedback, delay: int) -> jnx.Network:
        """The structure, all coefficients but the feedback zero."""
        pool = pool_of(self.train, self.output, delay, self.memory)
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


def given() -> Boxes:
    """The partition of `SPLITS`."""
    boxes = whole(len(INPUTS))
    for model, dim in SPLITS:
        boxes = boxes.halved(model, dim)
    return boxes


def grown(search: Search, models: int) -> tuple[Boxes, list[dict]]:
    """The partition that the rule of step 1 finds, and its history."""
    boxes = whole(len(INPUTS)).halved(*SPLITS[0])
    stages = [(search.full(boxes, GUIDE_FEEDBACK, DELAYS[0]), boxes, SPLITS[0])]
    while len(stages[-1][1].low) < models:
        boxes = stages[-1][1]
        tried = []
        for model in worst(search, boxes):
            for dim in range(len(INPUTS) - 1):
                new = boxes.halved(model, dim)
                score = search.full(new, GUIDE_FEEDBACK, DELAYS[0])
                tried.append((score, new, (model, dim)))
        stages.append(min(tried, key=lambda one: one[0]))
        print(len(stages[-1][1].low), f"{stages[-1][0]:.4f}", stages[-1][2], flush=True)
    best = min(stages, key=lambda one: one[0])
    rows = [{"models": len(b.low), "score": s, "split": w} for s, b, w in stages]
    return best[1], rows


def worst(search: Search, boxes: Boxes, count: int = 2) -> list[int]:
    """Regions with the largest sum of squared errors, weighted by validity.

    The cut-off region is not divided.
    """
    found = search.equations(boxes, GUIDE_FEEDBACK, DELAYS[0])
    rows = np.ones(len(search.train), bool)
    theta = found.solve(rows, RIDGES[0])
    net = filled(search, boxes, GUIDE_FEEDBACK, DELAYS[0], theta)
    loss = region_losses(net, search.train, search.kept[DELAYS[0]], search.thin)
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
    pool = pool_of(search.train, search.output, delay, search.memory)
    a = denominator(feedback, search.train.sample_time)
    table = theta.reshape(len(boxes.low), -1)
    return network(
        pool, search.train, scheduling(delay), validity(boxes), a, table, sparse=True
    )


def choose(search: Search, boxes: Boxes) -> Choice:
    """Steps 2 and 3."""
    delay = DELAYS[0]
    scores = {f: search.full(boxes, f, delay) for f in FEEDBACK}
    feedback = min(scores, key=scores.__getitem__)
    by_delay = {d: search.full(boxes, feedback, d) for d in DELAYS[1:]}
    by_delay[delay] = scores[feedback]
    delay = min(by_delay, key=by_delay.__getitem__)
    found = search.equations(boxes, feedback, delay)
    tried = []
    for ridge in RIDGES:
        first = constants(found, boxes)
        figures = cross_validated(found, search.dealings, ridge, SIZES, first)
        for size, score in zip(SIZES, figures.tolist(), strict=True):
            tried.append(Choice(feedback, delay, size, ridge, score))
    return min(tried, key=lambda one: one.score)


def constants(found, boxes: Boxes) -> list[int]:
    """Columns of the regions' constants, which are always there."""
    models = len(boxes.low)
    return [m * (found.right.shape[1] // models) for m in range(models)]


def closed(search: Search, boxes: Boxes, chosen: Choice) -> jnx.Network:
    """Step 4 before the refinement: coefficients from all training records."""
    found = search.equations(boxes, chosen.feedback, chosen.delay, FINE)
    rows = np.ones(len(search.train), bool)
    first = constants(found, boxes)
    order = found.forward(rows, chosen.ridge, chosen.size, first)
    theta = found.solve(rows, chosen.ridge, order)
    return filled(search, boxes, chosen.feedback, chosen.delay, theta)
