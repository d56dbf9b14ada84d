"""A predictive controller: array functions that say what to set at every sample.

At each sample a network's free run over a horizon is made as near to the references as
its commands can bring it. With errors in quarters of the outputs' trained ranges and
moves in the commands' ranges,

    min  mean_k sum_o w_o (h_o(k) + d_o(k) - r_o(k))^2 + sum_b sum_c p_c move_c(b)^2
         + sum_l (LINEAR e_l + SQUARE e_l^2)

over commands that are held for blocks of samples, within bounds and rates, while
outputs keep their limits, and inputs the domain of the network's training, but for e_l
>= 0 (prices of the domain are lower). It is solved by sequential quadratic
programming with exact derivatives of the run (Gauss-Newton), by default one step a
sample from where the last one has ended: M. Diehl, H. G. Bock, J. P. Schloeder, SIAM J.
Control Optim. 43, 2005, 1714-1736 (real-time iteration). J. B. Rawlings, D. Q. Mayne,
M. M. Diehl, Model Predictive Control, 2017.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.arrays import program, twin
from jaxnarx.control.observer import (
    ErrorStatistics,
    Estimate,
    advance_estimate,
    begin_estimate,
    correct,
    expected_errors,
    recover,
)
from jaxnarx.control.quadratic_program import TOLERANCE, solve_quadratic
from jaxnarx.models import (
    Domain,
    Network,
    driving_signals,
    largest_sizes,
    middle_inputs,
)

Values = Array | np.ndarray | Sequence[float | int]

LINEAR, SQUARE = 100.0, 100.0
"""Price of a broken limit, and of its square, in quarters of the trained range."""
DOMAIN_LINEAR, DOMAIN_SQUARE = 0.01, 1.0
"""Price of the domain's index beyond one, and of its square: low at its border, which
references and other inputs cross now and then, and high far outside. As dear as limits
of outputs it would decide wherever they cross; free, a model would steer where nothing
bounds its errors."""
ROUND_OFF = 0.01
"""Added to the square of the domain's index: at the middle it has no slope."""
LEAST_CURVATURE = 1e-8
AT_EDGE = 1e-9
"""Share of its span up to which a command stands at a bound: beyond a trained range by
round-off it would have another slope."""
SOLVED = 1e4 * TOLERANCE
"""Residual up to which a quadratic program counts as solved."""


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


class Controller(eqx.Module):
    """A network, what it is asked to do, and how; made by `jnx.control.mpc`.

    `begin` and `step` are pure: they can be jitted, mapped and scanned. `commands`,
    `targets` and `bounded` are places in the inputs and outputs; `low`, `high` and
    `move`, the largest change a sample, are in the commands' units. The horizon begins
    `first` samples from now: one, or none where outputs answer to commands at once.
    Limits, `floor` and `ceiling`, are kept with `guard` to spare.
    """

    network: Network
    commands: tuple[int, ...] = eqx.field(static=True)
    targets: tuple[int, ...] = eqx.field(static=True)
    bounded: tuple[int, ...] = eqx.field(static=True)
    blocks: tuple[int, ...] = eqx.field(static=True)
    horizon: int = eqx.field(static=True)
    first: int = eqx.field(static=True)
    rounds: int = eqx.field(static=True)
    observe_states: bool = eqx.field(static=True)
    low: Float[Array, " commands"]
    high: Float[Array, " commands"]
    move: Float[Array, " commands"]
    effort: Float[Array, " commands"]
    weight: Float[Array, " targets"]
    floor: Float[Array, " limits"]
    ceiling: Float[Array, " limits"]
    guard: Float[Array, " limits"]
    size: Float[Array, " outputs"]
    span: Float[Array, " commands"]
    statistics: ErrorStatistics
    domain: Domain | None = None
    fade: Float[Array, " used"] | None = None

    @property
    def nameless(self) -> "Controller":
        """Copy with a network without names, which are no part of a program."""
        return twin(self, network=self.network.nameless)

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

    @property
    def given(self) -> tuple[int, ...]:
        """Places of the inputs that the controller does not set."""
        every = range(len(driving_signals(self.network)))
        return tuple(c for c in every if c not in self.commands)

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


