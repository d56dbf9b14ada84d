"""Times of one sample of predictive control, beside IPOPT on the same problem.

The network of the turbocharged engine of `tracking.py` (torque and lambda by spark and
throttle, a horizon of 20 samples, no limits of outputs): 200 samples of a record are
gone through by `Controller.step`, in one compiled loop and from Python, and by CasADi's
IPOPT with the functions that `jnx.export(..., to=["casadi"])` writes, single shooting
in the same blocks, from the same start, with exact second derivatives. Both are given
the same errors and references in every sample. How far our plan is from IPOPT's after
one step of sequential quadratic programming, and after twelve, stands beside it.

    python experiments/control/speed.py [--samples 200]
"""

import argparse
import dataclasses
import importlib.util
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

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "benchmarks"), str(HERE)]
from common import record, results_folder  # noqa: E402 # pyright: ignore
from tracking import BEDS, LENGTH, Bench  # noqa: E402 # pyright: ignore

TASK = "spark and throttle"
ROUNDS = 12


def exported(network: jnx.Network, data: jnx.Dataset) -> Any:
    """The module that the export to CasADi has written."""
    files = jnx.export(network, data, to=["casadi"], name="engine").files
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "engine_casadi.py"
        path.write_text(str(files[path.name]))
        spec = importlib.util.spec_from_file_location("engine_casadi", path)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    return module


class Rival:
    """The same problem for IPOPT: free are the commands of all blocks."""

    def __init__(self, controller: Controller, module: Any):
        import casadi as ca

        self.controller, self.module = controller, module
        horizon, count = controller.horizon, len(controller.commands)
        blocks = np.array(controller.blocks)
        of_block = np.searchsorted(blocks, np.arange(horizon), side="right") - 1
        order = [controller.input_names.index(n) for n in module.INPUTS]
        free = ca.SX.sym("z", len(blocks) * count)
        x = ca.SX.sym("x", len(module.STATES))
        before = ca.SX.sym("before", count)
        given = ca.SX.sym("given", len(controller.given))
        wanted = ca.SX.sym("wanted", len(controller.targets))
        error = ca.SX.sym("error", horizon * len(controller.targets))
        size, span = np.asarray(controller.size), np.asarray(controller.span)
        cost, now, last = 0, x, before
        for b in range(len(blocks)):
            u = free[b * count : (b + 1) * count]
            moves = (u - last) / span
            cost += ca.dot(np.asarray(controller.effort), moves**2)
            last = u
        for k in range(horizon + 1):
            b = of_block[min(k, horizon - 1)]
            row: list[Any] = [0] * len(order)
            for n, c in enumerate(controller.commands):
                row[c] = free[b * count + n]
            for n, c in enumerate(controller.given):
                row[c] = given[n]
            now, y = module.step(now, ca.vertcat(*[row[c] for c in order]))
            for n, o in enumerate(controller.targets if k else ()):
                off = error[(k - 1) * len(controller.targets) + n]
                cost += ((y[o] + off - wanted[n]) / size[o]) ** 2 / horizon
        self.low = np.tile(np.asarray(controller.low), len(blocks))
        self.high = np.tile(np.asarray(controller.high), len(blocks))
        problem = {"x": free, "f": cost}
        problem["p"] = ca.vertcat(x, before, given, wanted, error)
        silent = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes"}}
        self.solver = ca.nlpsol("solver", "ipopt", problem, silent)

    def solve(self, start: np.ndarray, *known: np.ndarray) -> np.ndarray:
        """The commands of all blocks."""
        values = np.concatenate([np.ravel(k) for k in known])
        bounds = {"lbx": self.low, "ubx": self.high}
        found = self.solver(x0=start.ravel(), p=values, **bounds)["x"]
        return np.asarray(found).reshape(start.shape)


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

    def made(rounds: int) -> Controller:
        return jnx.control.mpc(
            network, commands, targets, rounds=rounds, records=bench.left
        ).value

    ours, exact = made(1), made(ROUNDS)
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

    run = jax.jit(lambda state: loop(ours, state))
    compiled = -time.perf_counter()
    run(first).block_until_ready()
    compiled += time.perf_counter()
    figures: dict[str, Any] = {"compiling [s]": compiled, "samples": samples}
    spent = []
    for _ in range(5):
        begun = time.perf_counter()
        run(first).block_until_ready()
        spent.append(time.perf_counter() - begun)
    figures["a step, in a loop [ms]"] = 1e3 * min(spent) / samples

    module = exported(network, bench.left)
    rival = Rival(ours, module)
    blocks, span = np.array(ours.blocks), np.asarray(ours.span)
    ahead = np.arange(1, ours.horizon + 1)
    order = [names.index(n) for n in module.INPUTS]
    state, x = first, module.begin(row.u[0][order], y[0])
    pole = np.asarray(ours.statistics.pole)
    times, rivals, near, nearer = [], [], [], []
    for t in range(samples):
        begun = time.perf_counter()
        after, decision = ours.step(state, y[t], wanted[t], given[t])
        jax.block_until_ready(decision.commands)
        times.append(time.perf_counter() - begun)
        best = exact.step(state, y[t], wanted[t], given[t])[1]
        # What the observer expects of errors, from its state after this measurement.
        offset = np.asarray(after.estimate.offset)
        fading = np.asarray(after.estimate.fading) / np.where(pole > 0, pole, 1.0)
        error = offset[None] + pole[None] ** ahead[:, None] * fading[None]
        before = np.asarray(state.u)[list(ours.commands)]
        own = error[:, list(ours.targets)]
        start = np.asarray(state.plan)[blocks]
        begun = time.perf_counter()
        plan = rival.solve(start, np.asarray(x), before, given[t], wanted[t], own)
        rivals.append(time.perf_counter() - begun)
        near.append(np.abs((decision.commands - plan[0]) / span).max())
        nearer.append(np.abs((best.commands - plan[0]) / span).max())
        x = module.step(x, np.asarray(after.u)[order])[0]
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
