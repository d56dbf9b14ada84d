"""A fleet of hysteretic systems: Bouc-Wen's oscillator, every parameter off by half.

    m y'' + c y' + k y + z = u ,
    z' = alpha y' - beta (gamma |y'| z + delta y' |z|)

with the parameters of the public benchmark (J. P. Noel, M. Schoukens, Hysteretic
benchmark with a dynamic nonlinearity, 2016), multisine forces of 50 N in 5 to 150 Hz,
integrated at 15 kHz by Runge and Kutta's fourth order, 750 samples a second. Donors and
new systems have every parameter drawn between half and one and a half of its own. The
structure, three states and eight gates, is trained on 3,000 samples of the system in
the middle. A new system is calibrated from 100 to 500 samples, and judged by the free
run over the 1,000 behind the first 500.

    python experiments/fleets/bouc_wen.py [--donors 48] [--seeds 1 2 3]

Published, for 500 samples: 3.18e-5 m in the median, by a manifold of 20 dimensions of a
network with 244 parameters, learnt for 25.3 hours; 2,000 samples were needed without it
(M. Forgione and others). `own` is a fit of the same structure to the 500 samples
alone, from subspace identification.
"""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import jaxnarx as jnx

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "benchmarks"))
from common import record, results_folder  # noqa: E402 # pyright: ignore

NOMINAL = np.array([2.0, 10.0, 5e4, 5e4, 1e3, 0.8, -1.1])
"""Mass [kg], damping [N s/m], stiffness [N/m], and alpha, beta, gamma, delta of z."""
SAMPLE_RATE, SUBSTEPS = 750.0, 20
BAND, FORCE = (5.0, 150.0), 50.0
LEAD, LENGTH = 600, 1_500
SAMPLES = 100, 200, 500
SPREAD = 0.5
MILLI = 1e3
METHOD = jnx.linear.HiddenStates(
    states=3, degree=1, gates=8, shrink=(1e-1, 1e-2, 1e-3), max_steps=20
)


def slope(
    state: Float[Array, " three"], force: Float[Array, ""], p: Float[Array, " seven"]
) -> Float[Array, " three"]:
    """Derivatives of displacement, speed and hysteretic force."""
    y, v, z = state
    bent = p[5] * jnp.abs(v) * z + p[6] * v * jnp.abs(z)
    return jnp.stack(
        [v, (force - p[2] * y - p[1] * v - z) / p[0], p[3] * v - p[4] * bent]
    )


@jax.jit
@jax.vmap
def displacement(
    force: Float[Array, " steps"], p: Float[Array, " seven"]
) -> Float[Array, " steps"]:
    """From rest, at every step of the integration."""
    h = 1 / (SAMPLE_RATE * SUBSTEPS)
    later = jnp.concatenate([force[1:], force[-1:]])

    def step(s, forces):
        now, then = forces
        middle = (now + then) / 2
        a = slope(s, now, p)
        b = slope(s + h / 2 * a, middle, p)
        c = slope(s + h / 2 * b, middle, p)
        d = slope(s + h * c, then, p)
        return s + h / 6 * (a + 2 * b + 2 * c + d), s[0]

    return jax.lax.scan(step, jnp.zeros(3), (force, later))[1]


def multisine(random: np.random.Generator, samples: int) -> np.ndarray:
    """A force with random phases, at every step of the integration."""
    count = samples * SUBSTEPS
    frequency = np.fft.rfftfreq(count, 1 / (SAMPLE_RATE * SUBSTEPS))
    inside = (frequency >= BAND[0]) & (frequency <= BAND[1])
    phase = np.exp(2j * np.pi * random.uniform(size=len(frequency)))
    u = np.fft.irfft(np.where(inside, phase, 0.0), count)
    return FORCE * u / np.sqrt(np.mean(u**2))


def systems(count: int, seed: int, length: int, spread: float) -> list[jnx.Dataset]:
    """Records of random systems, displacement in mm."""
    random = np.random.default_rng(seed)
    p = NOMINAL * (1 + spread * random.uniform(-1, 1, (count, len(NOMINAL))))
    u = np.stack([multisine(random, LEAD + length) for _ in range(count)])
    y = MILLI * np.asarray(displacement(jnp.asarray(u), jnp.asarray(p)))
    u, y = (a[:, LEAD * SUBSTEPS :: SUBSTEPS] for a in (u, y))
    return [
        jnx.Dataset.from_arrays(
            one, other, inputs="force", outputs="y", sample_time=1 / SAMPLE_RATE
        )
        for one, other in zip(u, y, strict=True)
    ]


