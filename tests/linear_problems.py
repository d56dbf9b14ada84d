"""Known linear systems and the data they give, by scipy's filter."""

import numpy as np
import scipy.signal

from jaxnarx.data import Dataset
from jaxnarx.settings.linear import ARMAX, ARX, BoxJenkins, GeneralLinear, OutputError

B, DELAY = [100.0, 50.0], 2
F = [1.0, -1.5, 0.7]
A = [1.0, -0.9]
C, D = [1.0, 0.6], [1.0, -0.8]
LEVEL, MEAN = 1000.0, 0.395
"""The output [rpm] at the mean input."""

NUMERATOR = [0.0] * DELAY + B

SETTINGS = {
    "ARX": ARX(2, 2, 2),
    "ARMAX": ARMAX(2, 2, 1, 2),
    "OE": OutputError(2, 2, 2),
    "BJ": BoxJenkins(2, 1, 1, 2, 2),
    "general": GeneralLinear(1, 2, 1, 1, 2, 2),
}
NOISE = {
    "ARX": ([1.0], F),
    "ARMAX": (C, F),
    "OE": ([1.0], [1.0]),
    "BJ": (C, D),
    "general": (C, np.convolve(A, [1.0, 0.5]).tolist()),
}
PLANT = dict.fromkeys(NOISE, F) | {"general": np.convolve(A, F).tolist()}
GAIN = sum(B) / sum(F)
TRUE = {
    "ARX": [*F[1:], *B, sum(F) * (LEVEL - GAIN * MEAN)],
    "ARMAX": [*F[1:], *B, C[1], sum(F) * (LEVEL - GAIN * MEAN)],
    "OE": [*B, *F[1:], LEVEL - GAIN * MEAN],
    "BJ": [*B, C[1], D[1], *F[1:], LEVEL - GAIN * MEAN],
    "general": [A[1], *B, C[1], 0.5, *F[1:], sum(A) * LEVEL - GAIN * MEAN],
}


def staircase(rng: np.random.Generator, samples: int, hold: int = 4) -> np.ndarray:
    """Levels between 0.38 and 0.41, each held for `hold` samples."""
    levels = rng.uniform(0.38, 0.41, -(-samples // hold))
    return np.repeat(levels, hold)[:samples]


def record(kind: str, seed: int, samples: int, noise: float = 1.0):
    """Input and output of one of the systems in steady operation."""
    rng = np.random.default_rng(seed)
    before = 200
    u = staircase(rng, samples + before)
    e = noise * rng.normal(size=samples + before)
    w = scipy.signal.lfilter(NUMERATOR, PLANT[kind], u - MEAN)
    y = LEVEL + np.asarray(w) + scipy.signal.lfilter(*NOISE[kind], e)
    return u[before:], y[before:]


def dataset(us, ys, missing: str = "refuse") -> Dataset:
    """Records of duty and speed at 0.03 s."""
    return Dataset.from_arrays(
        us,
        ys,
        inputs=["duty"],
        outputs=["speed"],
        sample_time=0.03,
        units={"speed": "rpm"},
        missing=missing,
    )


def records(kind: str, seeds, samples: int, noise: float = 1.0) -> Dataset:
    """One record a seed."""
    pairs = [record(kind, seed, samples, noise) for seed in seeds]
    return dataset([u for u, _ in pairs], [y for _, y in pairs])
