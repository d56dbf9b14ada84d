"""The penalised form (5.28) to (5.30): one model of all effects, each shrunk.

With f_k the fitted contribution of effect k in the full least-squares model (5.29),

    min over 0 <= c <= 1 of |y - mean - sum_k c_k f_k|^2 + J sum_k F_k c_k ,

a non-negative garrote on groups of parameters (Breiman 1995), the convex relaxation of
c in {0, 1} by Roll, Lind and Ljung ("Connections between optimisation-based regressor
selection and analysis of variance", CDC 2006). J is the residual variance of the full
model, F_k = 2 d_k q_k with d_k the effect's degrees of freedom and q_k the F table's
quantile for d_k and the residual's. On balanced cells the effects are orthogonal,
SS_k = |f_k|^2, and the solution is c_k = max(0, 1 - q_k / F ratio_k): an effect is kept
exactly when its F test says so.
"""

from typing import NamedTuple

import numpy as np
import scipy.linalg
from jaxtyping import Float
from scipy.special import fdtri

from jaxnarx.errors import DataError
from jaxnarx.selection.anova.cells import (
    Effect,
    FTest,
    eliminate,
    judge,
    list_effects,
)
from jaxnarx.selection.anova.garrote import garrote
from jaxnarx.selection.anova.model import Codes, cross_moments, fit, moments, sizes
from jaxnarx.settings import Anova


class Shrunk(NamedTuple):
    """The full model's partial F tests and garrote weights, an entry per effect.

    An effect with no degree of freedom is one to which empty cells or earlier effects
    leave nothing of its own.
    """

    tests: list[FTest]
    weights: Float[np.ndarray, " effects"]
    passed_over: list[Effect]


def _shortlist(
    codes: Codes,
    levels: dict[int, int],
    y: Float[np.ndarray, " rows"],
    effects: list[Effect],
    limit: int,
) -> list[Effect]:
    """The effects that fit into `limit` columns: main effects, then the strongest.

    Interactions are ranked by the p value of what each adds, alone, to all main
    effects.
    """
    mains = [e for e in effects if len(e) == 1]
    width = 1 + sum(sizes(mains, levels))
    if width > limit:
        raise DataError(
            f"{len(mains)} variables have {width} columns of main effects; the model "
            f"may have {limit} (half the {len(y)} samples, or the setting `columns`). "
            "Use fewer lags or levels, or more samples"
        )
    rest = [e for e in effects if len(e) > 1]
    if width + sum(sizes(rest, levels)) <= limit:
        return effects
    gain = _add_interactions(codes, levels, y, mains, rest)
    chosen: set[Effect] = set(mains)
    for effect in sorted(rest, key=lambda e: gain[e]):
        [columns] = sizes([effect], levels)
        if width + columns > limit:
            break
        width += columns
        chosen.add(effect)
    return [e for e in effects if e in chosen]


def _add_interactions(
    codes: Codes,
    levels: dict[int, int],
    y: Float[np.ndarray, " rows"],
    mains: list[Effect],
    rest: list[Effect],
) -> dict[Effect, tuple[float, float]]:
    """(p, -F) of every interaction added to the main effects alone."""
    gram, moment = moments(codes, levels, mains, y)
    _, own = eliminate(gram, np.diag(gram), len(gram))
    factor = scipy.linalg.cho_factor(gram[np.ix_(own, own)], lower=True)
    total = float(y @ y)
    explained = moment[own] @ scipy.linalg.cho_solve(factor, moment[own])
    found = {}
    for start in range(0, len(rest), 64):
        batch = rest[start : start + 64]
        cross, square, product = cross_moments(codes, levels, y, mains, batch)
        across = scipy.linalg.cho_solve(factor, cross[own])
        ends = np.cumsum([0, *sizes(batch, levels)])
        for k, effect in enumerate(batch):
            z = slice(ends[k], ends[k + 1])
            left = square[z, z] - cross[own, z].T @ across[:, z]
            gain = product[z] - across[:, z].T @ moment[own]
            _, kept = eliminate(left, np.diag(square)[z], len(left))
            squares = float(
                gain[kept] @ np.linalg.solve(left[np.ix_(kept, kept)], gain[kept])
            )
            spare = len(y) - len(own) - len(kept)
            error = max(total - explained - squares, 0.0)
            f, p = judge(squares, len(kept), error, spare, total)
            found[effect] = (p, -f)
    return found


def shrink(
    codes: Codes,
    levels: dict[int, int],
    y: Float[np.ndarray, " rows"],
    method: Anova,
) -> Shrunk:
    """Fit the full model of all effects and shrink it; y is centred."""
    everything = list_effects(tuple(codes), method.interactions)
    limit = min(method.columns, len(y) // 2)
    effects = _shortlist(codes, levels, y, everything, limit)
    model = fit(codes, levels, effects, y)
    tests = [model.test(k) for k in range(len(effects))]
    level = method.significance / (len(everything) if method.familywise else 1)
    penalty = [
        2 * t.freedom * fdtri(t.freedom, t.spare, 1 - level) if t.freedom else 0.0
        for t in tests
    ]
    # Column k: the parameters of effect k, so that X spread_k is its contribution.
    spread = (model.owner[:, None] == np.arange(len(effects))[None]) * 1.0
    spread *= model.theta[:, None]
    weights = garrote(
        spread.T @ model.gram @ spread,
        spread.T @ (model.moment - model.gram[:, 0] * model.theta[0]),
        model.error / model.spare * np.array(penalty),
    )
    chosen = set(effects)
    return Shrunk(tests, weights, [e for e in everything if e not in chosen])
