"""All answers of the outputs to the inputs at once, coarsely: where fits begin."""

import numpy as np
from jaxtyping import Float

from jaxnarx.data.pieces import Piece

_RIDGE = 1e-6
_LONGEST = 1024
"""Largest lag looked at [samples]."""


def joint_response(
    parts: list[Piece], reach: int
) -> list[Float[np.ndarray, "inputs outputs _"]]:
    """What each input contributes to each output, for every piece.

    One least-squares problem for all inputs, so that what correlated inputs have in
    common is divided among them: impulse responses that are constant between the lags
    0, 1, 2, 3, 4, 6, 8, 11, 16, ... Only rows from `reach` on count, without their mean
    in each piece. Zeros where there are fewer than ten rows for a coefficient.
    """
    edges = _edges(min(max(len(p) for p in parts) // 4, _LONGEST))
    inputs, bins = len(parts[0].u), len(edges) - 1
    rows = sum(len(p) - reach for p in parts)
    if not inputs or rows < 10 * inputs * bins:
        return [np.zeros((inputs, *p.y.shape)) for p in parts]
    gram = np.zeros((inputs * bins,) * 2)
    cross = np.zeros((inputs * bins, len(parts[0].y)))
    for part in parts:
        x = _binned(part.u, edges).reshape(inputs * bins, -1)[:, reach:]
        x = x - x.mean(axis=1, keepdims=True)
        gram += x @ x.T
        cross += x @ part.y[:, reach:].T
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    alive = np.diag(gram) > 1e-9 * rows
    scale = np.where(alive, 1 / scale, 0.0)
    gram = gram * scale[:, None] * scale[None] + _RIDGE * np.eye(len(gram))
    theta = scale[:, None] * np.linalg.solve(gram, scale[:, None] * cross)
    theta = theta.reshape(inputs, bins, -1)
    return [np.einsum("ibo,ibt->iot", theta, _binned(p.u, edges)) for p in parts]


def _edges(longest: int) -> list[int]:
    steps = (round(2 ** (k / 2)) for k in range(2, 2 * longest.bit_length()))
    return [0, 1, *dict.fromkeys(s for s in steps if s <= max(longest, 2))]


def _binned(
    u: Float[np.ndarray, "inputs time"], edges: list[int]
) -> Float[np.ndarray, "inputs bins time"]:
    """Means over spans of lags; before its beginning every input was at rest."""
    longest, n = edges[-1], u.shape[1]
    begin = np.repeat(u[:, :1], longest, axis=1)
    total = np.cumsum(np.concatenate([0 * u[:, :1], begin, u], axis=1), axis=1)
    spans = zip(edges[:-1], edges[1:], strict=True)
    means = [
        (total[:, longest - a + 1 :][:, :n] - total[:, longest - b + 1 :][:, :n])
        / (b - a)
        for a, b in spans
    ]
    return np.stack(means, axis=1)
