"""Six plants with hidden states, of one input and one output."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

Signal = np.ndarray
LENGTH, TEST, NOISE = 700, 1500, 0.01
"""Samples of a record and of another that says the truth, noise on the first."""


def stairs(rng: Any, length: int, low: float, high: float, holds: range) -> Signal:
    """Random levels, each held for a random time."""
    out: list[float] = []
    while len(out) < length:
        hold = int(rng.integers(holds.start, holds.stop))
        out += [float(rng.uniform(low, high))] * hold
    return np.array(out[:length])


def smooth(rng: Any, length: int, over: int) -> Signal:
    """White noise, averaged."""
    noise = rng.normal(size=length + 20)
    return 4 * np.convolve(noise, np.ones(over) / over, "same")[10 : 10 + length]


def tanks(u: Signal) -> Signal:
    """Two tanks, one above the other; what flows over the upper one falls in part into
    the lower one. Its level is measured."""
    upper = lower = 4.0
    y = []
    for v in u:
        for _ in range(4):
            over = max(0.0, upper - 9) * 2
            out = 0.525 * math.sqrt(upper)
            upper = min(max(upper + 0.25 * (0.28 * v - out - over), 0.0), 10.0)
            gain = out - 0.5 * math.sqrt(lower) + 0.5 * over
            lower = min(max(lower + 0.25 * gain, 0.0), 10.0)
        y.append(lower)
    return np.array(y)


def drives(u: Signal) -> Signal:
    """A belt on a spring; a filter measures its speed without the sign."""
    speed = rate = seen = 0.0
    y = []
    for v in u:
        for _ in range(5):
            rate += 0.1 * (1.35 * v - 1.2 * rate - 0.9 * speed)
            speed += 0.1 * rate
            seen += 0.07 * (speed - seen)
        y.append(abs(seen))
    return np.array(y)


def bouc(u: Signal) -> Signal:
    """A mass on a spring with hysteresis, R. Bouc 1967, Y. Wen 1976."""
    place = speed = force = 0.0
    y = []
    for v in u:
        for _ in range(10):
            rise = speed - 0.8 * abs(speed) * force - 0.4 * speed * abs(force)
            force += 0.05 * rise
            speed += 0.05 * (v - 0.6 * speed - 0.8 * place - 1.2 * force)
            place += 0.05 * speed
        y.append(place)
    return np.array(y)


def duffing(u: Signal) -> Signal:
    """A mass on a spring that stiffens."""
    place = speed = 0.0
    y = []
    for v in u:
        for _ in range(10):
            speed += 0.06 * (v - 0.3 * speed - place - 0.5 * place**3)
            place += 0.06 * speed
        y.append(place)
    return np.array(y)


def between(u: Signal) -> Signal:
    """A saturation between two linear parts (Wiener-Hammerstein)."""
    before = rate = after = 0.0
    y = []
    for v in u:
        before += 0.3 * (v - before)
        bent = math.tanh(1.5 * before) + 0.2 * before
        rate += 0.25 * (bent - after - 0.8 * rate)
        after += 0.5 * rate
        y.append(after)
    return np.array(y)


def heat(u: Signal) -> Signal:
    """A wall heated by a source that weakens as it warms, and a sensor behind it."""
    wall = sensor = 20.0
    y = []
    for v in u:
        loss = 0.04 * (wall - 20) + 0.15 * (wall - sensor) + 2e-5 * (wall**2 - 400)
        wall += 0.2 * (3 * v * (1 - 0.01 * wall) - loss)
        sensor += 0.1 * (wall - sensor) - 0.01 * (sensor - 20)
        y.append(sensor)
    return np.array(y)


PLANTS: dict[str, tuple[Callable[[Signal], Signal], Callable[[Any, int], Signal]]] = {
    "tanks": (tanks, lambda rng, n: stairs(rng, n, 1.5, 7.0, range(5, 30))),
    "drives": (drives, lambda rng, n: stairs(rng, n, -1.5, 1.5, range(10, 40))),
    "bouc": (bouc, lambda rng, n: smooth(rng, n, 8)),
    "duffing": (duffing, lambda rng, n: smooth(rng, n, 6)),
    "between": (between, lambda rng, n: stairs(rng, n, -2.0, 2.0, range(2, 15))),
    "heat": (heat, lambda rng, n: stairs(rng, n, 0.0, 6.0, range(5, 40))),
}


def records(name: str, seed: int, length: int = LENGTH) -> tuple[Any, Any, float]:
    """A record with noise to train, one without for the truth, and their spread."""
    import jaxnarx as jnx

    plant, signal = PLANTS[name]
    rng = np.random.default_rng([seed, *map(ord, name)])
    u, far = signal(rng, length), signal(rng, TEST)
    clean, truth = plant(u), plant(far)
    spread = float(clean.std())
    noisy = clean + NOISE * spread * rng.normal(size=length)

    def data(u: Signal, y: Signal) -> Any:
        about: dict[str, Any] = {"inputs": ["u"], "outputs": ["y"], "sample_time": 1}
        return jnx.Dataset.from_arrays([u[:, None]], [y[:, None]], **about)

    return data(u, noisy), data(far, truth), spread
