"""Filters at work: as discrete systems, over whole records or sample by sample."""

from collections.abc import Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.regressors.filters import AbstractFilter, require_sampled

BLOCK_SAMPLES = 64
"""Samples done at once by one matrix product; the time loop runs over such blocks."""

_product = partial(jnp.matmul, precision=jax.lax.Precision.HIGHEST)


class FilterTable(eqx.Module):
    """Filters as arrays of one shape, so that one program runs any of them.

    Per filter a cascade of sections, padded behind the one whose output is used: `pole`
    holds real and imaginary part [1/s], `state` the place of the output among the
    states, of which every section has two. The second state of a real pole rests.
    """

    pole: Float[np.ndarray, "filters sections 2"]
    state: Int[np.ndarray, " filters"]
    unit_gain: Bool[np.ndarray, " filters"]

    def __getitem__(self, n: int) -> "FilterTable":
        """Row `n`, without the leading axis."""
        return jax.tree.map(lambda leaf: leaf[n], self)


def filter_table(filters: Sequence[AbstractFilter]) -> FilterTable:
    """Convert filters to a table of their kinds and coefficients."""
    longest = max((len(f.sections) for f in filters), default=1)
    pole = np.tile(np.array([-1.0, 0.0]), (len(filters), longest, 1))
    for n, f in enumerate(filters):
        pole[n, : len(f.sections)] = [(p.real, p.imag) for p in f.sections]
    places = [2 * section + which for section, which in (f.state for f in filters)]
    return FilterTable(
        pole,
        np.array(places, dtype=np.int64),
        np.array([f.unit_gain for f in filters], dtype=bool),
    )


