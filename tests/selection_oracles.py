"""Slow, obvious NumPy versions of term selection on dense columns.

Every fit is an explicit least squares by `np.linalg.lstsq`, every partial F the
comparison of two such fits, every sample left out is really left out. Nothing here
imports jaxnarx.

Conventions shared by all functions:

* `columns[t, j]` is term j at sample t, `y[t]` the output, uncentred;
* a model is a list of column numbers in order of entry, all counted in p and n, the
  constant too;
* weights w minimise sum_t w_t r_t^2; a sample of weight zero is dropped, whatever it
  holds, and N counts the samples of positive weight, so that scaling all weights
  changes no F, t or criterion difference;
* equal scores: the first, that is the lowest column or the earliest entry.
"""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

Columns = Float[np.ndarray, "time terms"]
Signal = Float[np.ndarray, " time"]
Weights = Signal | None

EXACT = 1e-24
"""SSE over sum w y^2 below which the residual is rounding and a search ends."""


# ------------------------------------------------------------------------- one model


class Fit(NamedTuple):
    """Least squares on some columns: coefficients, weighted SSE and N."""

    theta: Float[np.ndarray, " params"]
    sse: float
    samples: int


def weighted(
    columns: Columns, y: Signal, weights: Weights = None
) -> tuple[Columns, Signal]:
    """Rows times sqrt(w), those of weight zero left out."""
    w = np.ones(len(y)) if weights is None else np.asarray(weights, float)
    root = np.sqrt(w[w > 0])
    return columns[w > 0] * root[:, None], y[w > 0] * root


def least_squares(
    columns: Columns, y: Signal, terms: Sequence[int], weights: Weights = None
) -> Fit:
    """theta = argmin sum w (y - X theta)^2; no term leaves y itself."""
    x, target = weighted(columns, y, weights)
    x = x[:, list(terms)]
    theta = np.linalg.lstsq(x, target, rcond=None)[0]
    return Fit(theta, float(np.sum((target - x @ theta) ** 2)), len(target))


def partial_f(
    columns: Columns, y: Signal, terms: Sequence[int], weights: Weights = None
) -> Float[np.ndarray, " params"]:
    """(SSE without the term - SSE) / s^2 for every term, s^2 = SSE / (N - p).

    The same as (SSR - SSR without) / s^2, thesis (5.18), (5.20). An exact fit gives
    inf, or 0 for a term that lowers nothing.
    """
    full = least_squares(columns, y, terms, weights)
    variance = full.sse / (full.samples - len(terms))
    drops = []
    for term in terms:
        rest = [other for other in terms if other != term]
        # Rounding may leave a drop below zero, which no term removed can cause.
        drop = least_squares(columns, y, rest, weights).sse - full.sse
        drops.append(max(drop, 0.0))
    if variance > 0:
        return np.array(drops) / variance
    return np.where(np.array(drops) > 0, np.inf, 0.0)


def standard_errors(
    columns: Columns, y: Signal, terms: Sequence[int], weights: Weights = None
) -> Float[np.ndarray, " params"]:
    """sqrt(s^2 diag (X' W X)^-1), the inverse taken as it is written."""
    fit = least_squares(columns, y, terms, weights)
    x, _ = weighted(columns, y, weights)
    x = x[:, list(terms)]
    variance = fit.sse / (fit.samples - len(terms))
    return np.sqrt(variance * np.diag(np.linalg.inv(x.T @ x)))


# -------------------------------------------------------------------------- criteria


def press_by_leave_one_out(
    columns: Columns, y: Signal, terms: Sequence[int], weights: Weights = None
) -> float:
    """sum_t w_t (y_t - x_t' theta_(t))^2, theta_(t) fitted without sample t."""
    x, target = weighted(columns, y, weights)
    x = x[:, list(terms)]
    total = 0.0
    for t in range(len(target)):
        others = np.arange(len(target)) != t
        theta = np.linalg.lstsq(x[others], target[others], rcond=None)[0]
        total += float(target[t] - x[t] @ theta) ** 2
    return total


def total_squares(y: Signal, weights: Weights = None) -> float:
    """sum w (y - mean y)^2 about the weighted mean."""
    return least_squares(np.ones((len(y), 1)), y, [0], weights).sse


