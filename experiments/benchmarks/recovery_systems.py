"""Random ten-term systems on engine-like inputs.

Inputs u1 ... u4 are AR(1) with pole 0.95, zero mean and unit variance: neighbouring
lags correlate with 0.95. The generator was fixed before any method was run on it.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from recovery_pool import INPUT_LAGS, INPUTS, OUTPUT_LAGS, name

POLE, NOISE_DB, WARM_UP = 0.95, 30.0, 500
MAGNITUDE = (0.5, 1.0)
"""Coefficients of the terms in inputs only, of either sign."""
FEEDBACK = (0.3, 0.6)
"""Coefficient of y[t-1]."""
BILINEAR = (0.05, 0.1)
"""Coefficient of the product of an output lag and an input lag, of either sign."""
RADIUS = 0.98
"""Largest modulus of the poles with the inputs held at any one sample."""

Variable = tuple[str, int]
"""Channel and lag; a term is one or two of them."""


@dataclass(frozen=True)
class System:
    """y(t) = constant + sum of coefficient times the term's product + e(t)."""

    constant: float
    terms: tuple[tuple[Variable, ...], ...]
    coefficients: tuple[float, ...]

    @property
    def names(self) -> list[str]:
        """The ten terms as texts that are comparable between tools."""
        return [name(f"{c}[t-{d}]" for c, d in term) for term in self.terms]


def draw_system(rng: np.random.Generator) -> System:
    """y[t-1], three linear input terms, five products of inputs, one of y and an input.

    The nine others are drawn without repetition, each kind with equal chances, so
    neighbouring lags of one input may both be true. A constant comes on top, as the
    inputs of an engine have offsets; it is not among the ten.
    """
    lags = [(channel, d) for channel in INPUTS for d in INPUT_LAGS]
    pairs = [(a, b) for i, a in enumerate(lags) for b in lags[i:]]
    linear = [(lags[i],) for i in rng.choice(len(lags), 3, replace=False)]
    products = [pairs[i] for i in rng.choice(len(pairs), 5, replace=False)]
    mixed = (("y", int(rng.choice(OUTPUT_LAGS))), lags[rng.integers(len(lags))])
    terms = ((("y", 1),), *linear, *products, mixed)
    sign = rng.choice([-1.0, 1.0], 10)
    values = sign * np.r_[1.0, rng.uniform(*MAGNITUDE, 8), rng.uniform(*BILINEAR)]
    values[0] = rng.uniform(*FEEDBACK)
    return System(float(rng.uniform(*MAGNITUDE)), terms, tuple(values.tolist()))


def draw_inputs(
    rng: np.random.Generator, samples: int
) -> Float[np.ndarray, "time inputs"]:
    """Four AR(1) signals started in their stationary distribution."""
    u = rng.standard_normal((samples, len(INPUTS)))
    for t in range(1, samples):
        u[t] = POLE * u[t - 1] + np.sqrt(1 - POLE**2) * u[t]
    return u


def is_stable(system: System, u: Float[np.ndarray, "time inputs"]) -> bool:
    """Whether the poles stay inside `RADIUS` with the inputs held at each sample."""
    feedback = np.zeros((len(u), 2))
    for term, value in zip(system.terms, system.coefficients, strict=True):
        if term[0][0] == "y":
            factor = np.ones(len(u))
            for channel, d in term[1:]:
                factor = _lag(u[:, INPUTS.index(channel)], d)
            feedback[:, term[0][1] - 1] += value * factor
    companion = np.zeros((len(u), 2, 2))
    companion[:, 0], companion[:, 1, 0] = feedback, 1.0
    return bool(np.abs(np.linalg.eigvals(companion)).max() < RADIUS)


def run(
    system: System,
    u: Float[np.ndarray, "time inputs"],
    noise: Float[np.ndarray, " time"],
) -> Float[np.ndarray, " time"]:
    """The output from zero start; `noise` enters the equation."""
    signals = {channel: _lagged(u[:, i]) for i, channel in enumerate(INPUTS)}
    free, gain = system.constant + noise, np.zeros((3, len(u)))
    for term, value in zip(system.terms, system.coefficients, strict=True):
        factor = value * np.ones(len(u))
        for channel, d in term:
            if channel != "y":
                factor = factor * signals[channel][d]
        if term[0][0] == "y":
            gain[term[0][1]] += factor
        else:
            free = free + factor
    y, one, two = [], 0.0, 0.0
    for c, a, b in zip(free.tolist(), gain[1].tolist(), gain[2].tolist(), strict=True):
        one, two = c + a * one + b * two, one
        y.append(one)
    return np.array(y)


def _lag(signal: Float[np.ndarray, " time"], d: int) -> Float[np.ndarray, " time"]:
    return np.concatenate([np.zeros(d), signal[: len(signal) - d]])


def _lagged(signal: Float[np.ndarray, " time"]) -> dict[int, np.ndarray]:
    return {d: _lag(signal, d) for d in INPUT_LAGS}


def make(
    seed: int, samples: int, *, fixed: int | None = None
) -> tuple[System, Float[np.ndarray, "time inputs"], Float[np.ndarray, " time"]]:
    """System, inputs and output of one seed; `fixed` names a system of its own seed.

    System and inputs are drawn again until the system is stable on these inputs. The
    noise is `NOISE_DB` below the standard deviation of the noise-free output.
    """
    rng = np.random.default_rng((seed, samples))
    while True:
        source = rng if fixed is None else np.random.default_rng(fixed)
        system = draw_system(source)
        u = draw_inputs(rng, samples + WARM_UP)
        if is_stable(system, u):
            break
    clean = run(system, u, np.zeros(len(u)))[WARM_UP:]
    scale = 10 ** (-NOISE_DB / 20) * clean.std()
    y = run(system, u, scale * rng.standard_normal(len(u)))
    return system, u[WARM_UP:], y[WARM_UP:]
