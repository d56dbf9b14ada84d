"""The problem of a controller handed to a solver of CasADi, such as IPOPT.

The solver minimises the cost of `jaxnarx.control.controller` over the same blocks of
commands, with the errors that the same observer expects. Every sample is solved to the
end, with exact second derivatives, by single shooting through the functions that
`jnx.export(network, to=["casadi"])` writes.
"""

import dataclasses
import importlib.util
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import program
from jaxnarx.control.controller import (
    Controller,
    ControlState,
    Decision,
    Values,
    decide,
    over_horizon,
)
from jaxnarx.control.observer import Estimate, correct, expected_errors
from jaxnarx.control.planning import LINEAR, SQUARE, block_of, command_bounds
from jaxnarx.errors import SpecError
from jaxnarx.exporters import export, import_page
from jaxnarx.files import TemporaryFolder

SILENT: dict[str, dict[str, Any]] = {
    "ipopt": {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes"}}
}
"""Options by solver, so that none writes."""


class CasadiState(NamedTuple):
    """The memory of a controller, and the state of the model as CasADi has it."""

    control: ControlState
    x: np.ndarray


@guard_arguments
def through_casadi(
    controller: Controller,
    *,
    solver: str = "ipopt",
    options: Mapping[str, Any] | None = None,
) -> "CasadiController":
    """Hand the problem of a controller to a solver of CasADi.

    Beside a controller of `jnx.control.mpc` it tells what one step of sequential
    quadratic programming a sample loses, at ten times the time or so. The border of the
    network's domain is not handed over, and a run at its bounds does not begin anew.

    Args:
        controller: What is to be solved; made with `observe_states=False`.
        solver: Name of a solver of nonlinear programs that CasADi has.
        options: Its options; by default IPOPT is silent, and others have their own.

    Returns:
        A controller with the same `begin` and `step`, on the host.

    Raises:
        SpecError: CasADi is not installed, or the controller estimates states.

    Example:
        free = {"a": jnx.control.Command()}
        controller = jnx.control.mpc(network, free, ["y"], observe_states=False).value
        exact = jnx.control.through_casadi(controller)
        print(exact.controller.command_names)
    """
    if importlib.util.find_spec("casadi") is None:
        raise SpecError(
            "through_casadi needs CasADi, which is not installed: pip install casadi",
            field="solver",
        )
    if controller.observe_states:
        raise SpecError(
            "the controller estimates states, and CasADi's functions have others; "
            "make it with observe_states=False, of a network without hidden states",
            field="controller",
        )
    chosen = SILENT.get(solver, {}) if options is None else options
    return CasadiController(controller, solver, chosen)


class CasadiController:
    """Steps of a controller, each solved by a solver of CasADi."""

    def __init__(self, controller: Controller, solver: str, options: Mapping[str, Any]):
        """See `through_casadi`."""
        import casadi as ca

        self.controller = dataclasses.replace(controller, domain=None)
        files = export(controller.network, to=["casadi"], name="m", verify=False).files
        with TemporaryFolder() as folder:
            path = Path(folder) / "m_casadi.py"
            path.write_text(str(files[path.name]))
            self.module = import_page(path)
        names = controller.input_names
        self.order = [names.index(name) for name in self.module.INPUTS]
        self.slack = len(controller.bounded)
        problem, self.rows = self._problem(ca)
        self.solver = ca.nlpsol("solver", solver, problem, dict(options))

    def _problem(self, ca: Any) -> tuple[dict[str, Any], tuple[np.ndarray, np.ndarray]]:
        """The program, and bounds of its constraints that do not change."""
        own = self.controller
        horizon, count, blocks = own.horizon, len(own.commands), len(own.blocks)
        free = ca.SX.sym("z", blocks, count)
        soft = ca.SX.sym("soft", self.slack)
        x, before = ca.SX.sym("x", len(self.module.STATES)), ca.SX.sym("before", count)
        given = ca.SX.sym("given", horizon, len(own.given))
        wanted = ca.SX.sym("wanted", horizon, len(own.targets))
        errors = ca.SX.sym("errors", horizon, len(own.size))
        span, size = np.asarray(own.span), np.asarray(own.size)
        effort, weight = np.asarray(own.effort), np.asarray(own.weight)
        cost, moves, last, now = 0, [], before, x
        for b in range(blocks):
            move = (free[b, :].T - last) / span
            moves.append(move)
            cost += ca.dot(effort, move**2)
            last = free[b, :].T
        places, limited = block_of(own), []
        for k in range(horizon + own.first):
            at = min(k, horizon - 1)
            row: list[Any] = [0] * len(self.order)
            for n, c in enumerate(own.commands):
                row[c] = free[int(places[at]), n]
            for n, c in enumerate(own.given):
                row[c] = given[at, n]
            now, y = self.module.step(now, ca.vertcat(*(row[c] for c in self.order)))
            if k < own.first:
                continue
            y = (y + errors[k - own.first, :].T) / size
            aim = wanted[k - own.first, :].T
            for n, o in enumerate(own.targets):
                cost += weight[n] * (y[o] - aim[n] / size[o]) ** 2 / horizon
            for n, o in enumerate(own.bounded):
                limited += [y[o] - soft[n], y[o] + soft[n]]
        cost += LINEAR * ca.sum1(soft) + SQUARE * ca.sumsqr(soft)
        problem = {
            "x": ca.vertcat(ca.vec(free.T), soft),
            "f": cost,
            "g": ca.vertcat(*moves, *limited),
            "p": ca.vertcat(x, before, *(ca.vec(a.T) for a in (given, wanted, errors))),
        }
        reach = np.tile(np.asarray(own.move / own.span), blocks)
        at = np.array(own.bounded, int)
        ends = np.asarray(own.ceiling - own.guard), np.asarray(own.floor + own.guard)
        high, low = (end / size[at] for end in ends)
        nothing = np.full_like(high, np.inf)
        highs = np.tile(np.stack([high, nothing], axis=1).ravel(), horizon)
        lows = np.tile(np.stack([-nothing, low], axis=1).ravel(), horizon)
        return problem, (np.append(-reach, lows), np.append(reach, highs))

    def begin(self, u: Values, measured: Values) -> CasadiState:
        """The state of a plant at rest under these inputs, with these outputs."""
        control = self.controller.begin(u, measured)
        row = np.asarray(u, float)
        rest = self.controller.network.step(control.estimate.x, jnp.asarray(row))[1]
        x = self.module.begin(row[self.order], np.asarray(rest)).full().ravel()
        return CasadiState(control, x)

    def step(
        self,
        state: CasadiState,
        measured: Values,
        reference: Values,
        given: Values | None = None,
    ) -> tuple[CasadiState, Decision]:
        """Decide what to set now; as `Controller.step`."""
        own, control = self.controller, state.control
        kind = own.low.dtype
        others = np.zeros(0) if given is None else given
        wanted = over_horizon(reference, (own.horizon, len(own.targets)), kind)
        rows = over_horizon(others, (own.horizon, len(own.given)), kind)
        now, errors = _see(own, control, jnp.asarray(measured, kind))
        before = np.asarray(control.u)[list(own.commands)]
        low, high = (
            np.asarray(end) for end in command_bounds(own, jnp.asarray(before, kind))
        )
        plan = np.asarray(control.plan)[list(own.blocks)]
        known = [state.x, before, *(np.ravel(a) for a in (rows, wanted, errors))]
        nothing, endless = np.zeros(self.slack), np.full(self.slack, np.inf)
        found = self.solver(
            x0=np.append(plan.ravel(), nothing),
            p=np.concatenate(known),
            lbx=np.append(low.ravel(), nothing),
            ubx=np.append(high.ravel(), endless),
            lbg=self.rows[0],
            ubg=self.rows[1],
        )
        solved = bool(self.solver.stats()["success"])
        z = found["x"].full().ravel()
        if solved:
            plan = z[: plan.size].reshape(plan.shape)
        whole = jnp.asarray(plan[block_of(own)], kind)
        excess = (
            jnp.asarray(z[plan.size :] * solved, kind)
            * own.size[np.array(own.bounded, int)]
        )
        after, decision = _decide(own, control, now, whole, excess, solved, rows)
        u = np.asarray(after.u)[self.order]
        x = self.module.f(state.x, u).full().ravel()
        return CasadiState(after, x), decision


@program
def _see(
    controller: Controller, state: ControlState, measured: Float[Array, " outputs"]
) -> tuple[Estimate, Float[Array, "horizon outputs"]]:
    """The estimate now, and the errors that are expected over the horizon."""
    network, known = controller.network, controller.statistics
    now = correct(network, known, state.estimate, state.u, measured, states=False)
    ahead = controller.first + jnp.arange(controller.horizon)
    return now, expected_errors(known, now, ahead.astype(controller.low.dtype))


@program
def _decide(
    controller: Controller,
    state: ControlState,
    now: Estimate,
    plan: Float[Array, "horizon commands"],
    excess: Float[Array, " limits"],
    solved: Any,
    given: Float[Array, "horizon given"],
) -> tuple[ControlState, Decision]:
    return decide(controller, state, now, plan, excess, (solved, False), given)