def command_bounds(
    controller: Controller, before: Float[Array, " commands"]
) -> tuple[Float[Array, "blocks commands"], Float[Array, "blocks commands"]]:
    """Bounds of every block; a command that stands beyond its own comes back as fast as
    its rate allows."""
    moves = jnp.arange(1.0, 1.0 + len(controller.blocks), dtype=before.dtype)[:, None]
    reach = moves * controller.move[None]
    low = jnp.minimum(controller.low[None], before[None] + reach)
    return low, jnp.maximum(controller.high[None], before[None] - reach)


def over_horizon(rows: Values, shape: tuple[int, int], kind: jnp.dtype) -> Array:
    """The rows, or one for all; on the host where they are there."""
    xp = jnp if isinstance(rows, Array) else np
    rows = xp.asarray(rows, kind)
    return jnp.asarray(xp.broadcast_to(rows if rows.ndim == 2 else rows[None], shape))


def _inputs(
    controller: Controller, commands: Float[Array, " c"], given: Float[Array, " g"]
) -> Float[Array, " driving"]:
    """The whole row of inputs."""
    row = jnp.zeros(len(controller.commands) + len(controller.given), commands.dtype)
    row = row.at[np.array(controller.commands, int)].set(commands)
    return row.at[np.array(controller.given, int)].set(given)


def _all_inputs(
    controller: Controller,
    plan: Float[Array, "horizon commands"],
    given: Float[Array, "horizon given"],
) -> Float[Array, "horizon driving"]:
    return jax.vmap(lambda c, g: _inputs(controller, c, g))(plan, given)


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
    u = _inputs(controller, commands, given[0])
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


def used_inputs(controller: Controller) -> np.ndarray:
    """Places of the inputs that the domain looks at."""
    own = controller.domain
    return np.array(() if own is None else own.inputs, int)


def domain_index(
    controller: Controller,
    slow: Float[Array, " used"],
    rows: Float[Array, "horizon driving"],
) -> Float[Array, "horizon domains"]:
    """The joint layer of the domain's index over the horizon, smooth at the middle; a
    column, or none."""
    if controller.domain is None or controller.fade is None:
        return jnp.zeros((rows.shape[0], 0), rows.dtype)
    fade, own = controller.fade, rows[:, used_inputs(controller)]

    def filtered(before, row):
        now = fade * before + (1 - fade) * row
        return now, now

    passed = jax.lax.scan(filtered, slow, own)[1]
    features = jnp.concatenate([own, passed], axis=1).T
    return jnp.sqrt(ROUND_OFF + controller.domain.joint_square(features))[:, None]


def predict_outputs(
    controller: Controller,
    now: Estimate,
    plan: Float[Array, "horizon commands"],
    given: Float[Array, "horizon given"],
) -> Float[Array, "horizon outputs"]:
    """The outputs over the horizon under a plan, with the errors that the observer
    expects; where it begins with the next sample, the last inputs are held for the last
    one."""
    rows = _all_inputs(controller, plan, given)
    rows = jnp.concatenate([rows, rows[-1:]])[: controller.horizon + controller.first]

    def sample(x, row):
        return controller.network.step(x, row)

    y = jax.lax.scan(sample, now.x, rows)[1]
    ahead = jnp.arange(controller.first, controller.first + controller.horizon)
    errors = expected_errors(controller.statistics, now, ahead.astype(y.dtype))
    return y[controller.first :] + errors


class _Linearised(NamedTuple):
    """The horizon at a plan `z`, commands in their spans and outputs in their sizes.

    `y` are outputs and, in a last column if there is one, the domain's index; `slope`
    their Jacobian by the flat `z`.
    """

    z: Float[Array, "blocks commands"]
    y: Float[Array, "horizon columns"]
    slope: Float[Array, "horizon columns numbers"]