def first(data: jnx.Dataset, samples: int) -> jnx.Dataset:
    """The first samples of a record."""
    r = data.records[0]
    names = {"inputs": "force", "outputs": "y", "sample_time": data.sample_time}
    return jnx.Dataset.from_arrays(r.u[:samples, 0], r.y[:samples, 0], **names)


def error(network: jnx.Network, data: jnx.Dataset) -> float:
    """Error of the free run behind the samples that calibrate [m]."""
    run = jnx.simulate(network, data).value.outputs[0][:, 0]
    left = (run - data.records[0].y[:, 0])[SAMPLES[-1] :]
    return float(np.sqrt(np.mean(left**2))) / MILLI


def spread_of(errors: list[float]) -> dict[str, float]:
    """Median and worst."""
    return {"median": float(np.median(errors)), "worst": float(np.max(errors))}


def measured(seed: int, donors: int, new: int, small: bool) -> dict[str, Any]:
    """All figures of a seed."""
    method = METHOD
    if small:
        method = jnx.linear.HiddenStates(
            states=3, degree=1, shrink=(1e-2,), max_steps=3
        )
    begin = time.perf_counter()
    middle = systems(1, 1_000 + seed, 300 if small else 3_000, 0.0)[0]
    network = jnx.linear.fit_states(middle, method).value
    structure = time.perf_counter() - begin
    length = 700 if small else LENGTH
    some = systems(donors, 2_000 + seed, length, SPREAD)
    begin = time.perf_counter()
    found = jnx.fleet.learn(
        {f"system {n}": one for n, one in enumerate(some)}, network, rungs=SAMPLES
    )
    learning = time.perf_counter() - begin
    rest = systems(new, 3_000 + seed, length, SPREAD)
    rows: dict[str, Any] = {
        "seconds of structure": round(structure, 1),
        "seconds of learning": round(learning, 1),
        "broken": found.stats["broken"],
        "deviation of the output [m]": float(
            np.median([d.records[0].y.std() / MILLI for d in rest])
        ),
        "mean of the fleet": spread_of([error(found.value.network, d) for d in rest]),
    }
    for samples in SAMPLES:
        begin = time.perf_counter()
        every = [jnx.fleet.calibrate(found.value, first(d, samples)) for d in rest]
        seconds = (time.perf_counter() - begin) / new
        errors = [error(c.value, d) for c, d in zip(every, rest, strict=True)]
        rows[f"{samples} samples"] = spread_of(errors) | {
            "diverged": sum(c.status_name == "diverged" for c in every),
            "seconds each": round(seconds, 2),
        }
        print(seed, samples, rows[f"{samples} samples"], flush=True)
    if not small:
        own = []
        for d in rest[:8]:
            fit = jnx.linear.fit_states(first(d, SAMPLES[-1]), method)
            own.append(error(fit.value, d))
        rows["own, 500 samples, of eight"] = spread_of(own)
        print(seed, rows, flush=True)
    return rows


def main() -> None:
    """Measure and record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--donors", type=int, default=48)
    parser.add_argument("--new", type=int, default=24)
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3])
    parser.add_argument("--smoke", action="store_true", help="few systems")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    folder = results_folder(options.results, smoke=options.smoke)
    donors, new, seeds = options.donors, options.new, options.seeds
    if options.smoke:
        donors, new, seeds = 4, 2, seeds[:1]
    found = {str(seed): measured(seed, donors, new, options.smoke) for seed in seeds}
    last = f"{SAMPLES[-1]} samples"
    figures = {
        "500 samples, median of seeds [m]": float(
            np.median([rows[last]["median"] for rows in found.values()])
        ),
        "published [m]": 3.18e-5,
        "donors": donors,
        "new": new,
        "seeds": found,
    }
    record("fleet_bouc_wen", figures, folder=folder)


if __name__ == "__main__":
    main()
