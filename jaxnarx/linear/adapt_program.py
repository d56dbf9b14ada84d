"""The loop of adaptation: windows of samples, and what keeps each of them safe.

One window is a loop over samples; between windows the error is judged, and what is to
be undone is undone.
"""

import dataclasses
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays import Recursion, program, update_recursion
from jaxnarx.errors import SpecError
from jaxnarx.models import (
    Network,
    OutputModel,
    scheduling_values,
    term_values,
    with_history,
)
from jaxnarx.settings import LEAST_WINDOW_ERROR, Recursive


class RegressionRows(eqx.Module):
    """One output's regression at one sample or at many (leading axes).

    `columns`: the slots of every chosen model; `phi` their validities; `fixed` the part
    of the output that the other models give.
    """

    columns: Float[Array, "*rows models slots"]
    phi: Float[Array, "*rows models"]
    fixed: Float[Array, "*rows"]

    def predict(self, theta: Float[Array, "models slots"]) -> Float[Array, "*rows"]:
        """Scaled output with these coefficients of the chosen models."""
        local = jnp.sum(self.columns * theta, axis=-1)
        return self.fixed + jnp.sum(self.phi * local, axis=-1)


@dataclasses.dataclass(frozen=True)
class AdaptationPlan:
    """Local models of each output that are adapted, and whether jointly."""

    chosen: tuple[tuple[int, ...], ...]
    joint: bool


def make_plan(network: Network, method: Recursive) -> AdaptationPlan:
    """The chosen models of every output; `SpecError` for one that is not there."""
    chosen = []
    for name, model in zip(network.output_names, network.models, strict=True):
        active = np.flatnonzero(np.asarray(model.active)).tolist()
        wanted = active if method.models is None else list(method.models)
        strange = [m for m in wanted if m not in active]
        if strange:
            raise SpecError(
                f"{name} has no local model {strange[0]}; its models are "
                f"{', '.join(map(str, active))} (counted from 0)",
                field="models",
            )
        chosen.append(tuple(wanted))
    return AdaptationPlan(tuple(chosen), method.estimation == "joint")


def output_rows(
    network: Network,
    model: OutputModel,
    chosen: tuple[int, ...],
    v: Float[Array, "vars *rows"],
    x: Float[Array, "dims *rows"],
) -> RegressionRows:
    """Rows of one output from its lagged and scheduling variables."""
    local, at = model.local, np.array(chosen)
    terms = term_values(network, model, v)
    phi = model.validity(scheduling_values(model, x), model.active)
    tail = (1,) * (v.ndim - 1)
    used = local.used[at].reshape(*local.used[at].shape, *tail)
    columns = jnp.where(used, terms[local.index[at]], 0.0)
    rest = local.dense().at[at].set(0.0)
    fixed = jnp.sum(phi * jnp.tensordot(rest, terms, axes=1), axis=0)
    return RegressionRows(
        jnp.moveaxis(columns, (0, 1), (-2, -1)), jnp.moveaxis(phi[at], 0, -1), fixed
    )


def coefficients(
    model: OutputModel, chosen: tuple[int, ...]
) -> Float[Array, "models slots"]:
    """Coefficients of the chosen models, zero in unused slots."""
    at = np.array(chosen)
    return jnp.where(model.local.used[at], model.local.coefficient[at], 0.0)


def place(
    network: Network, plan: AdaptationPlan, theta: tuple[Float[Array, "_ _"], ...]
) -> Network:
    """The network with these coefficients; unused slots keep what they hold."""
    new = []
    for model, chosen, own in zip(network.models, plan.chosen, theta, strict=True):
        at: Int[np.ndarray, " models"] = np.array(chosen)
        local = model.local
        value = jnp.where(local.used[at], own, local.coefficient[at])
        new.append(local.coefficient.at[at].set(value))
    return eqx.tree_at(lambda n: [m.local.coefficient for m in n.models], network, new)


