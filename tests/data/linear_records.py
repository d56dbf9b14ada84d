"""Records of linear systems whose dead time and memory are known, under many inputs."""

import itertools

import numpy as np
from scipy.signal import lfilter

from jaxnarx.data import Dataset

ROWS = 5000
_WARM = 500


def _held(rng, rows, shortest, longest):
    """Random levels, each held for a random time."""
    count = rows // shortest + 1
    holds = rng.integers(shortest, longest + 1, size=count)
    return np.repeat(rng.uniform(-1, 1, size=count), holds)[:rows]


def _multisine(rng, rows):
    phase = rng.uniform(0, 2 * np.pi, size=40)
    turns = np.arange(rows)[:, None] * np.arange(1, 41)[None] / 1000
    return np.asarray(np.cos(2 * np.pi * turns + phase[None])).sum(axis=1)


def _smoothed(u):
    return np.asarray(lfilter([0.05], [1, -0.95], u))


INPUTS = {
    "white": lambda rng, rows: rng.normal(size=rows),
    "prbs": lambda rng, rows: np.repeat(rng.choice([-1.0, 1.0], rows // 4 + 1), 4)[
        :rows
    ],
    "aprbs": lambda rng, rows: _held(rng, rows, 5, 60),
    "steps": lambda rng, rows: _held(rng, rows, 150, 400),
    "walk": lambda rng, rows: np.cumsum(rng.normal(size=rows)),
    "periodic": _multisine,
    "oversampled": lambda rng, rows: _smoothed(_held(rng, rows, 20, 120)),
}
"""Excitations: functions of a generator and a number of rows."""

BLURRED = ("walk", "oversampled")
"""Inputs with hardly any power where a dead time shows."""


def lags(*times: float) -> np.ndarray:
    """Impulse response of a cascade of first-order lags [samples], static gain one."""
    h = np.eye(1, 3000)[0]
    for a in np.exp(-1 / np.array(times)):
        h = lfilter([1 - a], [1, -a], h)
    return np.asarray(h)


def swing(period: float, damping: float) -> np.ndarray:
    """Impulse response of a second-order system that swings, static gain one."""
    angle = 2 * np.pi / period
    pole = np.exp(angle * (-damping + 1j * np.sqrt(1 - damping**2)))
    h = lfilter([1], [1, -2 * pole.real, abs(pole) ** 2], np.eye(1, 3000)[0])
    h = np.asarray(h)
    return h / h.sum()


SYSTEMS = {
    "quick": lags(2),
    "first": lags(10),
    "slow": lags(40),
    "second": lags(10, 3),
    "swing": swing(40, 0.4),
    "cascade": lags(4, 4, 4),
    "quick and slow": 0.5 * lags(3) + 0.5 * lags(40),
    "lead": 1.5 * lags(3) - 0.5 * lags(30),
}
"""Impulse responses without dead time."""

FIRST_ORDER = ("quick", "first", "slow")


def memory(system: str, dead_time: int) -> int:
    """Lag by which 95 % of the impulse response, by magnitude, is over."""
    part = np.cumsum(np.abs(SYSTEMS[system]))
    return dead_time + int(np.argmax(part >= 0.95 * part[-1]))


def answer(u: np.ndarray, system: str, dead_time: int) -> np.ndarray:
    late = np.concatenate([np.zeros(dead_time), u])[: len(u)]
    return np.convolve(late, SYSTEMS[system])[: len(u)]


def noisy(rng, y: np.ndarray, share: float) -> np.ndarray:
    return y + share * y.std() * rng.normal(size=y.shape)


def one_input(seed: int, kind: str, system: str, dead_time: int, noise: float):
    """One record of one input and one output that stands 100 units off."""
    rng = np.random.default_rng([seed, *f"{kind}{system}{dead_time}".encode()])
    u = INPUTS[kind](rng, ROWS + _WARM)
    y = noisy(rng, answer(u, system, dead_time)[_WARM:], noise) + 100
    return Dataset.from_arrays(
        u[_WARM:], y, inputs=["u"], outputs=["y"], sample_time=0.1
    )


def three_inputs(
    seed: int, kinds: tuple[str, str, str], *, common: float, noise: float
):
    """Two records of three inputs, correlated by a `common` part, and two outputs.

    Returned with the pairs that answer: {(input, output): (system, dead time)}.
    """
    truth = {
        ("a", "y"): ("first", 0),
        ("b", "y"): ("slow", 4),
        ("c", "z"): ("second", 15),
        ("a", "z"): ("slow", 4),
    }
    gain = {("b", "y"): -1.5, ("a", "z"): 0.3}
    rng, us, ys = np.random.default_rng([seed, *"".join(kinds).encode()]), [], []
    for record in range(2):
        u = np.stack([INPUTS[k](rng, ROWS + _WARM) for k in kinds], axis=1)
        u /= u.std(axis=0)
        u[:, 1:] = (1 - common) * u[:, 1:] + common * u[:, :1]
        y = np.zeros_like(u[:, :2])
        for (i, o), (system, late) in truth.items():
            part = answer(u[:, "abc".index(i)], system, late)
            y[:, "yz".index(o)] += gain.get((i, o), 1.0) * part
        noise_of = [noisy(rng, line[_WARM:], noise) for line in y.T]
        us.append(u[_WARM:])
        ys.append(np.stack(noise_of, axis=1) + [5.0 + 3 * record, 1000.0])
    data = Dataset.from_arrays(
        us, ys, inputs=["a", "b", "c"], outputs=["y", "z"], sample_time=0.1
    )
    return data, truth


def cases() -> list[tuple[str, str, int]]:
    """(input, system, dead time): every input with every system, dead times in turn."""
    late = itertools.cycle((0, 3, 12, 30))
    return [(k, s, next(late)) for s, k in itertools.product(SYSTEMS, INPUTS)]
