"""A network trained by other people's solvers, on an own loss, beside `refine`.

Four test processes (see `processes.py`), one draw each: LOLIMOT with eight affine local
models, then by free-run least squares `refine`, `optimistix.least_squares` on
`jnx.residual`, and optax on a loss of one's own, a Huber loss of the free run plus a
penalty on the steady-state gain. Each is scored by the training loss of `refine`, the
mean squared NRMSE of the free run, and optax by its own loss beside that of the network
that `refine` ends with.

    python experiments/nelles/own_loss.py [--smoke] [--results DIR]

Writes own_loss.json.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix

import jaxnarx as jnx

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
sys.path.insert(0, str(Path(__file__).resolve().parent))
from common import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    record,
    results_folder,
)
from processes import PROCESSES, grown, records  # noqa: E402

MODELS, SEED = 8, 0
STEPS, RATE, CLIP = 20000, 2e-3, 0.1
"""Updates of Adam, the rate they begin with, which falls to zero, and the longest
gradient."""
LEAST = optimistix.LevenbergMarquardt(rtol=1e-8, atol=1e-8)
LEAST_STEPS = 1000
GAIN, WEIGHT, CORNER = 0.5, 0.01, 0.1
"""Of the steady-state gain: what is wanted at rest under inputs of zero, and the weight
of its square distance from it; and the error, in spreads, at which the loss bends."""


def by_least_squares(start: jnx.Network, runs: Any, steps: int) -> jnx.Network:
    """The user's script for `optimistix.least_squares`."""
    network = start
    for partition in (False, True):  # the coefficients first, then everything
        moving, fixed = eqx.partition(network, jnx.freeze(network, partition=partition))

        def errors(moving, fixed):
            return jnx.residual(eqx.combine(moving, fixed), runs)

        found = optimistix.least_squares(
            errors, LEAST, moving, fixed, max_steps=steps, throw=False
        )
        network = eqx.combine(found.value, fixed)
    return network


def own_loss(network: jnx.Network, runs: Any) -> jax.Array:
    """Huber on the free run plus a penalty on the gain at rest."""
    y, spread = jnx.free_run(network, runs), jnp.std(runs.measured, where=runs.scored)
    error = jnp.where(runs.scored, y - runs.measured, 0.0) / spread
    huber = jnp.sum(optax.huber_loss(error, delta=CORNER)) / jnp.sum(runs.scored)
    rest = lambda u: network(jnp.full((60, 1), u), "zeros")[-1, 0]  # noqa: E731
    return huber + WEIGHT * (jax.grad(rest)(0.0) - GAIN) ** 2


def by_optax(start: jnx.Network, runs: Any, steps: int) -> jnx.Network:
    """The user's script for optax and an own loss."""
    moving, fixed = eqx.partition(start, jnx.freeze(start))
    rate = optax.cosine_decay_schedule(RATE, steps)
    adam = optax.chain(optax.clip_by_global_norm(CLIP), optax.adam(rate))
    slope = jax.grad(lambda moving: own_loss(eqx.combine(moving, fixed), runs))

    def update(_, carry):
        moving, state = carry
        step, state = adam.update(slope(moving), state)
        return eqx.apply_updates(moving, step), state

    train = eqx.filter_jit(lambda carry: jax.lax.fori_loop(0, steps, update, carry))
    return eqx.combine(train((moving, adam.init(moving)))[0], fixed)


def trial(name: str, steps: int, least_steps: int) -> dict[str, Any]:
    """The losses of one process."""
    train, _, _ = records(PROCESSES[name], SEED)
    start = grown(PROCESSES[name], train, MODELS)
    runs = jnx.prepare(start, train)
    squares = eqx.filter_jit(lambda n: jnp.sum(jnx.residual(n, runs) ** 2))
    mine = eqx.filter_jit(lambda n: own_loss(n, runs))
    refined = jnx.refine(start, train).value
    least = by_least_squares(start, runs, least_steps)
    trained = by_optax(start, runs, steps)
    found = {
        "squares": {"start": start, "refine": refined, "optimistix": least},
        "own loss": {"start": start, "refine": refined, "optax": trained},
    }
    losses = {
        kind: {k: float(f(n)) for k, n in found[kind].items()}
        for kind, f in (("squares", squares), ("own loss", mine))
    }
    ratio = {
        "optimistix over refine": losses["squares"]["optimistix"]
        / losses["squares"]["refine"],
        "optax over refine": losses["own loss"]["optax"] / losses["own loss"]["refine"],
    }
    return {"process": name, **losses, "ratio": ratio}


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--smoke", action="store_true", help="a few steps of one")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    options = parser.parse_args()
    names = list(PROCESSES)[: 1 if options.smoke else None]
    counts = (5, 3) if options.smoke else (STEPS, LEAST_STEPS)
    own = None if options.smoke else str(Path(__file__).with_name("results"))
    folder = results_folder(options.results or own, smoke=options.smoke)
    rows = []
    for name in names:
        rows.append(trial(name, *counts))
        print(name, {k: round(v, 4) for k, v in rows[-1]["ratio"].items()}, flush=True)
    worst = float(np.max([r["ratio"]["optimistix over refine"] for r in rows]))
    record("own_loss", {"rows": rows, "largest ratio": worst}, folder=folder)


if __name__ == "__main__":
    main()