class WindowedSamples(NamedTuple):
    """All samples behind one another, cut into windows."""

    v: Float[Array, "windows window vars"]
    x: tuple[Float[Array, "windows window _"], ...]
    y: Float[Array, "windows window outputs"]
    past: Float[Array, "windows window outputs depth"]
    weight: Float[Array, "windows window outputs"]
    anchor: Bool[Array, "windows window"]
    start: Float[Array, "windows window outputs"]


class Limits(NamedTuple):
    """Settings of `Recursive` that are traced."""

    forgetting: Float[Array, ""]
    start: Float[Array, ""]
    dead_zone: Float[Array, ""]
    excitation: Float[Array, ""]
    largest_trace: Float[Array, ""]
    growth: Float[Array, ""]


class Output(eqx.Module):
    """One output on its way: its groups' recursions, and coefficients to go back to.

    `packed` is that of a `Recursion` for every group, `begin` the diagonal of a root of
    its covariance at the start: zero in slots that are not used.
    """

    packed: Float[Array, "groups terms_and_one terms"]
    good: Float[Array, "models slots"]
    first: Float[Array, "models slots"]
    begin: Float[Array, "groups terms"]


class WindowRecord(NamedTuple):
    """Estimates and errors at the end of one window, per output."""

    theta: tuple[Float[Array, "_ _"], ...]
    mse: Float[Array, " outputs"]
    mse_start: Float[Array, " outputs"]
    drift: Float[Array, " outputs"]
    samples: Int[Array, " outputs"]
    frozen: Int[Array, " outputs"]
    held: Int[Array, " outputs"]
    undone: Bool[Array, " outputs"]


def _groups(theta: Float[Array, "models slots"], joint: bool) -> Array:
    return theta.reshape(1, -1) if joint else theta


def _estimate(output: Output) -> Float[Array, "models slots"]:
    """Coefficients of the chosen models as they are now."""
    return output.packed[:, -1].reshape(output.good.shape)


def _fresh(
    theta: Float[Array, "models slots"], begin: Float[Array, "groups terms"]
) -> Float[Array, "groups terms_and_one terms"]:
    """Recursions of every group at `theta`."""
    root = jax.vmap(jnp.diag)(begin)
    return jnp.concatenate([root, theta.reshape(len(begin), 1, -1)], axis=1)


def _begin_output(
    theta: Float[Array, "models slots"], used: Array, joint: bool, limits: Limits
) -> Output:
    """An output before its first sample: P is `start` times the unit matrix."""
    begin = jnp.sqrt(limits.start) * _groups(used.astype(theta.dtype), joint)
    return Output(_fresh(theta, begin), theta, theta, begin)


def _update(packed, columns, target, weight, fade, least):
    state, _, used = update_recursion(
        Recursion(packed), columns, target, weight, fade, least
    )
    return state.packed, used


def _learn(
    output: Output, rows: RegressionRows, y, weight, limits: Limits, joint: bool
) -> tuple[Output, Float[Array, ""], Bool[Array, ""], Bool[Array, ""]]:
    """One sample: the output, its prediction, whether it rested, and held its memory.

    A local model sees the whole target with its validity as the weight, all of them
    together what the others leave.
    """
    predicted = rows.predict(_estimate(output))
    awake = jnp.abs(y - predicted) > limits.dead_zone
    weight = jnp.where(awake, weight, 0.0)
    if joint:
        columns = (rows.columns * rows.phi[:, None]).reshape(1, -1)
        target, share = (y - rows.fixed)[None], jnp.ones(1, y.dtype)
    else:
        columns, share = rows.columns, rows.phi
        target = jnp.broadcast_to(y, share.shape)
    fade = 1.0 - (1.0 - limits.forgetting) * share
    packed = output.packed
    trace = jnp.sum(packed[:, :-1] ** 2, axis=(1, 2))
    most = limits.largest_trace * jnp.sum(output.begin**2, axis=1)
    full = trace > most * fade
    fade = jnp.where(full, 1.0, fade)
    least = limits.excitation * (1.0 - limits.forgetting)
    now = (packed, columns, target, weight * share, fade)
    packed, used = jax.vmap(partial(_update, least=least))(*now)
    rested = (weight > 0) & ~jnp.any(used) | ~awake
    held = jnp.any(used & full & (limits.forgetting < 1))
    return dataclasses.replace(output, packed=packed), predicted, rested, held


