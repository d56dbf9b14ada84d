"""Signals whose terms cannot be chosen: constant ones, and copies of earlier ones."""

import numpy as np
from jaxtyping import Bool

from jaxnarx.data import Dataset
from jaxnarx.errors import DataError
from jaxnarx.regressors import Pool


def _stack(data: Dataset) -> tuple[np.ndarray, np.ndarray]:
    columns = np.concatenate([np.concatenate([r.u, r.y], axis=1) for r in data])
    return columns, np.concatenate([r.valid for r in data])


def unusable_signals(data: Dataset, pool: Pool) -> dict[str, str]:
    """Signals of the pool whose terms are passed over, with the reason.

    They are constant inputs, and channels equal to or a multiple of an earlier one. A
    modelled output that is constant raises `DataError`, and so does a pool without any
    excited input.
    """
    columns, valid = _stack(data)
    names = data.channels.names
    inputs = len(data.channels.inputs)
    signals = sorted({s for s, _ in pool.variables})
    reasons: dict[str, str] = {}
    unit: dict[int, np.ndarray] = {}
    for s in sorted({*signals, *(inputs + o for o in pool.outputs)}):
        x = columns[valid[:, s], s]
        peak = np.max(np.abs(x), initial=0.0)
        if x.size == 0 or np.ptp(x) <= 1e-12 * peak:
            if s >= inputs:
                raise DataError(
                    f"output {names[s]!r} is constant over all records; there is "
                    "nothing to identify. Choose another output or other records",
                    channel=names[s],
                )
            reasons[names[s]] = "constant"
            continue
        scaled = columns[:, s] / peak
        for other, reference in unit.items():
            both = valid[:, s] & valid[:, other]
            if _proportional(scaled[both], reference[both]):
                reasons[names[s]] = f"the same as {names[other]}"
                break
        else:
            unit[s] = scaled
    if any(s < inputs for s in signals) and not any(s < inputs for s in unit):
        raise DataError(
            "every input is constant, so nothing excites the engine: "
            + ", ".join(n for n, r in reasons.items() if r == "constant"),
            channel=next(iter(reasons), None),
        )
    return reasons


def _proportional(a: np.ndarray, b: np.ndarray) -> bool:
    """True where a = c b but for rounding, that of a text file included.

    The measure is how far a moves: far from zero every channel is a multiple of any
    other.
    """
    if not a.size:
        return False
    ratio = float(np.vdot(a, b)) / float(np.vdot(b, b))
    return bool(np.max(np.abs(a - ratio * b)) <= 1e-4 * float(np.std(a)))


def usable_terms(pool: Pool, passed_over: dict[str, str]) -> Bool[np.ndarray, " terms"]:
    """False for terms with a signal that is passed over."""
    names = pool.channels.names
    bad = [v + 1 for v, (s, _) in enumerate(pool.variables) if names[s] in passed_over]
    return np.logical_not(np.any(np.isin(pool.factor, bad), axis=1))
