"""Inputs that take few values: switches, gears, set points."""

import numpy as np

from jaxnarx.data.dataset import Dataset

FEW_LEVELS = 3
"""Distinct values up to which an input counts as binary or event-like."""
BETWEEN_LEVELS_SHARE = 0.02
"""Share of the samples that may lie between these values: edges that were resampled."""


def input_levels(data: Dataset, place: int) -> tuple[float, ...] | None:
    """The few values at which nearly all samples of an input stand, if there are."""
    parts = [r.u[r.valid[:, place], place] for r in data]
    values, count = np.unique(np.concatenate(parts), return_counts=True)
    often = np.sort(np.argsort(-count, kind="stable")[:FEW_LEVELS])
    often = often[count[often] > BETWEEN_LEVELS_SHARE * count.sum()]
    if count[often].sum() < (1 - BETWEEN_LEVELS_SHARE) * count.sum():
        return None
    return tuple(float(v) for v in values[often])
