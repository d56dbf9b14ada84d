"""A predictive controller: array functions that say what to set at every sample.

At each sample a network's free run over a horizon is made as near to the references as
its commands can bring it (`jaxnarx.control.planning`), by default by one step of
sequential quadratic programming from where the last one has ended: M. Diehl, H. G.
Bock, J. P. Schloeder, SIAM J. Control Optim. 43, 2005, 1714-1736 (real-time iteration).
J. B. Rawlings, D. Q. Mayne, M. M. Diehl, Model Predictive Control, 2017.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.arrays import program
from jaxnarx.control.control_problem import ControlProblem
from jaxnarx.control.observer import (
    Estimate,
    advance_estimate,
    begin_estimate,
    correct,
    recover,
)
from jaxnarx.control.planning import (
    improve,
    join_inputs,
    predict_outputs,
    used_inputs,
)
from jaxnarx.models import Network, driving_signals, largest_sizes, middle_inputs

Values = Array | np.ndarray | Sequence[float | int]


class ControlState(NamedTuple):
    """The memory of a controller from sample to sample.

    `estimate` is that of the plant before the next sample, `u` are the inputs of the
    last one, `plan` the commands that were planned from the next one on, `slow` the
    filtered inputs that the network's domain looks at.
    """

    estimate: Estimate
    u: Float[Array, " driving"]
    plan: Float[Array, "horizon commands"]
    slow: Float[Array, " used"]


class Decision(NamedTuple):
    """The decision of a controller at one sample.

    `commands` are to be set, `outputs` what is expected over the horizon, `excess`
    by how much each limit is expected to give way at most, in the output's unit,
    `disturbance` what the observer adds to the network's outputs. Where the program
    could not be solved (`solved`), the plan of before goes on. Where the network's run
    had come to its bounds it began anew from what was measured (`restarted`).
    """

    commands: Float[Array, " commands"]
    outputs: Float[Array, "horizon outputs"]
    excess: Float[Array, " limits"]
    disturbance: Float[Array, " outputs"]
    solved: Bool[Array, ""]
    restarted: Bool[Array, ""]


class Controller(ControlProblem):
    """A predictive controller of a network; made by `jnx.control.mpc`.

    `begin` and `step` are pure: they can be jitted, mapped and scanned. `commands`,
    `targets` and `bounded` are places in the inputs and outputs, `given` are those of
    the inputs that it does not set; `low`, `high` and `move`, the largest change a
    sample, are in the commands' units. The horizon begins `first` samples from now:
    one, or none where outputs answer to commands at once. Limits, `floor` and
    `ceiling`, are kept with `guard` to spare.
    """

    @property
    def input_names(self) -> list[str]:
        """All inputs, in the order of `begin`'s rows."""
        names = self.network.channels.names
        return [names[s] for s in driving_signals(self.network)]

    @property
    def command_names(self) -> list[str]:
        """Names of the inputs that the controller sets."""
        return [self.input_names[c] for c in self.commands]

    @property
    def given_names(self) -> list[str]:
        """The other inputs, in the order of `given`."""
        return [self.input_names[c] for c in self.given]

    @property
    def target_names(self) -> list[str]:
        """The outputs that have a reference."""
        return [self.network.output_names[o] for o in self.targets]

    @property
    def limit_names(self) -> list[str]:
        """The outputs that have limits."""
        return [self.network.output_names[o] for o in self.bounded]

    def begin(
        self,
        u: Values,
        measured: Values,
    ) -> ControlState:
        """The state of a plant at rest under these inputs, with these outputs.

        Of an input that is missing the middle of its trained range is taken. As
        everywhere, a value is missing that is not finite or a million times as large as
        any of the training (`jaxnarx.models.missing`).
        """
        row = jnp.asarray(u, self.low.dtype)
        return _begin(self, row, jnp.asarray(measured, row.dtype))

    def step(
        self,
        state: ControlState,
        measured: Values,
        reference: Values,
        given: Values | None = None,
    ) -> tuple[ControlState, Decision]:
        """Decide what to set now.

        Args:
            state: From `begin`, or from the sample before.
            measured: The outputs now; one that is missing, as with NaN, corrects
                nothing.
            reference: What the targets shall be, a row for each sample of the horizon,
                which begins `first` samples from now, or one for all.
            given: The inputs that are not set, from this sample on, alike; one that is
                missing is held as it was.

        Returns:
            The next state, and the decision.
        """
        kind = self.low.dtype
        others = np.zeros(0) if given is None else given
        wanted = over_horizon(reference, (self.horizon, len(self.targets)), kind)
        rows = over_horizon(others, (self.horizon, len(self.given)), kind)
        return _step(self, state, jnp.asarray(measured, kind), wanted, rows)