def cp(
    columns: Columns,
    y: Signal,
    terms: Sequence[int],
    full: Sequence[int],
    weights: Weights = None,
) -> float:
    """Mallows' Cp = SSE / sigma^2 - N + 2 n, sigma^2 = SSE_full / (N - n_full).

    `full` is the largest candidate model. Thesis (5.33), (5.34) as corrected.
    """
    fit = least_squares(columns, y, terms, weights)
    largest = least_squares(columns, y, full, weights)
    variance = largest.sse / (fit.samples - len(full))
    return fit.sse / variance - fit.samples + 2 * len(terms)


def fpe(
    columns: Columns, y: Signal, terms: Sequence[int], weights: Weights = None
) -> float:
    """N ln(SSE / N) + N ln((N + n) / (N - n)), thesis (5.35)."""
    fit, n = least_squares(columns, y, terms, weights), len(terms)
    total = fit.samples
    return total * (np.log(fit.sse / total) + np.log((total + n) / (total - n)))


class Information(NamedTuple):
    """AIC, AICc and BIC."""

    aic: float
    aicc: float
    bic: float


def information(
    columns: Columns, y: Signal, terms: Sequence[int], weights: Weights = None
) -> Information:
    """N ln(SSE / N) + 2 n; the same + 2 n (n + 1) / (N - n - 1); with n ln N for 2 n.

    Only the coefficients are counted in n, not the variance.
    """
    fit, n = least_squares(columns, y, terms, weights), len(terms)
    total = fit.samples
    base = total * np.log(fit.sse / total)
    aic = base + 2 * n
    return Information(
        aic, aic + 2 * n * (n + 1) / (total - n - 1), base + n * np.log(total)
    )


def adjusted_r2(
    columns: Columns, y: Signal, terms: Sequence[int], weights: Weights = None
) -> float:
    """1 - (SSE / (N - n)) / (SST / (N - 1)), SST about the weighted mean."""
    fit = least_squares(columns, y, terms, weights)
    total = total_squares(y, weights) / (fit.samples - 1)
    return 1 - fit.sse / (fit.samples - len(terms)) / total


def overall_f(
    columns: Columns, y: Signal, terms: Sequence[int], weights: Weights = None
) -> float:
    """((SST - SSE) / (n - 1)) / (SSE / (N - n)): all but the constant against none.

    `terms` must hold the constant, which one of the n is.
    """
    fit, n = least_squares(columns, y, terms, weights), len(terms)
    explained = total_squares(y, weights) - fit.sse
    return (explained / (n - 1)) / (fit.sse / (fit.samples - n))


# ---------------------------------------------------------------------------- search


class Row(NamedTuple):
    """One row of the F history: terms in order of entry, and their partial F.

    The constant and forced terms are in the model but not in the row.
    """

    terms: list[int]
    partial_f: Float[np.ndarray, " params"]


class Search(NamedTuple):
    """Terms left in order of entry, those removed in order of removal, the history."""

    terms: list[int]
    removed: list[int]
    history: list[Row]


def stepwise_f(
    columns: Columns,
    y: Signal,
    f_in: float,
    f_out: float,
    max_terms: int,
    *,
    stages: Sequence[int] | None = None,
    degrees: Sequence[int] | None = None,
    constant: int | None = 0,
    forced: Sequence[int] = (),
    forbidden: Collection[int] = (),
    weights: Weights = None,
    tau: float = 1e-10,
) -> Search:
    """Stepwise regression with partial F; `max_terms` counts the whole model.

    Start with the constant and the forced terms, which are never removed. Repeat:

    1. residualise y and every unused candidate on the columns in the model;
    2. take the candidate of largest |correlation| of the two remainders, passing over
       those left with a share of at most tau of their own squared norm;
    3. refit; s^2 = SSE / (N - p); if (SSE before - SSE) / s^2 <= f_in drop it and stop;
    4. while the smallest partial F of a removable term is below f_out remove that term
       and refit. A removed term does not come back.

    With `stages` = (n1, n2, ...) stage d does at most n_d such iterations among the
    terms of degree d (`degrees`), given all terms found before; a stage whose best
    candidate fails ends and the next begins. Removal looks at all removable terms.

    The history has a row after every iteration with an entry. Thesis (5.5) to (5.24),
    Table 5.2 and appendix A, as the reading notes correct them.
    """
    kept = [] if constant is None else [constant]
    kept += [term for term in forced if term not in kept]
    removed: list[int] = []
    history: list[Row] = []
    x, target = weighted(columns, y, weights)
    model = list(kept)
    for candidates, entries in _stages(columns.shape[1], stages, degrees):
        for _ in range(entries):
            unused = candidates - {*model, *removed, *forbidden}
            if len(model) >= max_terms or len(target) <= len(model) + 1:
                break
            best = _most_correlated(x, target, model, sorted(unused), tau)
            if best is None or not _entry_f(x, target, model, best) > f_in:
                break
            found = backward(x, target, [*model, best], f_out, kept=kept)
            model = found.terms
            removed += found.removed
            history.append(found.history[-1])
    return Search(model, removed, history)


