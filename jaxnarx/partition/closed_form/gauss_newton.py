"""Feedback and gates moved together with the coefficients, by Gauss-Newton.

The derivative of the free run y by a_i is -q^-i y / A; by a gate's border or steepness
it is what the region's weights change, filtered by 1/A:

    d y / d g = [sum_b (d w_b / d g) sum_k theta[b, k] p_k] / A .

Coefficients are solved for anew at every point, so a step moves the others to where
they are best together with them (variable projection, Golub and Pereyra 1973).
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from jaxnarx.arrays import ridge_solve
from jaxnarx.partition.closed_form.denominator import is_stable, limit_poles
from jaxnarx.partition.closed_form.design_matrix import (
    BlockDesign,
    Gate,
    Place,
    gates_on_path,
    weight,
)
from jaxnarx.partition.closed_form.signals import Stretch
from jaxnarx.regressors import evaluate

MOST_STEPS, MOST_HALVINGS = 8, 6
LEAST_GAIN = 2e-3
"""Share of the loss that a step must bring to be followed by another."""
LARGEST_MOVE = 0.1, 0.5
"""Most that a step moves a border, in ranges, and the logarithm of a steepness."""
NEVER_BEYOND = 0.02, 0.98
"""Margin within which borders stay, in ranges."""
STEP_RIDGE = 1e-3
"""Ridge of a step, in units of the columns' own power."""


def move_feedback_and_gates(
    design: BlockDesign, ridge: float, *, steps: int = MOST_STEPS, gates: bool = False
) -> tuple[BlockDesign, float]:
    """The same columns where feedback (and gates) are best; the mean squared error.

    Steps are halved until A is stable and the loss is lower. Gates between the levels
    of a variable with few of them stay.
    """
    loss = _loss(design, ridge)
    for _ in range(steps):
        better = _better(design, loss, ridge, gates)
        if better is None and gates:
            better = _better(design, loss, ridge, False)
        if better is None:
            break
        design, gain, loss = better[0], 1 - better[1] / loss, better[1]
        if gain < LEAST_GAIN:
            break
    return design, loss


def _better(design: BlockDesign, loss: float, ridge: float, gates: bool):
    places = movable_gates(design) if gates else []
    step = _step(design, ridge, places)
    order = len(design.a) - 1
    if not step.size:
        return None
    for halving in range(MOST_HALVINGS):
        own = 0.5**halving * step
        a = design.a.copy()
        a[1:] += own[:order]
        a = limit_poles(a, design.signals.largest_pole)
        if is_stable(a):
            tried = design.move(a, shift_gates(places, own[order:]))
            after = _loss(tried, ridge)
            if after < loss:
                return tried, after
    return None


def movable_gates(design: BlockDesign) -> list[Place]:
    """Every gate that may move, once."""
    found: dict[Place, None] = {}
    for block in design.blocks:
        for gate, place in gates_on_path(block.region):
            if not gate.hard:
                found.setdefault(place)
    return list(found)


def shift_gates(
    places: list[Place], step: Float[np.ndarray, " _"]
) -> dict[Place, Gate]:
    """Gates moved by changes of borders, then of logarithms of steepness."""
    count = len(places)
    out = {}
    for place, border, steep in zip(places, step[:count], step[count:], strict=True):
        gate = place[1]
        at = gate.border + float(np.clip(border, -LARGEST_MOVE[0], LARGEST_MOVE[0]))
        by = float(np.exp(np.clip(steep, -LARGEST_MOVE[1], LARGEST_MOVE[1])))
        out[place] = dataclasses.replace(
            gate,
            border=float(np.clip(at, *NEVER_BEYOND)),
            steepness=gate.steepness * by,
        )
    return out


def _loss(design: BlockDesign, ridge: float) -> float:
    own = design.equations
    theta = own.exclude_group(None).solve(ridge)
    total = sum(own.loss(g, theta) for g in range(len(own)))
    return total / max(own.samples.sum(), 1.0)


def _step(
    design: BlockDesign, ridge: float, places: list[Place]
) -> Float[np.ndarray, " _"]:
    """Change of A's coefficients, borders and steepness by one Gauss-Newton step."""
    theta = design.equations.exclude_group(None).solve(ridge)
    moves = derivatives(design, theta, places)
    count = len(design.a) - 1 + 2 * len(places)
    if not count:
        return np.zeros(0)
    size = len(theta) + count
    gram, right = np.zeros((size, size)), np.zeros(size)
    for columns, by, target in zip(design.rows(), moves, design.target, strict=True):
        every = np.concatenate([columns, by])
        gram += every @ every.T
        right += every @ (target - theta @ columns)
    pull = np.where(np.arange(size) < size - 2 * len(places), 1e-9, STEP_RIDGE)
    return ridge_solve(gram, right, pull)[-count:]


def derivatives(
    design: BlockDesign, theta: Float[np.ndarray, " columns"], places: list[Place]
) -> list[Float[np.ndarray, "parameters _"]]:
    """Derivatives of the free run by a_1 ... a_n, borders and logarithms of steepness,
    where samples count, group by group."""
    runs, parts = design.runs(theta), []
    for one, run in zip(design.signals.stretches, runs, strict=True):
        rows = np.concatenate(
            [
                -one.lags(run, len(design.a) - 1),
                _turns(design, theta, one, places),
            ]
        )
        moved = one.filter_columns(rows, design.a) if len(rows) else rows
        parts.append([moved[:, at] for at in one.counted])
    return [np.concatenate(own, axis=1) for own in zip(*parts, strict=True)]


def _turns(
    design: BlockDesign, theta: np.ndarray, one: Stretch, places: list[Place]
) -> np.ndarray:
    """Derivatives of the sum of all regions by borders, then by steepness."""
    count, edge = len(places), 0
    out = np.zeros((2 * count, len(one.y)))
    if not count:
        return out
    index = {place: n for n, place in enumerate(places)}
    for block in design.blocks:
        own = theta[edge : edge + len(block.terms)]
        edge += len(own)
        p = np.asarray(evaluate(design.signals.factor[block.terms], one.z))
        part = weight(block.region, one.x) * (own @ p)
        for gate, place in gates_on_path(block.region):
            if place not in index:
                continue
            slope = part * (1 - gate(one.x)) * gate.side * gate.steepness
            n = index[place]
            out[n] -= slope
            out[count + n] += slope * (one.x[gate.dim] - gate.border)
    return out
