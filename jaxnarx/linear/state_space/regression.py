"""B, D, offsets and starting states of a state-space model, given its A and C.

The free run is linear in them. With B_j the effect of input j on the states and c_o a
row of C its output o is

    y_o(t) = c_o A^t x(0) + sum_j q_oj(t) B_j + D_o u(t) + d_o,
    q_oj(t+1) = q_oj(t) A + c_o u_j(t),     q_oj(0) = 0,

so that all columns are one recursion of few rows. Records share everything but x(0):
after the triangle of one record's rows, [x(0) | the rest | y], its first rows tell x(0)
once the rest is known, and only those below go on to the triangle of all. Any number of
records costs no more unknowns than one.

Reference: M. Verhaegen, V. Verdult, Filtering and System Identification, Cambridge
2007, where B, D and x(0) are found from the simulated output likewise.
"""

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from jaxnarx.arrays import ROWS_AT_ONCE, accumulate
from jaxnarx.linear.state_space.model import recursion

COLUMN_RIDGE = 1e-10
"""Ridge on columns of unit norm: what no output tells stays small."""
START_SPREAD = 3.0
"""Standard deviation of starting states over the one that is known of states."""


@dataclasses.dataclass(frozen=True, eq=False)
class Segment:
    """Samples in a row of one record."""

    record: int
    u: Float[np.ndarray, "time inputs"]
    y: Float[np.ndarray, "time outputs"]


@dataclasses.dataclass(frozen=True, eq=False)
class StateRegression:
    """Matrices of a state-space model found by regression; `starts` has the state at
    every piece's first sample."""

    b: Float[np.ndarray, "states inputs"]
    state_offset: Float[np.ndarray, " states"]
    d: Float[np.ndarray, "outputs inputs"]
    output_offset: Float[np.ndarray, " outputs"]
    starts: Float[np.ndarray, "pieces states"]


def regress(
    a: Float[np.ndarray, "states states"],
    c: Float[np.ndarray, "outputs states"],
    pieces: Sequence[Segment],
    *,
    prior: Float[np.ndarray, " states"],
    feedthrough: bool,
    integrating: bool,
) -> StateRegression:
    """Least squares of the simulation error of all pieces, with a small ridge.

    Signals are scaled to about one. `prior` is the standard deviation of the noise over
    that of every state: starting states that a short or noisy piece does not tell stay
    near zero, the mean. An offset of the states counts only when they are
    `integrating`: else starting states and the output's offset hold it already.
    """
    n, (outputs, inputs) = len(a), (len(c), pieces[0].u.shape[1])
    driven, direct = inputs + integrating, inputs * feedthrough + 1
    width = n + n * driven + outputs * direct + 1
    heads, tails, square = [], [], np.zeros(width)
    for piece in pieces:
        rows = _rows(a, c, piece, driven=driven, direct=direct)
        r = accumulate(rows, width)
        norm = np.sum(r**2, axis=0)
        square += norm
        known = np.zeros((n, width))
        known[:, :n] = np.diag(
            np.hypot(prior / START_SPREAD, np.sqrt(COLUMN_RIDGE * norm[:n]))
        )
        r = accumulate([r, known], width)
        heads.append(r[:n])
        tails.append(r[n:, n:])
    theta = _ridge(accumulate(tails, width - n), square[n:-1])
    starts = [_start(head, theta) for head in heads]
    effects = theta[: n * driven].reshape(driven, n).T
    rest = theta[n * driven :].reshape(outputs, direct)
    return StateRegression(
        effects[:, :inputs],
        effects[:, -1] if integrating else np.zeros(n),
        rest[:, :-1] if feedthrough else np.zeros((outputs, inputs)),
        rest[:, -1],
        np.stack(starts),
    )


def _rows(a, c, piece: Segment, *, driven: int, direct: int) -> Iterator[np.ndarray]:
    """[x(0) | B by input | D and d by output | y] of every sample and output."""
    (outputs, n), time = c.shape, len(piece.y)
    signals = np.column_stack([piece.u, np.ones(time)])
    # The first row of the recursion is the starting state's, which nothing drives.
    drive = np.column_stack([np.zeros(time), signals[:, :driven]])
    through = signals[:, signals.shape[1] - direct :]
    q = np.zeros((outputs, 1 + driven, n))
    q[:, 0] = c
    block = max(ROWS_AT_ONCE // outputs, 1)
    for k in range(0, time, block):
        part = slice(k, k + block)
        force = np.einsum("tm,on->tomn", drive[part], c)
        run = recursion(a, force.reshape(len(force), -1, n), q.reshape(-1, n))
        q = run[-1].reshape(q.shape)
        now = np.einsum("ti,op->topi", through[part], np.eye(outputs))
        shape = (len(force), outputs, -1)
        columns = run[:-1].reshape(shape), now.reshape(shape), piece.y[part, :, None]
        yield np.concatenate(columns, axis=2).reshape(len(force) * outputs, -1)


def _ridge(r: Float[np.ndarray, "rows columns"], square: Float[np.ndarray, " params"]):
    """Coefficients of the last column of `r`; `square` are the norms of the others."""
    norm = np.sqrt(np.where(square > 0, square, 1.0))
    params = len(norm)
    left = np.concatenate(
        [r[:, :-1] / norm[None], np.sqrt(COLUMN_RIDGE) * np.eye(params)]
    )
    right = np.concatenate([r[:, -1], np.zeros(params)])
    return np.linalg.lstsq(left, right, rcond=None)[0] / norm


def _start(head: Float[np.ndarray, "states _"], theta: Float[np.ndarray, " params"]):
    """The starting state of a piece, by the first rows of its triangle."""
    n = len(head)
    return np.linalg.lstsq(
        head[:, :n], head[:, -1] - head[:, n:-1] @ theta, rcond=None
    )[0]