class FilterSystem(eqx.Module):
    """A filter at one sample time: x(t+1) = A x(t) + b u(t), y(t) = c x(t+1).

    `rest` is the state in which a unit input has been constant for ever. The rows of
    [A b] are orthonormal: the state of a white input of unit variance is white with
    unit variance, and rounding errors do not grow.
    """

    a: Float[Array, "states states"]
    b: Float[Array, " states"]
    c: Float[Array, " states"]
    rest: Float[Array, " states"]

    def initial(self, u: Float[Array, ""]) -> Float[Array, " states"]:
        """The state after the input has been `u` for ever."""
        return self.rest * u

    def step(
        self, state: Float[Array, " states"], u: Float[Array, ""]
    ) -> tuple[Float[Array, " states"], Float[Array, ""]]:
        """Next state and the output, both with `u` taken in."""
        state = _product(self.a, state) + self.b * u
        return state, jnp.sum(self.c * state)

    def response(self, u: Float[Array, " time"]) -> Float[Array, " time"]:
        """Output over a record that begins at rest at its first value.

        Blocks of samples are lifted: within a block the output is a lower triangular
        product with the impulse response plus what the state before the block
        contributes, so that the loop over time makes one step per block.
        """
        length = u.shape[0]
        blocks = -(-length // BLOCK_SAMPLES)
        rows = jnp.pad(u, (0, blocks * BLOCK_SAMPLES - length)).reshape(
            blocks, BLOCK_SAMPLES
        )
        # reached[k] = A^k b and seen[k] = c A^(k+1)
        _, reached = jax.lax.scan(
            lambda x, _: (_product(self.a, x), x), self.b, length=BLOCK_SAMPLES
        )
        _, seen = jax.lax.scan(
            lambda x, _: (_product(x, self.a), x),
            _product(self.c, self.a),
            length=BLOCK_SAMPLES,
        )
        whole = _power(self.a, BLOCK_SAMPLES)
        at = jnp.arange(BLOCK_SAMPLES)
        delay = at[:, None] - at[None]
        pulse = _product(reached, self.c)
        lower = jnp.where(delay >= 0, pulse[jnp.maximum(delay, 0)], 0.0)
        gain = _product(rows, reached[::-1])
        states = jax.lax.scan(
            lambda x, g: (_product(whole, x) + g, x), self.initial(u[0]), gain
        )[1]
        y = _product(rows, lower.T) + _product(states, seen.T)
        return y.reshape(-1)[:length]


def _power(a: Float[Array, "states states"], exponent: int):
    """A^exponent for a power of two, by squaring."""
    for _ in range(exponent.bit_length() - 1):
        a = _product(a, a)
    return a


def realise(filter_: AbstractFilter, sample_time: float | int) -> FilterSystem:
    """`filter_` as a discrete system at this sample time [s], for use in a stream.

        system = realise(LowPass(4.0), 0.1)
        state = system.initial(u[0])
        state, y = system.step(state, u[t])     # for every t from 0

    The states of the cascade are those of `jaxnarx.regressors.filters`, two a section.
    """
    require_sampled((filter_,), float(sample_time))
    table = filter_table((filter_,))[0]
    return eqx.filter_jit(system_of)(table, jnp.asarray(float(sample_time)))


def static_gains(
    filters: Sequence[AbstractFilter | None], sample_time: float | int
) -> Float[np.ndarray, " filters"]:
    """Value of every filter when its input has been one for ever; one of None."""
    gain = np.ones(len(filters))
    for row, filter_ in enumerate(filters):
        if filter_ is not None:
            system = realise(filter_, sample_time)
            gain[row] = float(jnp.sum(system.c * system.rest))
    return gain


def system_of(table: FilterTable, sample_time: Float[Array, ""]) -> FilterSystem:
    """The system of one row of a table; `sample_time` [s] may be traced.

    Section i has e_(i+1) = c_i x_i + d_i e_i for the input of the next one, an all-pass
    whose static gain is one, and e_0 = u.
    """
    a, b, c, d, rest = _sections(
        jnp.asarray(table.pole, sample_time.dtype), sample_time
    )
    sections = d.shape[0]
    number = jnp.repeat(jnp.arange(sections), 2)

    def add(carry, section):
        entering, direct = carry
        i, a_i, b_i, c_i, d_i = section
        own = jnp.where(number == i, jnp.tile(c_i, sections), 0.0)
        block = jnp.where(number[None] == i, jnp.tile(a_i, (1, sections)), 0.0)
        rows = block + b_i[:, None] * entering[None]
        return (d_i * entering + own, d_i * direct), (rows, b_i * direct)

    start = (jnp.zeros(2 * sections, d.dtype), jnp.ones((), d.dtype))
    _, (rows, inputs) = jax.lax.scan(add, start, (jnp.arange(sections), a, b, c, d))
    rest = rest.reshape(-1)
    static = rest[table.state]
    size = jnp.where(table.unit_gain, 1 / static, 1.0)
    output = jnp.where(jnp.arange(2 * sections) == table.state, size, 0.0)
    return FilterSystem(
        rows.reshape(2 * sections, -1), inputs.reshape(-1), output, rest
    )


def _sections(pole: Float[Array, "sections 2"], sample_time: Float[Array, ""]):
    """A (2, 2), b, c (2), d and the state at rest of every section.

    [[A b], [c d]] is orthogonal. One real pole a: A = a, b = c = sqrt(1 - a^2), d = -a.
    A pair r exp(+- i w), with Wahlberg's beta = 2 r cos w / (1 + r^2), gamma = -r^2 and
    s_x = sqrt(1 - x^2): A = [[-beta gamma, gamma s_beta], [s_beta, beta]], b =
    [s_gamma, 0], c = s_gamma [-beta, s_beta], d = -gamma. Differences from one are
    formed without cancellation, since slow poles come close to it.
    """
    decay, angle = pole[:, 0] * sample_time, pole[:, 1] * sample_time
    r, zero = jnp.exp(decay), jnp.zeros_like(decay)
    near, near_square = -jnp.expm1(decay), -jnp.expm1(2 * decay)
    root = jnp.sqrt(near_square)
    below = (near**2 + 4 * r * jnp.sin(angle / 2) ** 2) / (1 + r**2)
    beta, gamma = 1 - below, -(r**2)
    root_beta = jnp.sqrt(below * (1 + beta))
    root_gamma = jnp.sqrt(near_square * (1 + r**2))
    rest_1 = jnp.sqrt(near_square / (1 + r**2))
    rest_2 = rest_1 * jnp.sqrt((1 + beta) / below)

    def pick(real, pair):
        chosen = [
            jnp.where(pole[:, 1] != 0, p, q) for p, q in zip(pair, real, strict=True)
        ]
        return jnp.stack(chosen, axis=1)

    a = pick(
        (r, zero, zero, zero),
        (-beta * gamma, gamma * root_beta, root_beta, beta),
    ).reshape(-1, 2, 2)
    b = pick((root, zero), (root_gamma, zero))
    c = pick((root, zero), (-beta * root_gamma, root_beta * root_gamma))
    d = pick((-r,), (-gamma,))[:, 0]
    return a, b, c, d, pick((root / near, zero), (rest_1, rest_2))


def hold(
    u: Float[Array, " time"], valid: Bool[Array, " time"]
) -> Float[Array, " time"]:
    """`u` with its last valid value in place of missing ones, the first before it.

    A record without valid sample stays as it is at its first.
    """
    at = jnp.arange(u.shape[0])
    last = jax.lax.cummax(jnp.where(valid, at, -1))
    return u[jnp.where(last >= 0, last, jnp.argmax(valid))]


def filter_input(
    table: FilterTable,
    u: Float[Array, " time"],
    valid: Bool[Array, " time"] | None,
    sample_time: Float[Array, ""],
) -> Float[Array, " time"]:
    """One record's `u` through one filter.

    The filter starts as if the first valid value had been there for ever; missing
    samples are bridged by the last valid value.
    """
    bridged = u if valid is None else hold(u, valid)
    return system_of(table, sample_time).response(bridged)
