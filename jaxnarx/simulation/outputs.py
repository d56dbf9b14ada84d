"""Outputs of networks for prepared records, in physical units: pure array functions.

All can be jitted, mapped over stacked networks and differentiated, by the network's
arrays and by those of the records. None branches on a value, none gives NaN: where a
policy of the network is to say nothing, the verbs `simulate` and `predict` do.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import program
from jaxnarx.errors import SpecError
from jaxnarx.models import (
    FLAG,
    HOLD,
    LINEAR,
    Network,
    collapses,
    overshoot,
    overshoot_decay,
    split_outputs,
    within_margin,
)
from jaxnarx.simulation._prepared import Prepared
from jaxnarx.simulation.masks import first_anchor
from jaxnarx.simulation.observer import begin_hidden, observe_hidden
from jaxnarx.simulation.runs import RunInputs, run, run_steps
from jaxnarx.simulation.trajectories import has_diverged, limited_samples
from jaxnarx.solution import STATUS_NAMES

OK, DIVERGED, TOO_SHORT = (
    STATUS_NAMES.index(n) for n in ("ok", "diverged", "too_short")
)


@guard_arguments
def free_run(network: Network, runs: Prepared) -> Float[Array, "records time outputs"]:
    """The free run of every record on the network's own outputs, physical units.

    The outputs that `simulate` reports: outputs fed back are limited by the feedback
    bound, those of a network with limits are held to their range, samples before the
    first predicted one repeat the measurement. Padding goes on unscored. The derivative
    is exact: by the linear recursion of the run's sensitivities, not through its loop
    (`jaxnarx.arrays.recurrence`); where a value is held it is zero. `run_status` says
    which records have diverged.

    Args:
        network: The model.
        runs: Its records, see `prepare`.

    Returns:
        Outputs (records, time, outputs) by the network's `output_names`.

    Example:
        def loss(network):
            y = jnx.free_run(network, runs)
            return (jnx.metrics.nrmse(runs.measured, y, runs.scored) ** 2).sum()

        slope = eqx.filter_jit(eqx.filter_grad(loss))(network)
    """
    return _physical(network, runs, scaled_run(network, runs), runs.first)


@program
def scaled_run(
    network: Network, runs: Prepared
) -> Float[Array, "records time computed"]:
    """All that the free run computes, hidden channels too, scaled by their gains."""
    return run(network, start_hidden(network, runs).drive, first_anchor(runs))


def run_parts(
    network: Network, runs: Prepared
) -> Float[Array, "records time computed"]:
    """`scaled_run` on the host: outputs that do not look at one another run by
    themselves where one loop for all would evaluate every term at every sample."""
    if collapses(network):
        return _scaled_run_on_host(network, runs)
    return by_parts(network, runs, lambda *own: (_scaled_run_on_host(*own),))[0]


def _scaled_run_on_host(
    network: Network, runs: Prepared
) -> Float[Array, "records time computed"]:
    """`scaled_run` by two programs, of which the first, that of hidden starts, serves
    records of any number and length; it takes longest to compile."""
    if not network.hidden:
        return scaled_run(network, runs)
    network, runs = _drop_unused_policies(network, runs)
    anchor = jax.device_put(np.asarray(first_anchor(runs)))
    return run(network, start_hidden(network, runs).drive, anchor)


def _drop_unused_policies(network: Network, runs: Prepared) -> tuple[Network, Prepared]:
    """Without what goes on beyond the trained ranges of the inputs, where none of them
    leaves its own, and without limits of what is reported: the same run, by the program
    that the training of the network has used."""
    network = dataclasses.replace(network, hold=None)
    v, own = np.asarray(runs.drive.v), 1 + len(network.variables)
    at = np.arange(v.shape[2])[None]
    start, end = (np.asarray(a)[:, None] for a in (runs.start, runs.end))
    counted = (at >= start) & (at < end)
    if network.outside != LINEAR or np.any(v[:, own:] * counted[:, None]):
        return network, runs
    drive = dataclasses.replace(runs.drive, v=jax.device_put(v[:, :own]))
    runs = dataclasses.replace(runs, drive=drive, origin=None)
    return dataclasses.replace(network, outside=FLAG), runs


def predict_parts(
    network: Network, runs: Prepared, k: int
) -> tuple[Float[Array, "records time computed"], Bool[Array, "records time computed"]]:
    """`run_steps` on the host, likewise; hidden channels are observed before."""
    steps = jax.device_put(np.asarray(k))

    def one(network: Network, runs: Prepared):
        return run_steps(network, observe_hidden(network, runs.drive), steps)

    if not network.hidden:
        return one(network, runs)
    return by_parts(network, runs, one)


def by_parts(network: Network, runs: Prepared, function: Callable) -> tuple:
    """Arrays (records, time, computed) that `function` makes of a network and its runs,
    from every part of the network by itself."""
    parts = split_outputs(network)
    if len(parts) < 2:
        return function(network, runs)
    drive, found = runs.drive, None
    for part, computed, rows in parts:
        at = [0, *(1 + rows).tolist()]
        if drive.v.shape[1] > 1 + len(network.variables):
            at += (1 + len(network.variables) + rows).tolist()
        own = RunInputs(
            drive.v[:, np.array(at)],
            tuple(drive.x[n] for n in computed.tolist()),
            drive.measured[..., computed],
            drive.known[..., computed],
        )
        some = function(part, dataclasses.replace(runs, drive=own, origin=None))
        if found is None:
            shape = drive.measured.shape
            found = [np.zeros(shape, np.asarray(one).dtype) for one in some]
        for whole, one in zip(found, some, strict=True):
            whole[..., computed] = np.asarray(one)
    assert found is not None
    return tuple(jax.device_put(found))


def start_hidden(network: Network, runs: Prepared) -> Prepared:
    """Set the values that hidden channels best start from, see
    `jaxnarx.models.observer`."""
    if not network.hidden:
        return runs
    return dataclasses.replace(
        runs, drive=begin_hidden(network, runs.drive, runs.start)
    )


@guard_arguments
def predict_ahead(
    network: Network, runs: Prepared, k: int | Int[Array, ""]
) -> Float[Array, "records time outputs"]:
    """Prediction of every sample from measured history k samples before, physical.

    The outputs that `predict` reports; `k` may be traced, one program serves all.
    Samples without a complete history k samples before have a value all the same: count
    those where `ready(runs, k)` holds.

    Args:
        network: The model.
        runs: Its records, see `prepare`.
        k: Samples from the newest measurement used to the one predicted, at least 1.

    Returns:
        Outputs (records, time, outputs).

    Example:
        y = jnx.predict_ahead(network, runs, 10)
    """
    scaled, _ = run_steps(network, observe_hidden(network, runs.drive), jnp.asarray(k))
    return _physical(network, runs, scaled, runs.first + k - 1)


def ready(
    runs: Prepared, k: int | Int[Array, ""]
) -> Bool[Array, "records time outputs"]:
    """The samples at which a k-step prediction counts: scored, with a whole measured
    history."""
    time = runs.anchors.shape[1]
    at = jnp.arange(time) - (k - 1)
    before = runs.anchors[:, jnp.clip(at, 0)] & (at >= 0)[None]
    return runs.scored & before[:, :, None]


@guard_arguments
def residual(network: Network, runs: Prepared) -> Float[Array, " samples"]:
    """Errors of the free run for a least-squares solver: a vector whose sum of squares
    is the mean over the outputs of their squared NRMSE, the loss of `refine`.

    Zero where a sample does not count, so that its length depends on shapes alone.

    Args:
        network: The model.
        runs: Its records, see `prepare`.

    Returns:
        Records, samples and outputs behind one another.

    Example:
        moving, fixed = eqx.partition(network, jnx.freeze(network))
        solver = optimistix.LevenbergMarquardt(rtol=1e-6, atol=1e-6)
        errors = lambda moving, _: jnx.residual(eqx.combine(moving, fixed), runs)
        found = optimistix.least_squares(errors, solver, moving, throw=False)
    """
    y, measured, scored = free_run(network, runs), runs.measured, runs.scored
    count = jnp.maximum(jnp.sum(scored, axis=(0, 1), dtype=y.dtype), 1.0)[None, None]
    mean = jnp.sum(jnp.where(scored, measured, 0.0), axis=(0, 1))[None, None] / count
    square = jnp.where(scored, measured - mean, 0.0) ** 2
    total = jnp.sum(square, axis=(0, 1))[None, None] * y.shape[-1]
    scale = jnp.sqrt(jnp.where(total > 0, total, 1.0))
    return (jnp.where(scored, y - measured, 0.0) / scale).reshape(-1)


def run_status(network: Network, runs: Prepared) -> Int[Array, " records"]:
    """The status of the free run of every record: codes of `jnx.RESULTS`, as an array.

    `ok`; `diverged`, where the feedback bound acts on more than 5 % of its samples or
    on 50 in a row; `too_short`, without a valid history to start from.

    Example:
        fine = jnx.simulation.run_status(network, runs) == 0
    """
    scaled = scaled_run(network, runs)
    held = limited_samples(network, scaled)
    held |= ~jnp.isfinite(scaled)
    at = jnp.arange(scaled.shape[1])[None]
    counted = (at >= runs.first[:, None]) & (at < runs.end[:, None])
    bad = has_diverged(jnp.any(held, axis=2) & counted, counted)
    code = jnp.where(bad, DIVERGED, OK)
    return jnp.where(runs.first >= runs.end, TOO_SHORT, code)


@guard_arguments
def stack(networks: Sequence[Network]) -> Network:
    """Networks of one structure as one whose arrays have a leading axis, for `vmap`.

    `SpecError` where their structures differ: variables, terms, models, names.

    Example:
        fleet = jnx.stack([network, network])
        y = eqx.filter_vmap(jnx.free_run, in_axes=(0, None))(fleet, runs)
    """
    if len(networks) == 0:
        raise SpecError("there are no networks to be stacked", field="networks")
    first, *others = networks
    shape = _shape(first)
    for n, other in enumerate(others):
        if _shape(other) != shape:
            raise SpecError(
                f"network {n + 2} has another structure than the first: variables, "
                "numbers of terms and models, channels and policies must be the same",
                field="networks",
            )
    return jax.tree.map(lambda *leaves: _stack(leaves), *networks)


def _stack(leaves: Sequence[Array]) -> Array:
    """Stack without a program of its own, unless arrays are traced."""
    if any(isinstance(leaf, Tracer) for leaf in leaves):
        return jnp.stack(leaves)
    return jax.device_put(np.stack(leaves))


@guard_arguments
def unstack(network: Network) -> list[Network]:
    """The networks that were stacked, see `stack`; `SpecError` where none were.

    Example:
        first, second = jnx.unstack(jnx.stack([network, network]))
    """
    if np.ndim(network.sample_time) == 0:
        raise SpecError("unstack: network is one, not a stack", field="network")
    count = network.sample_time.shape[0]
    leaves, tree = jax.tree.flatten(network)
    if not any(isinstance(leaf, Tracer) for leaf in leaves):
        leaves = [np.asarray(leaf) for leaf in leaves]
    every = [[leaf[n] for leaf in leaves] for n in range(count)]
    return [tree.unflatten(jax.device_put(one)) for one in every]


def _shape(network: Network) -> Any:
    leaves, tree = jax.tree.flatten(network)
    return tree, [np.shape(leaf) for leaf in leaves]


def _physical(
    network: Network, runs: Prepared, scaled: Array, first: Array
) -> Float[Array, "records time outputs"]:
    """Report a run in physical units; `scaled` may have hidden channels behind its
    outputs."""
    rate = jnp.zeros(())
    if network.hold is not None and network.outside != HOLD:
        rate = jnp.asarray(overshoot_decay(network))
    return _report(network, runs, scaled, first, rate)


@program
def _report(
    network: Network, runs: Prepared, scaled: Array, first: Array, rate: Array
) -> Float[Array, "records time outputs"]:
    count = len(network.modelled)
    gain = network.gain[np.array(network.signals[:count])]
    scaled = scaled[..., :count]
    fine = jnp.where(jnp.isfinite(scaled), scaled, network.lower[None, None, :count])
    y = fine * gain[None, None]
    if network.hold is not None:
        over = jnp.zeros(y.shape[:2], y.dtype)
        if network.outside != HOLD:
            inputs = runs.signals[..., : len(network.channels.inputs)]
            one = jax.vmap(lambda u: overshoot(network, u, rate.astype(y.dtype)))
            over = one(inputs)
        y = within_margin(network, y, over)
    before = jnp.arange(y.shape[1])[None] < first[:, None]
    return jnp.where(before[..., None], runs.measured, y)
