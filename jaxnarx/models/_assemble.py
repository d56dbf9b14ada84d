"""The parts of a network that come from data and terms, whatever the partition."""

import dataclasses

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.data import Dataset
from jaxnarx.models.network import LocalModels, Network, OutputModel
from jaxnarx.models.validity import AbstractValidity, Gaussians
from jaxnarx.regressors import Pool, Variables

OUTPUT_MARGIN = 0.25
"""Simulated outputs may leave the training range by this share of it on either side."""


def ranges(data: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest valid value of every signal, physical units."""
    columns = np.concatenate([r.signals for r in data])
    valid = np.concatenate([r.valid for r in data])
    low = np.where(valid, columns, np.inf).min(axis=0)
    return low, np.where(valid, columns, -np.inf).max(axis=0)


def local_models(
    factor: Int[np.ndarray, "terms degree"],
    theta: Float[Array | np.ndarray, "models terms"],
    *,
    sparse: bool = False,
) -> LocalModels:
    """Local models with given coefficients: all terms, or those that are not zero."""
    theta = np.asarray(theta)
    models, terms = theta.shape
    if not sparse:
        index = np.tile(np.arange(terms), (models, 1))
        used = np.ones((models, terms), bool)
        return LocalModels(*jax.device_put((factor, index, used, theta)))
    there = theta != 0
    kept = np.flatnonzero(there.any(axis=0) | (np.arange(terms) == 0))
    there = there[:, kept]
    slots = max(int(there.sum(axis=1).max(initial=0)), 1)
    index = np.argsort(~there, axis=1, kind="stable")[:, :slots]
    used = np.take_along_axis(there, index, axis=1)
    value = np.take_along_axis(theta[:, kept], index, axis=1)
    return LocalModels(*jax.device_put((factor[kept], index, used, value)))


def output_model(
    local: LocalModels,
    validity: AbstractValidity,
    scheduling: Variables,
    offset: Float[np.ndarray, " dims"],
    span: Float[np.ndarray, " dims"],
    active: Bool[Array | np.ndarray, " models"] | None = None,
) -> OutputModel:
    """Local models behind their validity functions; all active unless said."""
    if active is None:
        active = np.ones(local.index.shape[0], bool)
    at, size, on = jax.device_put((offset, span, active))
    return OutputModel(scheduling, at, size, validity, on, local)


def global_model(
    factor: Int[np.ndarray, "terms degree"],
    theta: Float[Array, " terms"] | Float[np.ndarray, " terms"],
) -> OutputModel:
    """One local model that is valid everywhere, of given terms and coefficients."""
    local = local_models(factor, np.asarray(theta)[None])
    nothing = np.zeros(0, local.coefficient.dtype)
    validity = Gaussians(*jax.device_put((nothing[None], nothing[None])))
    return output_model(local, validity, Variables(()), nothing, nothing)


def assemble(
    pool: Pool,
    data: Dataset,
    gain: Float[np.ndarray, " signals"],
    models: list[OutputModel],
) -> Network:
    """Complete a network: gains, training ranges and feedback bounds."""
    time = np.asarray(data.sample_time, gain.dtype)
    signal = len(data.channels.inputs) + np.array(pool.outputs)
    leaves = jax.device_put((gain, *training_bounds(data, gain, signal), time))
    return Network(data.channels, pool.outputs, pool.variables, tuple(models), *leaves)


def set_ranges(network: Network, data: Dataset) -> Network:
    """The network with the ranges and feedback bounds of these data of its channels."""
    outputs, measured = len(network.modelled), len(network.channels.measured.all)
    signal = np.array(network.signals)[:outputs]
    found = training_bounds(data, np.asarray(network.gain)[:measured], signal)
    old = network.lower, network.upper, network.low, network.high
    # What hidden channels have done no data tell.
    rest = [np.asarray(a)[len(b) :] for a, b in zip(old, found, strict=True)]
    leaves = [np.append(a, b) for a, b in zip(found, rest, strict=True)]
    lower, upper, low, high = jax.device_put(leaves)
    return dataclasses.replace(network, lower=lower, upper=upper, low=low, high=high)


def set_bounds(network: Network, margin: float = OUTPUT_MARGIN) -> Network:
    """The network with feedback bounds so many widths of the trained ranges beyond;
    what saturates keeps its own."""
    own = np.array(network.signals)
    ranges = network.low, network.high, network.gain
    low, high, gain = (np.asarray(a)[own] for a in ranges)
    wider = np.asarray(margin * (high - low), low.dtype)
    wider = np.where(np.asarray(network.saturates), 0, wider)
    lower, upper = jax.device_put(((low - wider) / gain, (high + wider) / gain))
    return dataclasses.replace(network, lower=lower, upper=upper)


def training_bounds(
    data: Dataset, gain: Float[np.ndarray, " signals"], signal: Int[np.ndarray, " own"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Feedback bounds of the outputs at these signals, scaled; ranges of all signals,
    in physical units: lower, upper, low, high."""
    low, high = ranges(data)
    wider = OUTPUT_MARGIN * (high - low)[signal]
    held = (low[signal] - wider) / gain[signal], (high[signal] + wider) / gain[signal]
    return *held, low, high
