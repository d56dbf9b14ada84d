"""Figures of a selection beside its terms: what `stats` shows."""

from typing import Any

import jax
import numpy as np
import scipy.special

from jaxnarx.regressors import Pool
from jaxnarx.selection.path import Path
from jaxnarx.selection.selection import Selection
from jaxnarx.selection.sizes import criteria_of


def compute_statistics(value: Selection, path: Path) -> dict[str, Any]:
    """Criteria of all sizes, t values and what else `stats` holds of every search."""
    t, p_value = _t_values(value)
    return _tables(value) | {
        "sse": value.sse,
        "samples": value.samples,
        "cond": np.asarray(path.cond),
        "count": np.asarray(path.count),
        "t": t,
        "p_value": p_value,
    }


def _tables(value: Selection) -> dict[str, np.ndarray]:
    """Criteria of all outputs; past an output's last size they repeat."""
    slots = value.index.shape[1]
    tables = [criteria_of(value, o) for o in range(len(value.index))]
    return {
        name: np.stack(
            [np.pad(t[name], (0, slots - len(t[name])), mode="edge") for t in tables]
        )
        for name in tables[0]
    }


def _t_values(value: Selection):
    """Coefficients over their standard errors, and the probability of larger ones."""
    positive = value.error > 0
    t = np.where(
        positive, value.coefficient / np.where(positive, value.error, 1.0), 0.0
    )
    spare = np.maximum(value.samples - value.used.sum(axis=1), 1)[:, None]
    p_value = 2.0 * scipy.special.stdtr(spare, -np.abs(t))
    return t, np.where(value.used, p_value, 1.0)


def partial_f_histories(pool: Pool, path: Path) -> list[list[dict[str, float]]]:
    """Partial F of the terms in the model after every round, by output."""
    h = jax.tree.map(np.asarray, path.history)
    return [
        [
            {
                pool.name(int(h.term[o, r, s])): float(h.f[o, r, s])
                for s in np.flatnonzero(h.used[o, r])
            }
            for r in range(int(h.rounds[o]))
        ]
        for o in range(len(h.rounds))
    ]