def _stages(
    terms: int, stages: Sequence[int] | None, degrees: Sequence[int] | None
) -> list[tuple[set[int], int]]:
    """Candidates and largest number of iterations, stage by stage."""
    if stages is None:
        return [(set(range(terms)), terms)]
    assert degrees is not None, "a staged search needs the terms' degrees"
    return [
        ({j for j in range(terms) if degrees[j] == degree}, entries)
        for degree, entries in enumerate(stages, 1)
    ]


def _residual(
    x: Columns, target: Signal, model: Sequence[int]
) -> Float[np.ndarray, " time"]:
    chosen = x[:, list(model)]
    return target - chosen @ np.linalg.lstsq(chosen, target, rcond=None)[0]


def _most_correlated(
    x: Columns, target: Signal, model: Sequence[int], unused: list[int], tau: float
) -> int | None:
    rest = _residual(x, target, model)
    if np.sum(rest**2) <= EXACT * np.sum(target**2):
        return None
    best, score = None, 0.0
    for j in unused:
        own = _residual(x, x[:, j], model)
        if np.sum(own**2) > tau * np.sum(x[:, j] ** 2):
            correlation = abs(own @ rest) / np.linalg.norm(own) / np.linalg.norm(rest)
            if best is None or correlation > score:
                best, score = j, correlation
    return best


def _entry_f(x: Columns, target: Signal, model: Sequence[int], new: int) -> float:
    return float(partial_f(x, target, [*model, new])[-1])


def backward(
    columns: Columns,
    y: Signal,
    terms: Sequence[int],
    f_out: float,
    *,
    kept: Collection[int] = (0,),
    weights: Weights = None,
) -> Search:
    """Remove the term of smallest partial F while that is below `f_out`.

    Those in `kept` (the constant and forced terms) stay, whatever their F. The history
    has a row for the model as it comes and one after every removal.
    """
    model, removed, history = list(terms), [], []
    while True:
        values = partial_f(columns, y, model, weights)
        free = [i for i, term in enumerate(model) if term not in kept]
        history.append(Row([model[i] for i in free], values[free]))
        worst = min(free, key=lambda i: values[i], default=None)
        if worst is None or values[worst] >= f_out:
            return Search(model, removed, history)
        removed.append(model.pop(worst))


def exchange(
    columns: Columns,
    y: Signal,
    terms: Sequence[int],
    *,
    kept: Collection[int] = (0,),
    forbidden: Collection[int] = (),
    weights: Weights = None,
    gain: float = 1e-9,
) -> list[int]:
    """Swap one term out and one in, the best of all pairs, until no swap helps.

    A swap helps if it lowers the SSE by more than the share `gain` of it. Terms in
    `kept` stay. The new term takes the place of the old one in the order.
    """
    model = list(terms)
    sse = least_squares(columns, y, model, weights).sse
    while True:
        best, lowest = model, sse
        for place, old in enumerate(model):
            if old in kept:
                continue
            for new in set(range(columns.shape[1])) - {*model, *forbidden}:
                tried = [*model[:place], new, *model[place + 1 :]]
                value = least_squares(columns, y, tried, weights).sse
                if value < lowest:
                    best, lowest = tried, value
        if not lowest < sse * (1 - gain):
            return model
        model, sse = best, lowest


def backward_exchange(
    columns: Columns,
    y: Signal,
    terms: Sequence[int],
    f_out: float,
    *,
    kept: Collection[int] = (0,),
    forbidden: Collection[int] = (),
    weights: Weights = None,
) -> list[int]:
    """`backward`, then `exchange` and `backward` in turn until no term leaves.

    A swap lowers the SSE at equal size, a removal lowers the size, so this ends.
    """
    model = backward(columns, y, terms, f_out, kept=kept, weights=weights).terms
    while True:
        size = len(model)
        model = exchange(
            columns, y, model, kept=kept, forbidden=forbidden, weights=weights
        )
        model = backward(columns, y, model, f_out, kept=kept, weights=weights).terms
        if len(model) == size:
            return model