def over_horizon(rows: Values, shape: tuple[int, int], kind: jnp.dtype) -> Array:
    """The rows, or one for all; on the host where they are there."""
    xp = jnp if isinstance(rows, Array) else np
    rows = xp.asarray(rows, kind)
    return jnp.asarray(xp.broadcast_to(rows if rows.ndim == 2 else rows[None], shape))


def _mark_missing(
    network: Network, values: Float[Array, "*rows columns"], signals: Sequence[int]
) -> Float[Array, "*rows columns"]:
    """Values of these signals, NaN where one is missing."""
    largest = largest_sizes(network)[np.array(signals, int)]
    largest = largest.reshape((1,) * (values.ndim - 1) + (-1,))
    return jnp.where(jnp.abs(values) < largest, values, jnp.nan)


def _mark_outputs(
    network: Network, measured: Float[Array, " outputs"]
) -> Float[Array, " outputs"]:
    return _mark_missing(network, measured, network.signals[: len(measured)])


@program
def _begin(controller: Controller, u: Array, measured: Array) -> ControlState:
    network, known = controller.network, controller.statistics
    measured = _mark_outputs(network, measured)
    u = _mark_missing(network, u, driving_signals(network))
    u = jnp.where(jnp.isfinite(u), u, middle_inputs(network).astype(u.dtype))
    x = network.init("steady", u[None])
    y = network.step(x, u)[1]
    d = jnp.where(jnp.isfinite(measured), measured - y, 0.0)
    now = u[np.array(controller.commands, int)]
    plan = jnp.broadcast_to(now[None], (controller.horizon, len(now)))
    begun = begin_estimate(known, x, d, states=controller.observe_states)
    return ControlState(begun, u, plan, u[used_inputs(controller)])


@program
def _step(
    controller: Controller,
    state: ControlState,
    measured: Array,
    reference: Array,
    given: Array,
) -> tuple[ControlState, Decision]:
    network, known = controller.network, controller.statistics
    how = {"states": controller.observe_states}
    measured, at = _mark_outputs(network, measured), np.array(controller.given, int)
    given = _mark_missing(network, given, [driving_signals(network)[k] for k in at])
    given = jnp.where(jnp.isfinite(given), given, state.u[at][None])
    now, lost = recover(network, known, state.estimate, state.u, measured, **how)
    now = correct(network, known, now, state.u, measured, **how)
    before = state.u[np.array(controller.commands, int)]
    plan, excess, solved = state.plan, jnp.zeros_like(controller.floor), True
    for _ in range(controller.rounds):
        plan, excess, good = improve(
            controller, now, state.slow, before, plan, reference, given
        )
        solved = good & solved
    return decide(controller, state, now, plan, excess, (solved, lost), given)


def decide(
    controller: Controller,
    state: ControlState,
    now: Estimate,
    plan: Float[Array, "horizon commands"],
    excess: Float[Array, " limits"],
    flags: tuple[Bool[Array, ""] | bool, Bool[Array, ""] | bool],
    given: Float[Array, "horizon given"],
) -> tuple[ControlState, Decision]:
    """The next state and the decision, once there is a plan; `flags` tell whether the
    program was solved and the network's run begun anew."""
    network, known = controller.network, controller.statistics
    how = {"states": controller.observe_states}
    commands = plan[0]
    u = join_inputs(controller, commands, given[0])
    y = predict_outputs(controller, now, plan, given)
    after = advance_estimate(network, known, now, u, **how)
    shifted = jnp.concatenate([plan[1:], plan[-1:]])
    slow = state.slow
    if controller.fade is not None:
        slow = (
            controller.fade * slow + (1 - controller.fade) * u[used_inputs(controller)]
        )
    solved, restarted = (jnp.asarray(flag) for flag in flags)
    decision = Decision(
        commands,
        y,
        excess,
        now.offset + now.fading,
        solved & jnp.isfinite(y).all(),
        restarted,
    )
    return ControlState(after, u, shifted, slow), decision
