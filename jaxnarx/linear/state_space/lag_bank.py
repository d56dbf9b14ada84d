"""A bank of first-order lags to start from, for outputs of several inputs.

Subspace identification of many inputs over long records is costly, and its states mean
nothing. Here every state is a lag of its own time constant tau_k, driven by what least
squares combines of the inputs at their dead times d_j and a little later,

    x_k(t+1) = p_k x_k(t) + (1 - p_k) sum_j b_kj u_j(t - d_j) ,  p_k = exp(-T / tau_k) ,

and the output is the sum of the states. Dead times are found together, one input after
the other, by the error of a bank with products of the inputs: one input's answer alone
is easily taken for another's, and that to a product for none.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from jaxnarx.data import Dataset, hold, thin_records
from jaxnarx.errors import DataError
from jaxnarx.linear.state_space.model import StateSpace

LAGS_TRIED = (0, 1, 2, 3, 4, 5, 6, 8, 10, 13, 16, 20, 25, 32)
"""Dead times [samples] that are looked at."""
LATER_FACTOR = 2.0
"""The second sample of every input, behind its dead time, in fastest time constants."""
NEARLY_BEST_FACTOR = 1.05
"""Squared error, over that of the best dead time, that is nearly as good."""
BANK_RIDGE = 1e-3
"""Ridge of the least squares, as a share of every column's square."""
MOST_ROWS = 20_000
"""Samples, in stretches of all records, of the least squares."""
MOST_COLUMNS = 120
"""Columns up to which products of the inputs take part in the search of dead times."""
ROUNDS = 2
"""How often the dead time of every input is looked at."""
SHORTEST_TIMES = 4
"""Length of a stretch, in slowest time constants, where records are long enough."""
LEAST_STATE_SPREAD = 1e-6
"""Least standard deviation of a state before it is scaled to one."""

Delayed = tuple[tuple[int, int], ...]
"""Position and lag of every input of a model."""


