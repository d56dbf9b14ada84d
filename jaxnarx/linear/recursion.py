"""Innovations of a linear model by the output-feedback recursion, and their derivative.

With w_i = B_i/F_i u_i the model (2.3) is

    w_i(t) = B_i u_i(t - nk_i) - sum_k f_(i,k) w_i(t - k)
    v(t)   = A y(t) - constant - sum_i w_i(t)
    e(t)   = v(t) + sum_k d_k v(t - k) - sum_k c_k e(t - k) ,

a recursion with the outputs w_1 ... w_m, v and e, which `arrays.recurrence.free_run`
runs and differentiates exactly. The parts that act on measured signals, B_i u_i and A
y, are a convolution before the loop. A record begins at the first sample with a
complete window; the w_i before it are its *initial states*, parameters of their own, v
and e before it are zero. Where a window holds a missing sample, v and e are zero:
nothing is known about the disturbance; w_i goes on with the values the inputs are held
at.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.arrays import free_run, usable
from jaxnarx.data import Batch
from jaxnarx.linear.structure import Coefficients, Structure


class Signals(eqx.Module):
    """Records of one shape: the inputs in use, the output, and where both are known.

    `known` holds where the whole window of a sample is valid.
    """

    u: Float[Array, "records time inputs"]
    y: Float[Array, "records time"]
    known: Bool[Array, "records time"]


def window_start(structure: Structure) -> int:
    """First sample of a record at which the innovations can be computed."""
    return max(structure.longest, structure.depth)


def signals(structure: Structure, batch: Batch, inputs: int, output: int) -> Signals:
    """The signals of a model; `inputs` counts those of the data."""
    own = inputs + output
    rows = [(own, k) for k in range(structure.na + 1)]
    for place, signal in enumerate(structure.inputs):
        rows += [(signal, k) for k in structure.input_lags(place)]
    known = usable(batch.valid, tuple(rows), window_start(structure))
    u = batch.signals[:, :, np.array(structure.inputs, dtype=np.int64)]
    return Signals(u, batch.signals[:, :, own], jnp.asarray(known))


def states(structure: Structure) -> int:
    """Number of initial states of a record."""
    return sum(structure.nf)


def record_innovations(
    structure: Structure,
    parameters: Float[Array, " params"],
    initial: Float[Array, " states"],
    u: Float[Array, "time inputs"],
    y: Float[Array, " time"],
    known: Bool[Array, " time"],
) -> Float[Array, " time"]:
    """e(t) of one record; zero where the window is not known."""
    p = structure.split(parameters)
    time, inputs = u.shape
    start, depth = window_start(structure), structure.depth
    ahead = [
        _convolve(b, u[:, i], nk)
        for i, (b, nk) in enumerate(zip(p.b, structure.nk, strict=True))
    ]
    weight = known.astype(y.dtype)
    forced = jnp.stack([*ahead, jnp.zeros_like(y)], axis=1)
    drive = (forced, (_convolve(p.a, y, 0) - p.constant) * weight, weight)
    measured = _initial(structure, initial, time, start)
    anchor = jnp.arange(time) == start
    wide = jnp.full(inputs + 2, jnp.inf, y.dtype)
    run = free_run(
        _step, (p.f, p.d, p.c), drive, measured, anchor, -wide, wide, depth=depth
    )
    return jnp.where(known, run[:, -1], 0.0)


def _convolve(
    polynomial: Coefficients, signal: Float[Array, " time"], delay: int
) -> Float[Array, " time"]:
    """sum_k p_k x(t - delay - k); before the record its first value."""
    time, total = signal.shape[0], jnp.zeros_like(signal)
    count = polynomial.shape[0]
    padded = jnp.concatenate([jnp.broadcast_to(signal[:1], (delay + count,)), signal])
    for k in range(count):
        total = total + polynomial[k] * padded[count - k : count - k + time]
    return total


def _initial(structure: Structure, initial, time, start):
    """History before `start`: newest first in `initial`, input after input."""
    outputs = len(structure.nf) + 2
    table = jnp.zeros((time, outputs), initial.dtype)
    at = 0
    for place, order in enumerate(structure.nf):
        past = initial[at : at + order][::-1]
        table = table.at[start - order : start, place].set(past)
        at += order
    return table


def _step(params, drive, history):
    """One step of the recursion; `history` is (outputs, depth), newest first."""
    f, d, c = params
    ahead, output, known = drive
    w = [
        ahead[i] - jnp.sum(f_i[1:] * history[i, : f_i.shape[0] - 1])
        for i, f_i in enumerate(f)
    ]
    v = output - known * sum(w, jnp.zeros((), output.dtype))
    past_v = jnp.sum(d[1:] * history[-2, : d.shape[0] - 1])
    past_e = jnp.sum(c[1:] * history[-1, : c.shape[0] - 1])
    return jnp.stack([*w, v, known * (v + past_v - past_e)])


@eqx.filter_jit
def residuals(
    structure: Structure,
    parameters: Float[Array, " params"],
    initial: Float[Array, "records states"],
    data: Signals,
) -> Float[Array, "records time"]:
    """Innovations of all records."""

    def one(x0, u, y, known):
        return record_innovations(structure, parameters, x0, u, y, known)

    return jax.vmap(one)(initial, data.u, data.y, data.known)


@eqx.filter_jit
def normal_equations(
    structure: Structure,
    parameters: Float[Array, " params"],
    initial: Float[Array, "records states"],
    data: Signals,
) -> tuple[
    Float[Array, "records time"],
    Float[Array, "records all"],
    Float[Array, "records all all"],
]:
    """Innovations e, J'e and J'J of every record.

    J is the derivative by the parameters and behind them the record's own states.
    """
    params = parameters.shape[0]

    def one(record):
        x0, u, y, known = record

        def errors(both):
            theta, x0 = both[:params], both[params:]
            found = record_innovations(structure, theta, x0, u, y, known)
            return found, found

        both = jnp.concatenate([parameters, x0])
        slope, value = jax.jacfwd(errors, has_aux=True)(both)
        return value, value @ slope, slope.T @ slope

    return jax.lax.map(one, (initial, data.u, data.y, data.known))


def steady(
    structure: Structure, parameters: Float[np.ndarray, " params"], data: Signals
) -> Float[np.ndarray, "records states"]:
    """Initial states of records that rest at their first input."""
    p, u = structure.split(parameters), np.asarray(data.u)
    columns = [np.zeros((len(u), 0), u.dtype)]
    for i, order in enumerate(structure.nf):
        settled = np.sum(p.b[i]) / np.sum(p.f[i])
        columns.append(np.repeat(settled * u[:, :1, i], order, axis=1))
    return np.concatenate(columns, axis=1)


def best_states(
    structure: Structure,
    parameters: Float[np.ndarray, " params"],
    initial: Float[np.ndarray, "records states"],
    data: Signals,
) -> Float[np.ndarray, "records states"]:
    """Initial states of least squared innovations; of smallest change where free."""
    if not states(structure):
        return initial
    theta, count = jnp.asarray(parameters), structure.size
    _, slope, gram = map(
        np.asarray, normal_equations(structure, theta, jnp.asarray(initial), data)
    )
    inverse = np.linalg.pinv(gram[:, count:, count:], hermitian=True)
    return initial - np.einsum("rij,rj->ri", inverse, slope[:, count:])
