"""The common feedback: chosen from a grid on linear terms, tuned by Gauss-Newton."""

import numpy as np
import scipy.signal
from jaxtyping import Float

from jaxnarx.output_error.denominator import is_stable
from jaxnarx.output_error.dictionary import Dictionary

STEPS, HALVINGS = 8, 6
ENOUGH = 2e-3
"""Share of the loss that a step must bring to be followed by another."""


def tuned(
    dictionary: Dictionary, ridge: float, *, steps: int = STEPS
) -> tuple[Dictionary, float]:
    """The same columns with the best A(q) near the present one; mean squared error.

    Gauss-Newton on the coefficients of A and of the columns together: the derivative of
    the run by a_i is -q^-i y / A. Steps are halved until they are stable and lower the
    loss.
    """
    loss = _loss(dictionary, ridge)
    for _ in range(steps):
        better = _better(dictionary, loss, ridge)
        if better is None:
            break
        dictionary, gain, loss = better[0], 1 - better[1] / loss, better[1]
        if gain < ENOUGH:
            break
    return dictionary, loss


def _better(dictionary: Dictionary, loss: float, ridge: float):
    step = _step(dictionary, ridge)
    for halving in range(HALVINGS):
        a = dictionary.a.copy()
        a[1:] += 0.5**halving * step
        if is_stable(a):
            tried = dictionary.moved(a)
            after = _loss(tried, ridge)
            if after < loss:
                return tried, after
    return None


def _loss(dictionary: Dictionary, ridge: float) -> float:
    own = dictionary.equations
    theta = own.without(None).solve(ridge)
    total = sum(own.loss(g, theta) for g in range(len(own)))
    return total / max(own.samples.sum(), 1.0)


def _step(dictionary: Dictionary, ridge: float) -> Float[np.ndarray, " order"]:
    """Change of A's coefficients by one Gauss-Newton step on everything."""
    theta = dictionary.equations.without(None).solve(ridge)
    moves = _moves(dictionary, dictionary.runs(theta))
    n, size = len(dictionary.a) - 1, len(theta) + len(dictionary.a) - 1
    gram, right = np.zeros((size, size)), np.zeros(size)
    for columns, by, target in zip(
        dictionary.rows(), moves, dictionary.target, strict=True
    ):
        every = np.concatenate([columns, by])
        gram += every @ every.T
        right += every @ (target - theta @ columns)
    scale = np.sqrt(np.maximum(np.diagonal(gram), 1e-300))
    system = gram / np.outer(scale, scale) + 1e-9 * np.eye(size)
    return (np.linalg.solve(system, right / scale) / scale)[-n:]


def _moves(dictionary: Dictionary, runs: list[np.ndarray]) -> list[np.ndarray]:
    """Derivatives of the free run by a_1 ... a_n where samples count, by group."""
    a, parts = dictionary.a, []
    for one, run in zip(dictionary.signals.stretches, runs, strict=True):
        n = len(a) - 1
        past = np.concatenate([one.before[:n][::-1], run])
        shifted = np.stack([past[n - i : n - i + len(run)] for i in range(1, n + 1)])
        moved = -np.asarray(scipy.signal.lfilter([1.0], a, shifted))
        parts.append([moved[:, at] for at in one.counted])
    return [np.concatenate(own, axis=1) for own in zip(*parts, strict=True)]