def bank_model(
    data: Dataset, output: int, times: Sequence[float]
) -> tuple[StateSpace, Delayed]:
    """The model of one output, and the inputs that it is driven by, with their lags.

    `times` are the time constants [s], one for every state. DataError where the records
    are too short for the fastest of them.
    """
    dt, inputs = float(data.sample_time), len(data.channels.inputs)
    poles = np.exp(-dt / np.asarray(times, float))
    later = max(1, round(LATER_FACTOR * min(times) / dt))
    slow = round(max(times) / dt)
    some = thin_records(data, MOST_ROWS, SHORTEST_TIMES * slow)
    longest = max(map(len, some))
    tried = [lag for lag in LAGS_TRIED if lag + later < longest // 4] or [0]
    begin = min(max(tried[-1], slow), longest // 4)
    dead = choose_dead_times(_standardise(some, output, begin)[0], poles, tried)
    delayed = [(j, lag) for j in range(inputs) for lag in (dead[j], dead[j] + later)]
    every = -(-data.samples // MOST_ROWS)
    pieces, mean, spread = _standardise(data, output, max(dead) + later, every)
    columns, y = _columns(pieces, poles, delayed)
    share = _solve(columns, y)[0].reshape(len(poles), len(delayed))
    each = columns.reshape(len(y), len(poles), len(delayed))
    size = np.std(np.einsum("tkj,kj->tk", each, share), axis=0)
    size = np.maximum(size, LEAST_STATE_SPREAD)
    own = [j for j, _ in delayed]
    b = (1 - poles)[:, None] * share / size[:, None] / spread[own]
    model = StateSpace(
        a=np.diag(poles),
        b=b,
        state_offset=-b @ mean[own],
        c=size[None] * spread[-1],
        d=np.zeros((1, len(delayed))),
        output_offset=mean[-1:],
        start=np.zeros((len(data), len(poles))),
        singular=np.zeros(0),
    )
    return model, tuple(delayed)


def choose_dead_times(
    pieces: Sequence["ScaledRecord"],
    poles: Float[np.ndarray, " times"],
    tried: Sequence[int],
) -> list[int]:
    """Which lag of every input, together, explains most of the output.

    Of the lags nearly as good as the best it is the shortest: states can delay what
    comes too early, nothing can hasten what comes too late.
    """
    inputs = pieces[0].u.shape[1]
    square = inputs * (inputs + 3) // 2 * len(poles) <= MOST_COLUMNS
    dead = [tried[0]] * inputs
    for _ in range(ROUNDS):
        before = list(dead)
        for j in range(inputs):
            errors = []
            for lag in tried:
                delayed = [(i, lag if i == j else d) for i, d in enumerate(dead)]
                errors.append(_solve(*_columns(pieces, poles, delayed, square))[1])
            near = np.array(errors) <= NEARLY_BEST_FACTOR * min(errors)
            dead[j] = tried[int(np.argmax(near))]
        if before == dead:
            break
    return dead


@dataclasses.dataclass(frozen=True, eq=False)
class ScaledRecord:
    """A record, standardised; `counts` are samples at which everything is valid."""

    u: Float[np.ndarray, "time inputs"]
    y: Float[np.ndarray, " time"]
    counts: Int[np.ndarray, " rows"]


def _solve(
    columns: Float[np.ndarray, "rows columns"], y: Float[np.ndarray, " rows"]
) -> tuple[Float[np.ndarray, " columns"], float]:
    """Least squares with a small ridge, and the mean squared error."""
    gram = columns.T @ columns
    ridge = BANK_RIDGE * np.diag(np.maximum(np.diag(gram), 1e-12))
    theta = np.linalg.solve(gram + ridge, columns.T @ y)
    return theta, float(np.mean((columns @ theta - y) ** 2))


def _columns(
    pieces: Sequence[ScaledRecord],
    poles: Float[np.ndarray, " times"],
    delayed: Sequence[tuple[int, int]],
    square: bool = False,
) -> tuple[Float[np.ndarray, "rows columns"], Float[np.ndarray, " rows"]]:
    """All lags of the delayed inputs a sample before, one pole after the other, and the
    output; with products of two of them where they are to be `square`.

    Filters begin in the state that the first sample would have led to.
    """
    import scipy.signal

    first, second = np.triu_indices(len(delayed))
    found = []
    for piece in pieces:
        time = np.arange(len(piece.u))
        u = np.stack([piece.u[np.maximum(time - d, 0), j] for j, d in delayed], axis=1)
        if square:
            u = np.concatenate([u, u[:, first] * u[:, second]], axis=1)
        found.append(
            np.concatenate(
                [
                    scipy.signal.lfilter([1 - p], [1, -p], u, axis=0, zi=p * u[:1])[0][
                        piece.counts - 1
                    ]
                    for p in poles
                ],
                axis=1,
            )
        )
    y = np.concatenate([piece.y[piece.counts] for piece in pieces])
    columns = np.concatenate(found)
    return (columns - columns.mean(axis=0) if square else columns), y


def _standardise(
    data: Dataset, output: int, begin: int, every: int = 1
) -> tuple[
    list[ScaledRecord], Float[np.ndarray, " channels"], Float[np.ndarray, " channels"]
]:
    """The records, of which every so many samples from `begin` on count, and mean and
    standard deviation of the inputs and of the output behind them."""
    inputs = len(data.channels.inputs)
    held: list[np.ndarray] = []
    counts: list[np.ndarray] = []
    used = [*range(inputs), inputs + output]
    for record in data:
        valid = record.valid[:, used]
        both = np.concatenate([record.u, record.y[:, output : output + 1]], axis=1)
        at = np.flatnonzero(valid.all(axis=1))
        at = at[at >= max(begin, 1)][::every]
        if len(at):
            counts.append(at)
            held.append(hold(both, valid))
    if not held:
        raise DataError(
            f"no record has more than {begin} valid samples; too short for a bank of "
            "lags"
        )
    seen = np.concatenate([h[at] for h, at in zip(held, counts, strict=True)])
    mean, spread = seen.mean(axis=0), seen.std(axis=0)
    spread = np.where(spread > 0, spread, 1.0)
    pieces = []
    for both, at in zip(held, counts, strict=True):
        scaled = (both - mean) / spread
        pieces.append(ScaledRecord(scaled[:, :-1], scaled[:, -1], at))
    return pieces, mean, spread