class _Moves(NamedTuple):
    """Differences between the blocks of a plan: `matrix` times a flat plan, `change`
    those of the present plan from the last commands on."""

    matrix: Float[Array, "numbers numbers"]
    change: Float[Array, " numbers"]


def improve(
    controller: Controller,
    now: Estimate,
    slow: Float[Array, " used"],
    before: Float[Array, " commands"],
    plan: Float[Array, "horizon commands"],
    reference: Float[Array, "horizon targets"],
    given: Float[Array, "horizon given"],
) -> tuple[Float[Array, "horizon commands"], Float[Array, " limits"], Bool[Array, ""]]:
    """A plan after one step of sequential quadratic programming, by how much limits
    then give way, and whether the quadratic program was solved."""
    at = _linearise(controller, now, slow, plan, given)
    z, numbers = at.z, at.z.size
    moves = _moves(controller, z, before)
    curvature, gradient = _objective(controller, at, moves, reference)
    rows, bound, soft = _constraints(controller, at, moves, before)
    wide = jnp.zeros((numbers + soft,) * 2, z.dtype)
    wide = wide.at[:numbers, :numbers].set(curvature)
    linear, square = _prices(controller, soft)
    wide = wide.at[numbers:, numbers:].set(jnp.diag(square).astype(z.dtype))
    whole = jnp.concatenate([gradient, jnp.asarray(0.5 * linear, z.dtype)])
    found = solve_quadratic(wide, whole, rows, bound, jnp.zeros_like(whole))
    step, excess = found.z[:numbers], found.z[numbers:]
    solved = jnp.isfinite(step).all() & (found.residual < SOLVED)
    z = keep_bounds(controller, jnp.where(solved, z + step.reshape(z.shape), z), before)
    own = np.array(controller.bounded, int)
    # The domain's is no limit of an output.
    excess = jnp.where(solved, excess, 0.0)[: len(own)] * controller.size[own]
    return plan_of(controller, z), excess, solved


def keep_bounds(
    controller: Controller,
    z: Float[Array, "blocks commands"],
    before: Float[Array, " commands"],
) -> Float[Array, "blocks commands"]:
    """Commands in their spans within their bounds, the first within its rate too: a
    solution keeps them up to its residual alone. At a bound that is near `plan_of` may
    go beyond the rate by round-off."""
    low, high = command_bounds(controller, before)
    low = low.at[0].max(before - controller.move)
    high = high.at[0].min(before + controller.move)
    span = controller.span[None]
    return jnp.clip(z, low / span, high / span)


def plan_of(
    controller: Controller, z: Float[Array, "blocks commands"]
) -> Float[Array, "horizon commands"]:
    """The commands of every sample, exactly at their bounds where they are near; with
    the slopes of commands between them."""
    plan = z[block_of(controller)] * controller.span[None]
    for edge in (controller.low[None], controller.high[None]):
        near = jnp.abs(plan - edge) <= AT_EDGE * controller.span[None]
        plan = jnp.where(near, edge + (plan - jax.lax.stop_gradient(plan)), plan)
    return plan


def _prices(controller: Controller, soft: int) -> tuple[np.ndarray, np.ndarray]:
    """Prices of what limits give way by, and of their squares: outputs, domain."""
    domain = np.arange(soft) >= len(controller.bounded)
    linear = np.where(domain, DOMAIN_LINEAR, LINEAR)
    return linear, np.where(domain, DOMAIN_SQUARE, SQUARE)


def block_of(controller: Controller) -> np.ndarray:
    """The block of every sample of the horizon."""
    samples = np.arange(controller.horizon)
    return np.searchsorted(np.array(controller.blocks), samples, side="right") - 1


