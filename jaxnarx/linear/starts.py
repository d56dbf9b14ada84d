"""Starting values for prediction-error searches, by linear least squares alone.

A long ARX model (Hannan and Rissanen 1982) gives estimates of the innovations and of
what every input contributes. With the innovations as regressors, ARMAX and the noise
model of Box-Jenkins are linear; with the contributions as outputs, so is every B/F.
Steiglitz and McBride (1965) improve B/F by filtering both sides with 1/F. Roots outside
the unit circle are reflected. Signals here are scaled, records padded to one length.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.linear.stability import reflect_roots
from jaxnarx.linear.structure import Polynomials, Structure

LONG_ORDER = 30
"""Largest order of the long ARX model."""
REFILTERING_ROUNDS = 3
"""Rounds of Steiglitz and McBride."""

Records = Float[np.ndarray, "records time"]
Column = tuple[np.ndarray, int]


def starts(
    structure: Structure,
    u: Float[np.ndarray, "records time inputs"],
    y: Records,
    valid: Bool[np.ndarray, "records time"],
) -> list[Float[np.ndarray, " params"]]:
    """Candidates, with C and all F stable; the caller takes the best."""
    long = _LongModel(structure, u, y, valid)
    if not any(structure.nf):
        found = [_armax(structure, u, y, valid, e) for e in (long.e, None)]
    else:
        found = _output_errors(structure, u, y, valid, long)
        if structure.na:
            found += _with_shared_poles(structure, u, y, valid, long, found[-1])
    return [np.asarray(structure.join(p)) for p in found]


def solve(
    target: Records, columns: Sequence[Column], valid: Bool[np.ndarray, "records time"]
) -> Float[np.ndarray, " columns"]:
    """Least squares of `target` by (signal, lag) where the whole window is valid."""
    longest = max((lag for _, lag in columns), default=0)
    time = target.shape[1]
    good = valid.copy()
    good[:, :longest] = False
    for lag in range(1, longest + 1):
        good[:, lag:] &= valid[:, : time - lag]
    rows = [np.where(good, _shift(x, lag), 0.0)[good] for x, lag in columns]
    if not rows:
        return np.zeros(0)
    return np.linalg.lstsq(np.stack(rows, axis=1), target[good], rcond=None)[0]


def _shift(signal: Records, lag: int) -> Records:
    """The signal `lag` samples ago; before the record its first value."""
    if lag == 0:
        return signal
    first = np.repeat(signal[:, :1], min(lag, signal.shape[1]), axis=1)
    return np.concatenate([first, signal[:, :-lag]], axis=1)[:, : signal.shape[1]]


class _LongModel:
    """ARX of high order: innovations `e`, and `w`, what every input contributes."""

    def __init__(self, structure: Structure, u, y, valid):
        inputs, one = u.shape[2], np.ones_like(y)
        most = valid.sum() // (8 * (1 + inputs))
        shortest = int(valid.sum(axis=1).max(initial=0)) // 4
        order = max(1, min(LONG_ORDER, 10 + 3 * structure.longest, int(most), shortest))
        columns: list[Column] = [(y, k) for k in range(1, order + 1)]
        for i in range(inputs):
            columns += [(u[:, :, i], structure.nk[i] + k) for k in range(order)]
        columns += [(one, 0)]
        theta = solve(y, columns, valid)
        fitted = sum(
            t * _shift(x, lag) for t, (x, lag) in zip(theta, columns, strict=True)
        )
        self.e = np.where(valid, y - fitted, 0.0)
        a = reflect_roots(np.concatenate([[1.0], -theta[:order]]))
        self.w = []
        for i in range(inputs):
            b = theta[order * (1 + i) : order * (2 + i)]
            delay = np.zeros(structure.nk[i])
            self.w.append(settled_filter(np.concatenate([delay, b]), a, u[:, :, i]))


def settled_filter(b: np.ndarray, a: np.ndarray, u: Records) -> Records:
    """B/A u of records that rest at their first value."""
    from scipy.signal import lfilter  # it loads half of scipy

    first = u[:, :1]
    gain = b.sum() / a.sum()
    return gain * first + lfilter(b, a, u - first, axis=1)


def _armax(structure: Structure, u, y, valid, e) -> Polynomials:
    """Least squares with the innovations as regressors; without them C is one."""
    columns: list[Column] = [(y, k) for k in range(1, structure.na + 1)]
    for i in range(u.shape[2]):
        columns += [(u[:, :, i], lag) for lag in structure.input_lags(i)]
    known = 0
    if e is not None:
        known = structure.nc
        columns += [(e, k) for k in range(1, known + 1)]
    columns += [(np.ones_like(y), 0)] * structure.constant
    theta = np.split(
        solve(y, columns, valid), np.cumsum([structure.na, *structure.nb, known])
    )
    c = np.zeros(structure.nc)
    c[:known] = theta[-2]
    return Polynomials(
        _monic(-theta[0]),
        tuple(theta[1:-2]),
        reflect_roots(np.concatenate([[1.0], c])),
        _monic(np.zeros(structure.nd)),
        tuple(_monic(np.zeros(n)) for n in structure.nf),
        theta[-1].sum(),
    )


def _output_errors(structure: Structure, u, y, valid, long: _LongModel):
    """B/F of every input from the long model, from ARX, and by Steiglitz-McBride."""
    pairs = [
        _ratio(structure, i, u[:, :, i], long.w[i], valid, np.ones(1))
        for i in range(u.shape[2])
    ]
    found = _with_noise(structure, u, y, valid, pairs)
    if len(set(structure.nf)) == 1:
        arx = _armax(_shared_structure(structure), u, y, valid, None)
        f = reflect_roots(np.asarray(arx.a))
        same = [(np.asarray(b), f) for b in arx.b]
        found += _with_noise(structure, u, y, valid, same)
    for _ in range(REFILTERING_ROUNDS):
        pairs = _steiglitz_mcbride(structure, u, y, valid, pairs)
        found += _with_noise(structure, u, y, valid, pairs)
    return found


def _with_shared_poles(structure: Structure, u, y, valid, long, plain: Polynomials):
    """Candidates for A: that of ARMAX, and the poles of the noise of a `plain` model
    without A. The rest is then a model without A of the output filtered by it."""
    none = tuple(0 for _ in structure.nf)
    armax = _armax(dataclasses.replace(structure, nf=none), u, y, valid, long.e)
    pairs = list(zip(plain.b, plain.f, strict=True))
    v = y - sum(_contributions(structure, u, pairs), np.zeros_like(y))
    v = np.where(valid, v - v[valid].mean() * structure.constant, 0.0)
    noise = dataclasses.replace(structure, nd=structure.na)
    found = []
    for a in (armax.a, _monic(_noise(noise, v, valid)[1])):
        a = reflect_roots(np.asarray(a))
        ahead = settled_filter(a, np.ones(1), y)
        rest = _LongModel(structure, u, ahead, valid)
        apart = _output_errors(structure, u, ahead, valid, rest)
        found += [p._replace(a=a) for p in apart]
    return found


def _shared_structure(structure: Structure) -> Structure:
    """The ARX model with the order of all F as that of A."""
    none = (0,) * len(structure.nf)
    order = structure.nf[0]
    return dataclasses.replace(structure, na=order, nc=0, nd=0, nf=none)


def _steiglitz_mcbride(structure: Structure, u, y, valid, pairs):
    out = list(pairs)
    for i in range(len(pairs)):
        w = _contributions(structure, u, out)
        others = sum((w[j] for j in range(len(w)) if j != i), np.zeros_like(y))
        rest = y - others
        rest = rest - rest[valid].mean() * structure.constant
        out[i] = _ratio(structure, i, u[:, :, i], rest, valid, out[i][1])
    return out


def _ratio(structure: Structure, i: int, u, w, valid, filter_):
    """B and F from an input and its contribution, both filtered by 1/`filter_`."""
    u, w = (
        settled_filter(np.ones(1), filter_, u),
        settled_filter(np.ones(1), filter_, w),
    )
    columns: list[Column] = [(w, k) for k in range(1, structure.nf[i] + 1)]
    columns += [(u, lag) for lag in structure.input_lags(i)]
    columns += [(np.ones_like(w), 0)] * structure.constant
    theta = solve(w, columns, valid)
    order = structure.nf[i]
    f = reflect_roots(np.concatenate([[1.0], -theta[:order]]))
    return theta[order : order + structure.nb[i]], f


def _contributions(structure: Structure, u, pairs) -> list[np.ndarray]:
    return [
        settled_filter(np.concatenate([np.zeros(structure.nk[i]), b]), f, u[:, :, i])
        for i, (b, f) in enumerate(pairs)
    ]


def _with_noise(structure: Structure, u, y, valid, pairs) -> list[Polynomials]:
    """The model with these B/F, without a model of the noise and with one."""
    v = y - sum(_contributions(structure, u, pairs), np.zeros_like(y))
    constant = float(v[valid].mean()) if structure.constant else 0.0
    white = (np.zeros(structure.nc), np.zeros(structure.nd))
    coloured = _noise(structure, np.where(valid, v - constant, 0.0), valid)
    kinds = [white] if not (structure.nc or structure.nd) else [white, coloured]
    return [
        Polynomials(
            _monic(np.zeros(structure.na)),
            tuple(b for b, _ in pairs),
            reflect_roots(np.concatenate([[1.0], c])),
            reflect_roots(np.concatenate([[1.0], d])),
            tuple(f for _, f in pairs),
            np.float64(constant),
        )
        for c, d in kinds
    ]


def _noise(structure: Structure, v: Records, valid):
    """C and D of v = C/D e, the innovations from a long autoregression of v."""
    order = min(LONG_ORDER, 10 + 3 * max(structure.nc, structure.nd), v.shape[1] // 8)
    past: list[Column] = [(v, k) for k in range(1, max(order, 1) + 1)]
    theta = solve(v, past, valid)
    e = v - sum(t * _shift(x, lag) for t, (x, lag) in zip(theta, past, strict=True))
    columns: list[Column] = [(v, k) for k in range(1, structure.nd + 1)]
    columns += [(np.where(valid, e, 0.0), k) for k in range(1, structure.nc + 1)]
    both = solve(v, columns, valid)
    return both[structure.nd :], -both[: structure.nd]


def _monic(tail: np.ndarray):
    return np.concatenate([np.ones(1), tail])
