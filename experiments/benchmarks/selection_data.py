"""Data and names that every worker of the selection benchmark shares.

Only the standard library is imported here: peers run in an interpreter of their own.
"""

import time
from collections.abc import Iterable
from typing import Any

SEED = 1
TERMS = 15
INPUTS = ("u1", "u2", "u3")
INPUT_LAGS = tuple(range(1, 14))
OUTPUT_LAGS = (1, 2)
VARIABLES = len(INPUTS) * len(INPUT_LAGS) + len(OUTPUT_LAGS)


def make_data(path: str, samples: int) -> dict[str, Any]:
    """White inputs through a NARX process of 15 terms with noise, into an npz file."""
    import numpy as np

    begin = time.perf_counter()
    rng = np.random.default_rng(SEED)
    u = rng.uniform(-1.0, 1.0, (samples, len(INPUTS)))
    noise = 0.02 * rng.standard_normal(samples)

    def lag(channel: int, d: int):
        return np.concatenate([np.zeros(d), u[: samples - d, channel]])

    free = (
        0.3
        + 0.9 * lag(0, 1)
        - 0.7 * lag(1, 2)
        + 0.6 * lag(2, 5)
        + 0.5 * lag(0, 3) * lag(1, 1)
        - 0.45 * lag(2, 2) ** 2
        + 0.4 * lag(1, 7) * lag(2, 1)
        + 0.35 * lag(0, 2) ** 2 * lag(2, 3)
        - 0.3 * lag(1, 4) ** 3
        + 0.28 * lag(0, 9) * lag(1, 6) * lag(2, 8)
        + 0.2 * lag(2, 12)
        + noise
    ).tolist()
    by_first = (0.45 + 0.2 * lag(0, 4)).tolist()
    by_second = (-0.15 + 0.1 * lag(2, 6)).tolist()
    y, one, two = [], 0.0, 0.0
    for constant, first, second in zip(free, by_first, by_second, strict=True):
        one, two = constant + first * one + second * two, one
        y.append(one)
    np.savez(path, u=u, y=np.array(y)[:, None])
    return {"seconds": round(time.perf_counter() - begin, 3)}


def arrays(path: str):
    """Inputs and output of the file at `path`, (time, channels)."""
    import numpy as np

    with np.load(path) as saved:
        return saved["u"], saved["y"]


def lagged_variables() -> list[tuple[int, int]]:
    """(signal, lag) of every variable; the output is the last signal."""
    lags = [(i, d) for i in range(len(INPUTS)) for d in INPUT_LAGS]
    return lags + [(len(INPUTS), d) for d in OUTPUT_LAGS]


def variable_names() -> list[str]:
    """Texts of `lagged_variables`, as jaxnarx writes them."""
    return [f"{(*INPUTS, 'y')[i]}[t-{d}]" for i, d in lagged_variables()]


def term(variables: Iterable[str]) -> str:
    """A product in a form that is comparable between tools."""
    return "*".join(sorted(variables)) or "1"