def _judge(
    output: Output, mse, mse_start, limits: Limits
) -> tuple[Output, Bool[Array, ""]]:
    """Keep the window's coefficients, or go back and begin anew.

    Back means to the last good coefficients, and from there, should the next window
    fail as well, to those of the start.
    """
    most = limits.growth**2 * jnp.maximum(mse_start, LEAST_WINDOW_ERROR**2)
    finite = jnp.all(jnp.isfinite(output.packed))
    undone = ~((mse <= most) & finite)
    again = _fresh(output.good, output.begin)
    packed = jnp.where(undone, again, output.packed)
    good = jnp.where(undone, output.first, _estimate(output))
    return dataclasses.replace(output, packed=packed, good=good), undone


def _bound(network: Network, y):
    return jnp.clip(y, network.lower, network.upper)


def _mean(total, count):
    return total / jnp.maximum(count, 1).astype(total.dtype)


@program
def adapt_windows(
    network: Network,
    plan: AdaptationPlan,
    samples: WindowedSamples,
    limits: Limits,
    simulated: bool,
) -> tuple[tuple[Float[Array, "_ _"], ...], WindowRecord]:
    """Final coefficients of the chosen models, and a record of every window."""
    joint = plan.joint

    def regression_rows(v, x):
        parts = zip(network.models, plan.chosen, x, strict=True)
        return [output_rows(network, m, c, v, x_o) for m, c, x_o in parts]

    def sample(carry, now):
        outputs, past, lost = carry
        rows, v, x, y, measured, weight, anchor, start = now
        if simulated:
            past = jnp.where(anchor | lost, measured, past)
            rows = regression_rows(*with_history(network, v, x, past))
        learnt = [
            _learn(output, row, y[o], weight[o], limits, joint)
            for o, (output, row) in enumerate(zip(outputs, rows, strict=True))
        ]
        outputs, predicted, rested, held = zip(*learnt, strict=True)
        predicted = _bound(network, jnp.stack(predicted))
        past = jnp.concatenate([predicted[:, None], past[:, :-1]], axis=1)
        counted = weight > 0
        figures = (
            jnp.where(counted, (y - predicted) ** 2, 0.0),
            jnp.where(counted, (y - start) ** 2, 0.0),
            jnp.where(counted, (predicted - start) ** 2, 0.0),
            counted,
            jnp.stack(rested) & counted,
            jnp.stack(held) & counted,
        )
        return (outputs, past, jnp.zeros_like(lost)), figures

    def window(carry, block: WindowedSamples):
        v, x = block.v, block.x
        rows = None
        if not simulated:
            rows = regression_rows(v.T, tuple(x_o.T for x_o in x))
        inner = (rows, v, x, *block[2:])
        (outputs, past, _), figures = jax.lax.scan(sample, carry, inner)
        error, error_start, apart, counted, rested, held = figures
        count = jnp.sum(counted, axis=0)
        mse = _mean(jnp.sum(error, axis=0), count)
        mse_start = _mean(jnp.sum(error_start, axis=0), count)
        judged = [
            _judge(output, mse[o], mse_start[o], limits)
            for o, output in enumerate(outputs)
        ]
        outputs = tuple(output for output, _ in judged)
        undone = jnp.stack([flag for _, flag in judged])
        record = WindowRecord(
            tuple(_estimate(o) for o in outputs),
            mse,
            mse_start,
            _mean(jnp.sum(apart, axis=0), count),
            count,
            jnp.sum(rested, axis=0),
            jnp.sum(held, axis=0),
            undone,
        )
        return (outputs, past, jnp.any(undone)), record

    outputs = tuple(
        _begin_output(coefficients(m, c), m.local.used[np.array(c)], joint, limits)
        for m, c in zip(network.models, plan.chosen, strict=True)
    )
    carry = outputs, samples.past[0, 0], jnp.asarray(False)
    _, record = jax.lax.scan(window, carry, samples)
    return tuple(theta[-1] for theta in record.theta), record
