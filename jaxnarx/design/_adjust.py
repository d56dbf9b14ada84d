"""Projected gradient steps on the levels of an excitation plan."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.design._criteria import Criteria, criteria, objective
from jaxnarx.design.sensitivity import (
    AbstractSensitivity,
    NetworkSensitivity,
    network_sensitivity,
)
from jaxnarx.errors import SpecError
from jaxnarx.excitation import AprbsPlan, reachable, render
from jaxnarx.models import Network
from jaxnarx.settings import OptimalDesign
from jaxnarx.solution import RESULTS, Solution


@guard_arguments
def adjust(
    plan: AprbsPlan,
    model: Network | AbstractSensitivity,
    method: OptimalDesign | None = None,
) -> Solution[AprbsPlan]:
    """The plan with its levels moved so that the criterion improves.

    Hold times, length and limits stay. `model` is a sensitivity, or a network, which
    stands for `NetworkSensitivity` with noise of one hundredth of each output's
    training range. Adam steps on the levels as shares of their range, each followed by
    projection on the range and on what the rate limit can reach within a hold; the best
    plan met is returned.

    **Returns** a `Solution` with `stats`: `start` and `end` (`Criteria` of both plans),
    `history` (criterion of every step), `efficiency` (by how much the information per
    parameter grew, exp of the gain in log det over p; 2 means that the starting plan
    would need twice the length) and `steps`. Status `ok`, `no_improvement` where no
    step improved the plan, `unidentifiable` where the starting plan does not determine
    the parameters. A plan for other inputs than the network's raises `SpecError`.
    """
    method = OptimalDesign() if method is None else method
    sensitivity = network_sensitivity(model) if isinstance(model, Network) else model
    if isinstance(sensitivity, NetworkSensitivity):
        _require_inputs(plan, sensitivity.network.channels.input_names)
    padded, reference = _begin(sensitivity, _pad_segments(plan))
    start = _figures(sensitivity, padded, reference)
    if not all(np.isfinite(value) for value in start):
        stats = {"start": start, "end": start, "history": [], "steps": 0}
        return Solution(
            plan,
            RESULTS.unidentifiable,
            stats,
            "the starting plan does not determine all parameters: give it more levels "
            "or length, or ask about fewer parameters",
        )
    best, history = _descend(sensitivity, padded, reference, method)
    end = _figures(sensitivity, best, reference)
    gain = float(end.log_det - start.log_det)
    efficiency = float(np.exp(gain / reference.shape[-1]))
    stats = {
        "start": start,
        "end": end,
        "history": history,
        "efficiency": efficiency,
        "steps": len(history),
    }
    improved = min(history, default=0.0) < 0
    status = RESULTS.ok if improved else RESULTS.no_improvement
    level = best.level[: plan.level.shape[0]]
    best = eqx.tree_at(lambda p: p.level, plan, level)
    return Solution(best, status, stats, _describe_gain(start, end, efficiency))


def _require_inputs(plan: AprbsPlan, names: list[str]) -> None:
    if list(plan.names) != names:
        raise SpecError(
            f"the plan is for {', '.join(plan.names)}, the network's inputs are "
            f"{', '.join(names)}; plan all of them, in this order",
            field="plan",
        )


SEGMENT_MULTIPLE = 32
"""Plans are padded to a multiple of this many segments, so that one compiled step
serves plans of about the same size."""


def _pad_segments(plan: AprbsPlan) -> AprbsPlan:
    """Add segments behind the end, which have no effect. On the host."""
    hold = np.array(plan.hold)
    # The last segment lasts to the end: said outright, else a pad segment would begin.
    hold[-1] += np.maximum(plan.length - hold.sum(axis=0), 0)
    extra = (0, -plan.level.shape[0] % SEGMENT_MULTIPLE), (0, 0)
    level = np.pad(np.asarray(plan.level), extra, mode="edge")
    # Every pad segment starts behind the end, whatever the last hold is.
    hold = np.pad(hold, extra, constant_values=plan.length)
    new = [jnp.asarray(level), jnp.asarray(hold)]
    return eqx.tree_at(lambda p: [p.level, p.hold], plan, new)


@eqx.filter_jit
def _begin(sensitivity: AbstractSensitivity, plan: AprbsPlan):
    """The plan within its limits, and what it shows."""
    plan = reachable(plan)
    return plan, sensitivity(render(plan))


def _optimiser(method: OptimalDesign) -> optax.GradientTransformation:
    steps = max(1, method.max_steps)
    rate = optax.cosine_decay_schedule(method.learning_rate, steps, alpha=0.1)
    return optax.adam(rate)


def _descend(sensitivity, plan, reference, method):
    """Projected Adam: the best plan, and the criterion of every step less the first."""
    share = _share(plan)
    state = _optimiser(method).init(share)
    best, values = plan, []
    for _ in range(method.max_steps + 1):
        value, moved, state = _step(sensitivity, plan, share, reference, state, method)
        values.append(float(value))
        if values[-1] <= min(values):
            best = _set_level_shares(plan, share)
        share = moved
    return best, [value - values[0] for value in values[1:]]


@eqx.filter_jit
def _step(sensitivity, plan, share, reference, state, method):
    """The criterion at `share`, and where the next step leads."""

    def criterion(share):
        slope = sensitivity(render(_set_level_shares(plan, share)))
        return objective(slope, reference, method)

    value, gradient = jax.value_and_grad(criterion)(share)
    gradient = jnp.where(jnp.isfinite(gradient), gradient, 0.0)
    # optax counts its steps in int32 whatever the promotion rules of the user are.
    with jax.numpy_dtype_promotion("standard"):
        update, state = _optimiser(method).update(gradient, state, share)
    return value, _share(reachable(_set_level_shares(plan, share + update))), state


@eqx.filter_jit
def _figures(sensitivity, plan, reference) -> Criteria:
    return criteria(sensitivity(render(plan)), reference)


def _share(plan: AprbsPlan) -> Float[Array, "segments inputs"]:
    """Levels as shares of their range."""
    span = jnp.where(plan.high > plan.low, plan.high - plan.low, 1.0)
    return (plan.level - plan.low[None]) / span[None]


def _set_level_shares(
    plan: AprbsPlan, share: Float[Array, "segments inputs"]
) -> AprbsPlan:
    level = plan.low[None] + share * (plan.high - plan.low)[None]
    return eqx.tree_at(lambda p: p.level, plan, level)


def _describe_gain(start: Criteria, end: Criteria, efficiency: float) -> str:
    return (
        f"log det of the information {float(start.log_det):.4g} -> "
        f"{float(end.log_det):.4g} (as if {efficiency:.3g} times as long), trace of "
        f"the covariance {float(start.trace):.4g} -> {float(end.trace):.4g}, largest "
        f"prediction variance {float(start.largest):.4g} -> {float(end.largest):.4g}"
    )
