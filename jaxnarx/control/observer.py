"""An observer: errors of a plant's outputs, and its states, from measurements.

    x(t+1) = f(x(t), u(t)) + w(t),   b(t+1) = b(t) + q(t),   e(t+1) = p e(t) + v(t),
    measured(t) = h(x(t), u(t-1)) + b(t) + e(t) + n(t),

by an extended Kalman filter over (x, b, e), or over b and e alone where the state
follows from the commands (R. E. Kalman 1960; A. H. Jazwinski, Stochastic Processes and
Filtering Theory, 1970, theorem 8.1). Of x it moves what the recursion carries: delayed
inputs and the states of their filters are known. The offset b has no pull to zero, so
that a controller that aims at h + b + e leaves none: K. R. Muske, T. A. Badgwell, J.
Process Control 12, 2002, 617-632; G. Pannocchia, J. B. Rawlings, AIChE J. 49, 2003,
426-437. What comes and goes, as errors of a model do, is e, and expected to fade with
its pole.

Pole and variances come from the error of the free run over records: with its
autocovariances c0, c1, c2 the pole p is c2/c1, the variance of e is c1^2/c2, and what
is left is the noise n.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.models import (
    Network,
    StateForm,
    carried,
    fed_back_variables,
    remember_outputs,
    sources,
)

LEAST_NOISE = 1e-3
"""Standard deviation of the noise, at least, as a share of an output's size."""
UNKNOWN_NOISE, UNKNOWN_STEPS, UNKNOWN_POLE = 0.02, 0.02, 0.9
"""Standard deviations of the noise and of the steps of e, as shares of an output's
size, and the pole, where no records tell them."""
OFFSET_SHARE = 0.5
"""Standard deviation of the steps of an offset, as a share of that of the noise and the
steps of e together: it is learnt in about twice the time in which e fades."""
STATE_NOISE = 1e-3
"""Standard deviation of the steps of estimated states, as a share of their size."""
UNSURE = 1e4
"""Variance of a state that has just begun, in that of its steps."""
NOT_MEASURED = 1e12
"""Factor on the variance of an output that has no number."""


class ErrorStatistics(eqx.Module):
    """Pole of the errors that fade, and variances a sample of the noise, of the steps
    of errors and offsets, and of the states that the recursion carries; in the units of
    outputs and states."""

    pole: Float[Array, " outputs"]
    noise: Float[Array, " outputs"]
    steps: Float[Array, " outputs"]
    offset: Float[Array, " outputs"]
    states: Float[Array, " carried"]


class Estimate(NamedTuple):
    """State, offsets and fading errors before a sample, and the covariance of what the
    recursion carries, offsets and errors, or of the last two alone."""

    x: Float[Array, " states"]
    offset: Float[Array, " outputs"]
    fading: Float[Array, " outputs"]
    covariance: Float[Array, "own own"]


def begin_estimate(
    statistics: ErrorStatistics,
    x: Float[Array, " states"],
    error: Float[Array, " outputs"],
    *,
    states: bool,
) -> Estimate:
    """The estimate of a plant whose outputs are off by `error`, taken as an offset."""
    known = [statistics.states * UNSURE] if states else []
    known += [statistics.offset, statistics.steps]
    cov = jnp.diag(jnp.concatenate(known))
    return Estimate(x, error, jnp.zeros_like(error), cov)


def feedback_bounds(network: Network) -> tuple[Array, Array, Array] | None:
    """Low and high bounds of the feedback of every output, in its unit, and whether
    they are free of a curve that saturates; None where a network has no feedback or
    carries more than past outputs."""
    fed_back = fed_back_variables(network.variables, network.signals)
    if len(sources(network)) != len(network.modelled) or not fed_back:
        return None
    gain = network.gain[np.array(network.signals)]
    low, high = network.lower * gain, network.upper * gain
    return low, high, ~jnp.asarray(network.saturates) & (low < high)


