"""The model and the record of the simulation benchmark, as plain NumPy tables.

Two inputs at lags 1 and 2, one output at lags 1 to 3, terms of degree 2; local models
scheduled on both inputs. Only the standard library is imported here.
"""

from typing import Any

VARIABLES = ((0, 1), (0, 2), (1, 1), (1, 2), (2, 1), (2, 2), (2, 3))
"""(signal, lag): inputs 0 and 1, output 2. Terms below count them from 1."""

COMMON = ((0, 0), (0, 1), (0, 3), (0, 5), (0, 6))
"""Terms every local model has: the constant, both inputs, two output lags."""

OTHERS = ((0, 7), (1, 5), (3, 6), (2, 2), (5, 5), (1, 3), (4, 7))
"""Terms of which every local model has some of its own."""

SCHEDULING = ((0, 1), (1, 1))
LIMIT = 5.0
"""The feedback bound; the run stays far inside."""

START = 3
"""Measured samples a run starts from."""


def tables(models: int, terms: int, seed: int = 0) -> dict[str, Any]:
    """Factor rows, slots of every local model, coefficients, centres and widths."""
    import numpy as np

    rng = np.random.default_rng(seed)
    own = terms - len(COMMON)
    first = np.arange(len(COMMON))
    index = [
        np.concatenate([first, len(COMMON) + rng.permutation(len(OTHERS))[:own]])
        for _ in range(models)
    ]
    base = [0.05, 0.3, 0.2, 0.5, 0.2]
    return {
        "factor": np.array(COMMON + OTHERS),
        "index": np.array(index),
        "coefficient": np.array(
            [[*base, *(0.05 * rng.normal(size=own))] for _ in range(models)]
        ),
        "centre": rng.uniform(size=(models, len(SCHEDULING))),
        "width": np.full((models, len(SCHEDULING)), 0.3),
    }


def inputs(samples: int, seed: int = 1):
    """Two random levels held for some samples, within -1 and 1."""
    import numpy as np

    rng = np.random.default_rng(seed)
    columns = []
    for hold in (7, 11):
        levels = rng.uniform(-1, 1, size=-(-samples // hold))
        columns.append(np.repeat(levels, hold)[:samples])
    return np.stack(columns, axis=1)


def global_terms() -> list[tuple[tuple[int, int], ...]]:
    """The eight terms of the comparable polynomial NARX, as (signal, lag) products."""
    rows = (*COMMON, (0, 7), (1, 5), (5, 5))
    return [tuple(VARIABLES[f - 1] for f in row if f) for row in rows]
