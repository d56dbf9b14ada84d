"""The plan of a predictive controller: its horizon, and the quadratic program of it.

With errors in quarters of the outputs' trained ranges and moves in the commands'
ranges,

    min  mean_k sum_o w_o (h_o(k) + d_o(k) - r_o(k))^2 + sum_b sum_c p_c move_c(b)^2
         + sum_l (LINEAR e_l + SQUARE e_l^2)

over commands that are held for blocks of samples, within bounds and rates, while
outputs keep their limits, and inputs the domain of the network's training, but for e_l
>= 0 (prices of the domain are lower): one step of sequential quadratic programming with
exact derivatives of the run (Gauss-Newton).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.control.control_problem import ControlProblem
from jaxnarx.control.observer import Estimate, expected_errors
from jaxnarx.control.quadratic_program import TOLERANCE, solve_quadratic

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


def command_bounds(
    problem: ControlProblem, before: Float[Array, " commands"]
) -> tuple[Float[Array, "blocks commands"], Float[Array, "blocks commands"]]:
    """Bounds of every block; a command that stands beyond its own comes back as fast as
    its rate allows."""
    moves = jnp.arange(1.0, 1.0 + len(problem.blocks), dtype=before.dtype)[:, None]
    reach = moves * problem.move[None]
    low = jnp.minimum(problem.low[None], before[None] + reach)
    return low, jnp.maximum(problem.high[None], before[None] - reach)


def join_inputs(
    problem: ControlProblem, commands: Float[Array, " c"], given: Float[Array, " g"]
) -> Float[Array, " driving"]:
    """The whole row of inputs."""
    row = jnp.zeros(len(problem.commands) + len(problem.given), commands.dtype)
    row = row.at[np.array(problem.commands, int)].set(commands)
    return row.at[np.array(problem.given, int)].set(given)


def _all_inputs(
    problem: ControlProblem,
    plan: Float[Array, "horizon commands"],
    given: Float[Array, "horizon given"],
) -> Float[Array, "horizon driving"]:
    return jax.vmap(lambda c, g: join_inputs(problem, c, g))(plan, given)


def used_inputs(problem: ControlProblem) -> np.ndarray:
    """Places of the inputs that the domain looks at."""
    own = problem.domain
    return np.array(() if own is None else own.inputs, int)


def domain_index(
    problem: ControlProblem,
    slow: Float[Array, " used"],
    rows: Float[Array, "horizon driving"],
) -> Float[Array, "horizon domains"]:
    """The joint layer of the domain's index over the horizon, smooth at the middle; a
    column, or none."""
    if problem.domain is None or problem.fade is None:
        return jnp.zeros((rows.shape[0], 0), rows.dtype)
    fade, own = problem.fade, rows[:, used_inputs(problem)]

    def filtered(before, row):
        now = fade * before + (1 - fade) * row
        return now, now

    passed = jax.lax.scan(filtered, slow, own)[1]
    features = jnp.concatenate([own, passed], axis=1).T
    return jnp.sqrt(ROUND_OFF + problem.domain.joint_square(features))[:, None]


def predict_outputs(
    problem: ControlProblem,
    now: Estimate,
    plan: Float[Array, "horizon commands"],
    given: Float[Array, "horizon given"],
) -> Float[Array, "horizon outputs"]:
    """The outputs over the horizon under a plan, with the errors that the observer
    expects; where it begins with the next sample, the last inputs are held for the last
    one."""
    rows = _all_inputs(problem, plan, given)
    rows = jnp.concatenate([rows, rows[-1:]])[: problem.horizon + problem.first]

    def sample(x, row):
        return problem.network.step(x, row)

    y = jax.lax.scan(sample, now.x, rows)[1]
    ahead = jnp.arange(problem.first, problem.first + problem.horizon)
    errors = expected_errors(problem.statistics, now, ahead.astype(y.dtype))
    return y[problem.first :] + errors


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
    problem: ControlProblem,
    now: Estimate,
    slow: Float[Array, " used"],
    before: Float[Array, " commands"],
    plan: Float[Array, "horizon commands"],
    reference: Float[Array, "horizon targets"],
    given: Float[Array, "horizon given"],
) -> tuple[Float[Array, "horizon commands"], Float[Array, " limits"], Bool[Array, ""]]:
    """A plan after one step of sequential quadratic programming, by how much limits
    then give way, and whether the quadratic program was solved."""
    at = _linearise(problem, now, slow, plan, given)
    z, numbers = at.z, at.z.size
    moves = _moves(problem, z, before)
    curvature, gradient = _objective(problem, at, moves, reference)
    rows, bound, soft = _constraints(problem, at, moves, before)
    wide = jnp.zeros((numbers + soft,) * 2, z.dtype)
    wide = wide.at[:numbers, :numbers].set(curvature)
    linear, square = _prices(problem, soft)
    wide = wide.at[numbers:, numbers:].set(jnp.diag(square).astype(z.dtype))
    whole = jnp.concatenate([gradient, jnp.asarray(0.5 * linear, z.dtype)])
    found = solve_quadratic(wide, whole, rows, bound, jnp.zeros_like(whole))
    step, excess = found.z[:numbers], found.z[numbers:]
    solved = jnp.isfinite(step).all() & (found.residual < SOLVED)
    z = keep_bounds(problem, jnp.where(solved, z + step.reshape(z.shape), z), before)
    own = np.array(problem.bounded, int)
    # The domain's is no limit of an output.
    excess = jnp.where(solved, excess, 0.0)[: len(own)] * problem.size[own]
    return plan_of(problem, z), excess, solved


def keep_bounds(
    problem: ControlProblem,
    z: Float[Array, "blocks commands"],
    before: Float[Array, " commands"],
) -> Float[Array, "blocks commands"]:
    """Commands in their spans within their bounds, the first within its rate too: a
    solution keeps them up to its residual alone. At a bound that is near `plan_of` may
    go beyond the rate by round-off."""
    low, high = command_bounds(problem, before)
    low = low.at[0].max(before - problem.move)
    high = high.at[0].min(before + problem.move)
    span = problem.span[None]
    return jnp.clip(z, low / span, high / span)


def plan_of(
    problem: ControlProblem, z: Float[Array, "blocks commands"]
) -> Float[Array, "horizon commands"]:
    """The commands of every sample, exactly at their bounds where they are near; with
    the slopes of commands between them."""
    plan = z[block_of(problem)] * problem.span[None]
    for edge in (problem.low[None], problem.high[None]):
        near = jnp.abs(plan - edge) <= AT_EDGE * problem.span[None]
        plan = jnp.where(near, edge + (plan - jax.lax.stop_gradient(plan)), plan)
    return plan


def _prices(problem: ControlProblem, soft: int) -> tuple[np.ndarray, np.ndarray]:
    """Prices of what limits give way by, and of their squares: outputs, domain."""
    domain = np.arange(soft) >= len(problem.bounded)
    linear = np.where(domain, DOMAIN_LINEAR, LINEAR)
    return linear, np.where(domain, DOMAIN_SQUARE, SQUARE)


def block_of(problem: ControlProblem) -> np.ndarray:
    """The block of every sample of the horizon."""
    samples = np.arange(problem.horizon)
    return np.searchsorted(np.array(problem.blocks), samples, side="right") - 1


def _linearise(
    problem: ControlProblem,
    now: Estimate,
    slow: Float[Array, " used"],
    plan: Float[Array, "horizon commands"],
    given: Float[Array, "horizon given"],
) -> _Linearised:
    size = problem.size[None]

    def outputs(z):
        plan = plan_of(problem, z)
        y = predict_outputs(problem, now, plan, given) / size
        rows = _all_inputs(problem, plan, given)
        return (jnp.concatenate([y, domain_index(problem, slow, rows)], axis=1),) * 2

    z = plan[np.array(problem.blocks)] / problem.span[None]
    slope, y = jax.jacfwd(outputs, has_aux=True)(z)
    return _Linearised(z, y, slope.reshape(*y.shape, z.size))


def _moves(
    problem: ControlProblem,
    z: Float[Array, "blocks commands"],
    before: Float[Array, " commands"],
) -> _Moves:
    blocks, count = z.shape
    apart = np.eye(blocks) - np.eye(blocks, k=-1)
    matrix = jnp.asarray(np.kron(apart, np.eye(count)), z.dtype)
    last = jnp.zeros(z.size, z.dtype).at[:count].set(before / problem.span)
    return _Moves(matrix, matrix @ z.ravel() - last)


def _objective(
    problem: ControlProblem,
    at: _Linearised,
    moves: _Moves,
    reference: Float[Array, "horizon targets"],
) -> tuple[Float[Array, "numbers numbers"], Float[Array, " numbers"]]:
    """Half the Gauss-Newton Hessian, and half the gradient, of errors and moves."""
    own = np.array(problem.targets, int)
    error = at.y[:, own] - reference / problem.size[own][None]
    slope = at.slope[:, own]
    pull = slope * (problem.weight / problem.horizon)[None, :, None]
    price = jnp.tile(problem.effort, len(problem.blocks))
    curvature = jnp.einsum("kon,kom->nm", pull, slope)
    curvature = curvature + (moves.matrix.T * price[None]) @ moves.matrix
    curvature = curvature + LEAST_CURVATURE * jnp.eye(at.z.size, dtype=at.z.dtype)
    gradient = jnp.einsum("kon,ko->n", pull, error)
    return curvature, gradient + moves.matrix.T @ (price * moves.change)


def _constraints(
    problem: ControlProblem,
    at: _Linearised,
    moves: _Moves,
    before: Float[Array, " commands"],
) -> tuple[Float[Array, "rows unknowns"], Float[Array, " rows"], int]:
    """Rows and bounds on a step and on what limits give way by; and how many of these
    there are: an output's each, and the domain's."""
    z, span, numbers = at.z, problem.span, at.z.size
    eye = jnp.eye(numbers, dtype=z.dtype)
    reach = jnp.tile(problem.move / span, len(z))
    low, high = (
        b.ravel() / jnp.tile(span, len(z)) for b in command_bounds(problem, before)
    )
    hard = jnp.concatenate([eye, -eye, moves.matrix, -moves.matrix])
    hard_bound = jnp.concatenate(
        [high - z.ravel(), z.ravel() - low, reach - moves.change, reach + moves.change]
    )
    own, size = np.array(problem.bounded, int), problem.size
    domain = np.arange(size.shape[0], at.y.shape[1])  # one column, or none
    limits, soft = np.concatenate([own, domain]), len(own) + len(domain)
    one = jnp.ones(len(domain), size.dtype)
    ceiling = (problem.ceiling - problem.guard) / size[own]
    floor = (problem.floor + problem.guard) / size[own]
    above = jnp.concatenate([ceiling, one])[None] - at.y[:, limits]
    below = at.y[:, limits] - jnp.concatenate([floor, -jnp.inf * one])[None]
    steep = at.slope[:, limits].reshape(-1, numbers)
    give = jnp.tile(jnp.eye(soft, dtype=z.dtype), (problem.horizon, 1))
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