def recover(
    network: Network,
    statistics: ErrorStatistics,
    before: Estimate,
    u: Float[Array, " driving"],
    measured: Float[Array, " outputs"],
    *,
    states: bool,
) -> tuple[Estimate, Bool[Array, ""]]:
    """The estimate, begun anew after outputs as they have been measured where the run
    of a network stands at its bounds; and whether it does.

    No correction leads back from there, for such an output does not depend on the
    state. An estimate goes on where the network has no feedback or carries more than
    past outputs, where an output was not measured or is itself beyond the bounds, and
    where the run would be back at them at once.
    """
    bounds = feedback_bounds(network)
    if bounds is None:
        return before, jnp.zeros((), bool)
    low, high, free = bounds
    count, at = len(network.modelled), np.flatnonzero(carried(network))
    form = StateForm(network)

    def clipped(x: Array) -> Array:
        # What is remembered of a step is not held to the reported range.
        y = form.f(x, u)[at].reshape(count, -1)[:, 0]
        return jnp.any(~((y > low) & (y < high)) & free)

    x = remember_outputs(network, before.x, measured)
    inside = jnp.all(((measured > low) & (measured < high)) | ~free)
    known = jnp.isfinite(measured).all()
    lost = known & inside & clipped(before.x) & ~clipped(x)
    nothing = jnp.zeros_like(before.offset)
    anew = begin_estimate(statistics, x, nothing, states=states)
    found = jax.tree.map(lambda a, b: jnp.where(lost, a, b), anew, before)
    return found, lost


def expected_errors(
    statistics: ErrorStatistics, now: Estimate, samples: Float[Array, " horizon"]
) -> Float[Array, "horizon outputs"]:
    """What the outputs will be off by so many samples from now."""
    return (
        now.offset[None] + statistics.pole[None] ** samples[:, None] * now.fading[None]
    )


def correct(
    network: Network,
    statistics: ErrorStatistics,
    before: Estimate,
    u: Float[Array, " driving"],
    measured: Float[Array, " outputs"],
    *,
    states: bool,
) -> Estimate:
    """The estimate once the outputs have been measured; NaN where they have not. A
    covariance that round-off has made unfit begins anew, and corrects nothing."""
    x, offset, fading, cov = before
    outputs = offset.shape[0]
    form = StateForm(network)
    own = jnp.eye(outputs, dtype=offset.dtype)
    at = np.flatnonzero(carried(network))
    slopes = [form.jacobians(x, u)[2][:, at]] if states else []
    c = jnp.concatenate([*slopes, own, own], axis=1)
    there = jnp.isfinite(measured)
    noise = statistics.noise * jnp.where(there, 1.0, NOT_MEASURED)
    error = jnp.where(there, measured - form.h(x, u) - offset - fading, 0.0)
    middle = c @ cov @ c.T + jnp.diag(noise)
    gain = jax.scipy.linalg.solve(middle, c @ cov, assume_a="pos").T
    move = gain @ error
    # Joseph's form: it stays symmetric and positive.
    left = jnp.eye(cov.shape[0], dtype=cov.dtype) - gain @ c
    cov = left @ cov @ left.T + (gain * noise[None]) @ gain.T
    x = x.at[at].add(move[: -2 * outputs]) if states else x
    moved = move[-2 * outputs :].reshape(2, outputs)
    found = Estimate(x, offset + moved[0], fading + moved[1], cov)
    anew = begin_estimate(statistics, before.x, before.offset, states=states)
    anew = anew._replace(fading=before.fading)
    good = jnp.isfinite(gain).all()
    return jax.tree.map(lambda a, b: jnp.where(good, a, b), found, anew)


def advance_estimate(
    network: Network,
    statistics: ErrorStatistics,
    now: Estimate,
    u: Float[Array, " driving"],
    *,
    states: bool,
) -> Estimate:
    """The estimate before the next sample, under these inputs."""
    x, offset, fading, cov = now
    form = StateForm(network)
    keeps = jnp.concatenate([jnp.ones_like(statistics.pole), statistics.pole])
    steps = [statistics.offset, statistics.steps]
    if states:
        at = np.flatnonzero(carried(network))
        a = form.jacobians(x, u)[0][np.ix_(at, at)]
        moves = jax.scipy.linalg.block_diag(a, jnp.diag(keeps))
        steps = [statistics.states, *steps]
        cov = moves @ cov @ moves.T
    else:
        cov = cov * keeps[:, None] * keeps[None]
    cov = cov + jnp.diag(jnp.concatenate(steps))
    return Estimate(form.f(x, u), offset, statistics.pole * fading, cov)


def split_error(
    errors: list[Float[np.ndarray, " time"]], size: float
) -> tuple[float, float, float]:
    """Pole, variance of the noise and of the steps of what fades, from the errors of a
    free run over records; see the module."""
    lags = []
    for lag in range(3):
        products = [e[lag:] * e[: len(e) - lag] for e in errors]
        lags.append(float(np.mean(np.concatenate(products))))
    c0, c1, c2 = lags
    pole = float(np.clip(c2 / c1, 0.0, 1.0)) if c1 > 0 else 0.0
    slow = min(c1 / pole, c0) if pole > 0 else 0.0
    noise = max(c0 - slow, (LEAST_NOISE * size) ** 2)
    return pole, noise, slow * (1.0 - pole**2)
