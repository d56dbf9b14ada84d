"""Times of one sample of predictive control, beside IPOPT on the same problem.

The network of the turbocharged engine of `tracking.py` (torque and lambda by spark and
throttle, a horizon of 20 samples, no limits of outputs): 200 samples of a record are
gone through by `Controller.step`, in one compiled loop and from Python, and by CasADi's
IPOPT by `jnx.control.through_casadi`, single shooting in the same blocks, from the same
start, with exact second derivatives, from the same state in every sample. How far our
plan is from IPOPT's after one step of sequential quadratic programming, and after
twelve, stands beside it. Our own default, which estimates states and keeps to the
network's domain, is timed in a loop too, and so is the C of either.

    python experiments/control/speed.py [--samples 200]
"""

import argparse
import dataclasses
import functools
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxnarx as jnx
from jaxnarx.control import Controller
from jaxnarx.exporters import controller_runner, write_files

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "benchmarks"), str(HERE)]
from common import record, results_folder  # noqa: E402 # pyright: ignore
from tracking import BEDS, LENGTH, Bench  # noqa: E402 # pyright: ignore

TASK = "spark and throttle"
ROUNDS = 12


def time_c(
    controller: Controller, name: str, rows: tuple[np.ndarray, ...], samples: int
) -> dict[str, float]:
    """Seconds to write, compile and prove the C, and its time a step."""
    begun = time.perf_counter()
    found = jnx.control.export_controller(controller)
    built = time.perf_counter() - begun
    u, y, wanted, given = rows
    shape = controller.horizon, 1
    wanted, given = (np.tile(a[:samples, None], shape) for a in (wanted, given))
    sizes = {"commands": len(controller.commands), "limits": len(controller.bounded)}
    with tempfile.TemporaryDirectory() as place:
        write_files(Path(place), found.files)
        run = controller_runner(Path(place), "model", **sizes)
        spent = []
        for _ in range(5):
            begun = time.perf_counter()
            run(u, np.concatenate([y[:1], y[:samples]]), wanted, given)
            spent.append(time.perf_counter() - begun)
    return {
        f"C, {name}: a step [ms]": 1e3 * min(spent) / samples,
        f"C, {name}: written, compiled, proven [s]": built,
        f"C, {name}: decisions off by, shares of ranges": max(
            found.difference.values()
        ),
    }


def main() -> None:
    """Measure and record."""
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=200)
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    parser.add_argument("--smoke", action="store_true", help="few samples")
    options = parser.parse_args()
    bench = Bench(BEDS["gtdi"], 1, 400 if options.smoke else LENGTH)
    samples = 20 if options.smoke else options.samples
    commands, targets, _ = bench.bed.tasks[TASK]
    network = dataclasses.replace(bench.network, domain=None)

    def made(model: jnx.Network, rounds: int, own: bool | None = None) -> Controller:
        more = {"rounds": rounds, "records": bench.left, "observe_states": own}
        return jnx.control.mpc(model, commands, targets, **more).value

    # CasADi has neither our states nor the domain; by default there are both.
    whole = made(bench.network, 1)
    ours, exact = (made(network, n, False) for n in (1, ROUNDS))
    (row,) = bench.left.records
    names = ours.input_names
    given = row.u[:, [names.index(n) for n in ours.given_names]]
    places = [bench.plant.outputs.index(n) for n in network.output_names]
    y = row.y[:, places]
    wanted = y[:, list(ours.targets)]
    first = ours.begin(row.u[0], y[0])

    def loop(controller: Controller, state: Any) -> Any:
        known = jnp.asarray(y), jnp.asarray(wanted), jnp.asarray(given)

        def sample(state, t):
            measured, asked, others = (k[t] for k in known)
            return controller.step(state, measured, asked, others)

        return jax.lax.scan(sample, state, jnp.arange(samples))[1].commands

    figures: dict[str, Any] = {"samples": samples}
    for name, one in {"in a loop": ours, "with states and domain": whole}.items():
        run = jax.jit(functools.partial(loop, one))
        begun, state = time.perf_counter(), one.begin(row.u[0], y[0])
        run(state).block_until_ready()
        figures[f"compiling, {name} [s]"] = time.perf_counter() - begun
        spent = []
        for _ in range(5):
            begun = time.perf_counter()
            run(state).block_until_ready()
            spent.append(time.perf_counter() - begun)
        figures[f"a step, {name} [ms]"] = 1e3 * min(spent) / samples

        figures |= time_c(one, name, (row.u[0], y, wanted, given), samples)

    rival, span = jnx.control.through_casadi(ours), np.asarray(ours.span)
    state, other = first, rival.begin(row.u[0], y[0])
    times, rivals, near, nearer = [], [], [], []
    for t in range(samples):
        known = y[t], wanted[t], given[t]
        begun = time.perf_counter()
        after, decision = ours.step(state, *known)
        jax.block_until_ready(decision.commands)
        times.append(time.perf_counter() - begun)
        best = exact.step(state, *known)[1]
        begun = time.perf_counter()
        # From where we stand: only this sample is compared.
        found = rival.step(other._replace(control=state), *known)[1]
        rivals.append(time.perf_counter() - begun)
        near.append(np.abs((decision.commands - found.commands) / span).max())
        nearer.append(np.abs((best.commands - found.commands) / span).max())
        set_now = np.asarray(after.u)[rival.order]
        other = other._replace(x=rival.module.f(other.x, set_now).full().ravel())
        state = after
    figures |= {
        "a step, from Python [ms]": 1e3 * float(np.median(times)),
        "IPOPT through CasADi, from Python [ms]": 1e3 * float(np.median(rivals)),
        "IPOPT over ours, from Python": float(np.median(rivals) / np.median(times)),
        "first command from IPOPT's, shares of its range, one round": {
            "median": float(np.median(near)),
            "largest": float(np.max(near)),
        },
        f"the same, {ROUNDS} rounds": {
            "median": float(np.median(nearer)),
            "largest": float(np.max(nearer)),
        },
    }
    print(figures)
    folder = results_folder(options.results, smoke=options.smoke)
    record("control_speed", figures, folder=folder)


if __name__ == "__main__":
    main()