def _linearise(
    controller: Controller,
    now: Estimate,
    slow: Float[Array, " used"],
    plan: Float[Array, "horizon commands"],
    given: Float[Array, "horizon given"],
) -> _Linearised:
    size = controller.size[None]

    def outputs(z):
        plan = plan_of(controller, z)
        y = predict_outputs(controller, now, plan, given) / size
        rows = _all_inputs(controller, plan, given)
        return (jnp.concatenate([y, domain_index(controller, slow, rows)], axis=1),) * 2

    z = plan[np.array(controller.blocks)] / controller.span[None]
    slope, y = jax.jacfwd(outputs, has_aux=True)(z)
    return _Linearised(z, y, slope.reshape(*y.shape, z.size))


def _moves(
    controller: Controller,
    z: Float[Array, "blocks commands"],
    before: Float[Array, " commands"],
) -> _Moves:
    blocks, count = z.shape
    apart = np.eye(blocks) - np.eye(blocks, k=-1)
    matrix = jnp.asarray(np.kron(apart, np.eye(count)), z.dtype)
    last = jnp.zeros(z.size, z.dtype).at[:count].set(before / controller.span)
    return _Moves(matrix, matrix @ z.ravel() - last)


def _objective(
    controller: Controller,
    at: _Linearised,
    moves: _Moves,
    reference: Float[Array, "horizon targets"],
) -> tuple[Float[Array, "numbers numbers"], Float[Array, " numbers"]]:
    """Half the Gauss-Newton Hessian, and half the gradient, of errors and moves."""
    own = np.array(controller.targets, int)
    error = at.y[:, own] - reference / controller.size[own][None]
    slope = at.slope[:, own]
    pull = slope * (controller.weight / controller.horizon)[None, :, None]
    price = jnp.tile(controller.effort, len(controller.blocks))
    curvature = jnp.einsum("kon,kom->nm", pull, slope)
    curvature = curvature + (moves.matrix.T * price[None]) @ moves.matrix
    curvature = curvature + LEAST_CURVATURE * jnp.eye(at.z.size, dtype=at.z.dtype)
    gradient = jnp.einsum("kon,ko->n", pull, error)
    return curvature, gradient + moves.matrix.T @ (price * moves.change)


def _constraints(
    controller: Controller,
    at: _Linearised,
    moves: _Moves,
    before: Float[Array, " commands"],
) -> tuple[Float[Array, "rows unknowns"], Float[Array, " rows"], int]:
    """Rows and bounds on a step and on what limits give way by; and how many of these
    there are: an output's each, and the domain's."""
    z, span, numbers = at.z, controller.span, at.z.size
    eye = jnp.eye(numbers, dtype=z.dtype)
    reach = jnp.tile(controller.move / span, len(z))
    low, high = (
        b.ravel() / jnp.tile(span, len(z)) for b in command_bounds(controller, before)
    )
    hard = jnp.concatenate([eye, -eye, moves.matrix, -moves.matrix])
    hard_bound = jnp.concatenate(
        [high - z.ravel(), z.ravel() - low, reach - moves.change, reach + moves.change]
    )
    own, size = np.array(controller.bounded, int), controller.size
    domain = np.arange(size.shape[0], at.y.shape[1])  # one column, or none
    limits, soft = np.concatenate([own, domain]), len(own) + len(domain)
    one = jnp.ones(len(domain), size.dtype)
    ceiling = (controller.ceiling - controller.guard) / size[own]
    floor = (controller.floor + controller.guard) / size[own]
    above = jnp.concatenate([ceiling, one])[None] - at.y[:, limits]
    below = at.y[:, limits] - jnp.concatenate([floor, -jnp.inf * one])[None]
    steep = at.slope[:, limits].reshape(-1, numbers)
    give = jnp.tile(jnp.eye(soft, dtype=z.dtype), (controller.horizon, 1))
    rows = jnp.block(
        [
            [hard, jnp.zeros((len(hard), soft), z.dtype)],
            [steep, -give],
            [-steep, -give],
            [jnp.zeros((soft, numbers), z.dtype), -jnp.eye(soft, dtype=z.dtype)],
        ]
    )
    nothing = jnp.zeros(soft, z.dtype)
    bound = jnp.concatenate([hard_bound, above.ravel(), below.ravel(), nothing])
    return rows, bound, soft
