"""Linear state-space models from data by subspace identification (PO-MOESP).

With s block rows and Y_f the matrix whose columns are the windows y(t) ... y(t+s-1) of
all t, U_f that of the inputs, U_p and Y_p those of the s samples before,

    Y_f = G X + H U_f + h 1' + noise,     G = [C; CA; ...; CA^(s-1)],

X the states x(t), H block Toeplitz, h from the offsets. One factorisation

    [1; U_f; U_p; Y_p; Y_f] = L Q',     L lower triangular,

takes the ones and U_f off everything else and leaves L32, what of Y_f the past then
tells. The noise in Y_f does not depend on the past, so that L32 tends to G times a
matrix of full rank: of L32 = U S V' the first n columns of U span G. They give C, their
first block row, and A from the shift G_1 A = G_2 of the block rows by one. One
factorisation serves all orders n. Inputs that a controller makes from the outputs
carry their noise into U_f, and A and C are biased.

Given A and C the output in free run is linear in B, D, the offsets and every record's
starting state: one least squares of the simulation error (`state_regression`).

Reference: M. Verhaegen, Identification of the deterministic part of MIMO state space
models given in innovations form from input-output data, Automatica 30 (1994) 61-74.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import ROWS_AT_ONCE, accumulate
from jaxnarx.checks import choice, require, whole
from jaxnarx.errors import DataError, SpecError
from jaxnarx.linear.state_space.model import (
    StateSpace,
    recursion,
    scale_states,
    stabilise,
)
from jaxnarx.linear.state_space.regression import Segment, StateRegression, regress

MOST_BLOCK_ROWS = 24
"""Block rows where the records are long."""
WINDOWS_PER_ROW = 4
"""Windows per row of the matrix that the default number of block rows leaves."""
CHAIN_POLES = (0.3, 0.003, 12)
"""One less the largest and the smallest pole of a chain, and how many are tried."""
CHAIN_NOISE = 0.1
"""Standard deviation of the noise over that of a state of a chain, for its start."""
FORMS = ("balanced", "modal")


@guard_arguments
def identify_subspace(
    u: Sequence[Any],
    y: Sequence[Any],
    order: int,
    *,
    block_rows: int | None = None,
    valid: Sequence[Any] | None = None,
    feedthrough: bool = True,
    integrating: bool = False,
    form: str = "balanced",
) -> StateSpace:
    """Linear model of `order` states; see `subspace_models`."""
    found = subspace_models(
        u,
        y,
        (order,),
        block_rows=block_rows,
        valid=valid,
        feedthrough=feedthrough,
        integrating=integrating,
        form=form,
    )
    return found[order]


@guard_arguments
def subspace_models(
    u: Sequence[Any],
    y: Sequence[Any],
    orders: Sequence[int],
    *,
    block_rows: int | None = None,
    valid: Sequence[Any] | None = None,
    feedthrough: bool = True,
    integrating: bool = False,
    form: str = "balanced",
) -> dict[int, StateSpace]:
    """Linear models of several `orders` from one factorisation.

    `u` and `y` hold an array (time, inputs) and one (time, outputs) for every record,
    in any unit; there may be no inputs. `valid` holds booleans (time,): records are cut
    at rows where they are False, whose numbers are not looked at. Pieces shorter than
    two block rows take no part in the choice of A and C.

    `block_rows` is s: by default the largest number up to `MOST_BLOCK_ROWS`, and at
    least two more than the largest order, that leaves windows enough. Without
    `feedthrough` D is zero. All poles are put inside the unit circle (`stabilised`);
    with `integrating` those next to one become one, and the offset of the state may
    drive them. An input that does not change has no effect in the model.

    `form` says how states are chosen: `"balanced"` by singular vectors, or `"modal"`, A
    in blocks of 1 x 1 and 2 x 2 (few parameters; poles may not coincide). States have
    mean zero and standard deviation one over the data in either.

    `SpecError` where the block rows do not allow an order. `DataError` for numbers that
    are not finite, outputs that do not change, and too few windows. An order whose
    model does not come out finite, or has no modal form, is left out; `DataError` where
    none is left.
    """
    choice(form, FORMS, "form")
    orders = [whole(n, "orders") for n in orders]
    require(bool(orders), "orders", "orders must name at least one")
    signals = _signals(u, y, valid)
    found = _projection(signals, _block_rows(signals, max(orders), block_rows))
    options = {"feedthrough": feedthrough, "integrating": integrating, "form": form}
    models: dict[int, StateSpace] = {}
    reason = ""
    for n in orders:
        try:
            models[n] = _model(signals, found, n, **options)
        except (DataError, np.linalg.LinAlgError) as error:
            reason = str(error)
    if not models:
        raise DataError(f"no model of order {', '.join(map(str, orders))}: {reason}")
    return models


@guard_arguments
def chain_model(
    u: Sequence[Any],
    y: Sequence[Any],
    order: int,
    *,
    valid: Sequence[Any] | None = None,
    feedthrough: bool = True,
) -> StateSpace:
    """The linear model of `order` equal poles with the smallest simulation error.

    One output behind a chain of first-order lags, as tanks, pipes and heated walls are,

        z_k(t+1) = p z_k(t) + (1 - p) z_(k+1)(t) ,   y(t) = z_1(t) ,

    which the inputs enter anywhere. The best of `CHAIN_POLES` values of p is chosen.
    Arguments as in `subspace_models`; `SpecError` for several outputs.
    """
    order = whole(order, "order", 1)
    signals = _signals(u, y, valid)
    outputs = signals.width - signals.inputs
    require(outputs == 1, "y", f"a chain has one output, got {outputs}")
    c, prior = np.eye(order)[:1], np.full(order, CHAIN_NOISE)
    chains = [
        pole * np.eye(order) + (1 - pole) * np.eye(order, k=1)
        for pole in 1 - np.geomspace(*CHAIN_POLES)
    ]
    options = {"prior": prior, "feedthrough": feedthrough, "integrating": False}
    errors = [
        _error(a, c, regress(a, c, signals.pieces, **options), signals.pieces)
        for a in chains
    ]
    best = chains[int(np.argmin(errors))]
    return _complete(signals, best, c, prior, np.ones(order), feedthrough=feedthrough)


def _error(
    a: Float[np.ndarray, "states states"],
    c: Float[np.ndarray, "outputs states"],
    rest: StateRegression,
    pieces: Sequence[Segment],
) -> float:
    """Sum of squares of what the free runs of all pieces are off."""
    total = 0.0
    for piece, x0 in zip(pieces, rest.starts, strict=True):
        drive = piece.u @ rest.b.T + rest.state_offset[None]
        x = recursion(a.T, drive[:, None], x0[None])[:-1, 0]
        run = x @ c.T + piece.u @ rest.d.T + rest.output_offset[None]
        total += float(np.sum((run - piece.y) ** 2))
    return total


# The data --------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False)
class _Signals:
    """Valid stretches of all records, of mean zero and standard deviation one.

    A signal that does not change has `spread` zero and is zero.
    """

    pieces: list[Segment]
    records: int
    inputs: int
    mean: Float[np.ndarray, " signals"]
    spread: Float[np.ndarray, " signals"]

    @property
    def width(self) -> int:
        """Inputs and outputs."""
        return len(self.mean)

    def windows(self, rows: int) -> int:
        """Windows of two times `rows` samples that cross no border."""
        return sum(max(len(p.y) - 2 * rows + 1, 0) for p in self.pieces)

    def need(self, rows: int) -> int:
        """Windows that the factorisation takes: one per row of the matrix."""
        return 2 * rows * self.width + 1


def _signals(u: Sequence[Any], y: Sequence[Any], valid) -> _Signals:
    known = [None] * len(y) if valid is None else valid
    require(
        len(u) == len(y) == len(known) > 0,
        "u",
        f"u, y and valid must hold an array for every record, got {len(u)}, {len(y)} "
        f"and {len(known)}",
    )
    stretches, records = [], zip(u, y, known, strict=True)
    for k, (one, other, good) in enumerate(records):
        both, good = _record(k, one, other, good)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], good, [0]])))
        stretches += [(k, both[a:b]) for a, b in edges.reshape(-1, 2)]
    widths = {(np.shape(a)[1], np.shape(b)[1]) for a, b in zip(u, y, strict=True)}
    told = f"records must have the same channels, got (inputs, outputs) {widths}"
    require(len(widths) == 1, "u", told)
    if not stretches:
        raise DataError("no record has a valid sample")
    inputs = np.shape(u[0])[1]
    mean, spread = _moments(np.concatenate([z for _, z in stretches]))
    if not np.any(spread[inputs:] > 0):
        raise DataError("the outputs do not change: there is nothing to model")
    gain = np.where(spread > 0, 1 / np.where(spread > 0, spread, 1.0), 0.0)
    unit = [(k, (z - mean[None]) * gain[None]) for k, z in stretches]
    pieces = [Segment(k, z[:, :inputs], z[:, inputs:]) for k, z in unit]
    return _Signals(pieces, len(y), inputs, mean, spread)


def _record(k: int, u: Any, y: Any, valid: Any) -> tuple[np.ndarray, np.ndarray]:
    """Inputs and outputs side by side and which rows are valid, checked."""
    u, y = np.asarray(u, float), np.asarray(y, float)
    good = np.ones(len(y), bool) if valid is None else np.asarray(valid, bool)
    fits = u.ndim == y.ndim == 2 and good.shape == (len(u),) == (len(y),)
    require(
        fits and y.shape[1] > 0,
        "u",
        f"record {k}: expected u (time, inputs), y (time, outputs) and valid (time,), "
        f"got {u.shape}, {y.shape} and {good.shape}",
    )
    both = np.concatenate([u, y], axis=1)
    bad = ~np.isfinite(both).all(axis=1) & good
    if bad.any():
        row = int(np.argmax(bad))
        raise DataError(
            f"record {k} has numbers that are not finite in {int(bad.sum())} rows, "
            f"first row {row}; make them invalid",
            row=row,
        )
    return both, good


def _moments(z: Float[np.ndarray, "samples signals"]):
    """Means and standard deviations, zero for what is constant but for rounding."""
    with np.errstate(over="ignore", invalid="ignore"):
        mean, spread = z.mean(axis=0), z.std(axis=0)
    if not np.all(np.isfinite(spread)):
        raise DataError("the squares of the numbers overflow; use another unit")
    rounding = 10 * np.finfo(float).eps * np.abs(z).max(axis=0)
    return mean, np.where(spread > rounding, spread, 0.0)


def _block_rows(signals: _Signals, order: int, given: int | None) -> int:
    """The number given, or chosen, which allows the `order` and has windows enough."""
    rows = _default(signals, order) if given is None else whole(given, "block_rows")
    outputs = signals.width - signals.inputs
    if order > (rows - 1) * outputs:
        raise SpecError(
            f"{rows} block rows of {outputs} output(s) allow orders up to "
            f"{(rows - 1) * outputs}, got {order}; use more block rows",
            field="block_rows",
        )
    count, need = signals.windows(rows), signals.need(rows)
    if count < need:
        raise DataError(
            f"the records have {count} windows of {2 * rows} valid samples in a row, "
            f"{need} are needed, as in one record of {need + 2 * rows - 1} samples; "
            "give longer records, or use a smaller order or fewer block rows"
        )
    return rows


def _default(signals: _Signals, order: int) -> int:
    """The most that leave half of all samples as windows, and `WINDOWS_PER_ROW` for
    a row."""
    least = order + 2
    half = sum(len(p.y) for p in signals.pieces) / 2
    for rows in range(max(MOST_BLOCK_ROWS, least), least, -1):
        if signals.windows(rows) >= max(half, WINDOWS_PER_ROW * signals.need(rows)):
            return rows
    return least


# The factorisation -----------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False)
class _Projection:
    """U and S of L32; `noise` is the rms of what the past does not tell of y(t).

    `spread` is the standard deviation of the states that U as G belongs to, as far as
    future inputs do not tell them.
    """

    vectors: Float[np.ndarray, "_ values"]
    singular: Float[np.ndarray, " values"]
    spread: Float[np.ndarray, " values"]
    noise: float


def hankel_triangle(
    pieces: Sequence[Segment], rows: int
) -> Float[np.ndarray, "_ columns"]:
    """L' of [1; U_f; U_p; Y_p; Y_f] with `rows` block rows, block of windows by block.

    The matrix itself is never held: 100,000 windows of 30 block rows become 121
    columns of as many numbers.
    """
    signals = pieces[0].u.shape[1] + pieces[0].y.shape[1]
    return accumulate(_windows(pieces, rows), 2 * rows * signals + 1)


def _windows(pieces: Sequence[Segment], rows: int) -> Iterator[np.ndarray]:
    """Columns of the matrix, as rows, some thousand at a time."""
    for piece in pieces:
        if len(piece.y) < 2 * rows:
            continue
        inputs = piece.u.shape[1]
        z = np.concatenate([piece.u, piece.y], axis=1)
        every = np.lib.stride_tricks.sliding_window_view(z, 2 * rows, axis=0)
        for start in range(0, len(every), ROWS_AT_ONCE):
            w = every[start : start + ROWS_AT_ONCE].transpose(0, 2, 1)
            u, y = w[..., :inputs], w[..., inputs:]
            parts = (u[:, rows:], u[:, :rows], y[:, :rows], y[:, rows:])
            flat = [p.reshape(len(w), -1) for p in parts]
            yield np.concatenate([np.ones((len(w), 1)), *flat], axis=1)


def _projection(signals: _Signals, rows: int) -> _Projection:
    r = hankel_triangle(signals.pieces, rows)
    outputs = signals.width - signals.inputs
    past, future = (
        1 + rows * signals.inputs,
        1 + rows * (signals.inputs + signals.width),
    )
    try:
        u, s, _ = np.linalg.svd(r[past:future, future:].T, full_matrices=False)
    except np.linalg.LinAlgError as error:
        raise DataError(
            f"the projected data have no singular values: {error}"
        ) from error
    count = signals.windows(rows)
    left = r[future:, future : future + outputs]
    noise = np.sqrt(np.sum(left**2) / (outputs * max(count - future, 1)))
    least = np.finfo(float).eps * max(s[0], np.finfo(float).tiny)
    return _Projection(u, s, np.maximum(s, least) / np.sqrt(count), float(noise))


# The model -------------------------------------------------------------------------


def _model(
    signals: _Signals,
    found: _Projection,
    order: int,
    *,
    feedthrough: bool,
    integrating: bool,
    form: str,
) -> StateSpace:
    """A and C by the shift, the rest by regression, units and states by scaling."""
    outputs = signals.width - signals.inputs
    basis = found.vectors[:, :order]
    shifted = np.linalg.lstsq(basis[:-outputs], basis[outputs:], rcond=None)[0]
    return _complete(
        signals,
        stabilise(shifted, integrating=integrating),
        basis[:outputs],
        found.noise / found.spread[:order],
        found.singular,
        feedthrough=feedthrough,
        integrating=integrating,
        form=form,
    )


def _complete(
    signals: _Signals,
    a: Float[np.ndarray, "states states"],
    c: Float[np.ndarray, "outputs states"],
    prior: Float[np.ndarray, " states"],
    singular: Float[np.ndarray, " values"],
    *,
    feedthrough: bool,
    integrating: bool = False,
    form: str = "balanced",
) -> StateSpace:
    """The model with this A and C."""
    rest = regress(
        a,
        c,
        signals.pieces,
        prior=prior,
        feedthrough=feedthrough,
        integrating=integrating,
    )
    states, first = [], {}
    for piece, x0 in zip(signals.pieces, rest.starts, strict=True):
        drive = piece.u @ rest.b.T + rest.state_offset[None]
        states.append(recursion(a.T, drive[:, None], x0[None])[:-1, 0])
        first.setdefault(piece.record, x0)
    every = np.concatenate(states)
    mean = every.mean(axis=0)
    start = np.stack([first.get(k, mean) for k in range(signals.records)])
    plain = StateSpace(
        a, rest.b, rest.state_offset, c, rest.d, rest.output_offset, start, singular
    )
    model = scale_states(_unscale(plain, signals), every, form)
    numbers = (getattr(model, field.name) for field in dataclasses.fields(model))
    if not all(np.all(np.isfinite(n)) for n in numbers):
        raise DataError(f"the model of order {len(a)} has numbers that are not finite")
    return model


def _unscale(model: StateSpace, signals: _Signals) -> StateSpace:
    """A model of scaled signals for those in their own units."""
    u, y = slice(None, signals.inputs), slice(signals.inputs, None)
    spread = signals.spread
    gain = np.where(spread > 0, 1 / np.where(spread > 0, spread, 1.0), 0.0)[u]
    b, d = model.b * gain[None], model.d * gain[None]
    away = model.output_offset - d @ signals.mean[u]
    return dataclasses.replace(
        model,
        b=b,
        d=d * spread[y][:, None],
        c=model.c * spread[y][:, None],
        state_offset=model.state_offset - b @ signals.mean[u],
        output_offset=signals.mean[y] + spread[y] * away,
    )
