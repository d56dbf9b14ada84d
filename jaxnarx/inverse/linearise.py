"""A forward network linearised along data: static gains and zeros.

At one sample, with w the backward shift q^-1, outputs y, commands u:

    A(w) y = B(w) u,   A(w) = I - sum_d A_d w^d,   B(w) = sum_d B_d w^d H_d(w),

H the filters that variables pass. Slopes are total: through terms and scheduling.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from jaxnarx.arrays import program
from jaxnarx.data import Dataset, stack_records
from jaxnarx.errors import SpecError
from jaxnarx.models import Network, held_inputs, scheduling_values
from jaxnarx.regressors import (
    AbstractFilter,
    FilterSystem,
    even_places,
    realise,
    row_columns,
)
from jaxnarx.simulation import match_records, tables

SMALL_LEADING_SHARE = 1e-8
"""Leading coefficients of a polynomial below this share of its largest are zero."""


@dataclasses.dataclass(frozen=True, eq=False)
class LocalSlopes:
    """Derivatives of the outputs by every lagged variable at samples of the data.

    `entries` are (signal, lag, filter); `slope[p, o, e]` in physical units; `place`
    every signal at the shortest lag at which the network looks at it.
    """

    network: Network
    entries: tuple[tuple[int, int, AbstractFilter | None], ...]
    slope: Float[np.ndarray, "points outputs entries"]
    place: Float[np.ndarray, "points signals"]

    def feedback(
        self, w: Complex[np.ndarray, " values"]
    ) -> Complex[np.ndarray, "points values outputs outputs"]:
        """A(w) at every point, for several w."""
        return np.eye(len(self.network.signals))[None, None] - self.through(
            list(self.network.signals), w
        )

    def through(
        self, signals: list[int], w: Complex[np.ndarray, " values"]
    ) -> Complex[np.ndarray, "points values outputs chosen"]:
        """B(w) from these signals, for several w."""
        shape = (*self.slope.shape[:1], len(w), self.slope.shape[1], len(signals))
        total = np.zeros(shape, complex)
        for e, (signal, lag, filter_) in enumerate(self.entries):
            if signal in signals:
                way = w**lag * self._transfer_function(filter_, w)
                column = signals.index(signal)
                total[..., column] += way[None, :, None] * self.slope[:, None, :, e]
        return total

    def _transfer_function(
        self, filter_: AbstractFilter | None, w: Complex[np.ndarray, " values"]
    ) -> Complex[np.ndarray, " values"]:
        """Transfer function of a filter, c (I - A w)^-1 b."""
        if filter_ is None:
            return np.ones(len(w), complex)
        system = _system(filter_, self.network)
        a, b = np.asarray(system.a), np.asarray(system.b)
        left = np.eye(len(b))[None] - w[:, None, None] * a[None]
        state = np.linalg.solve(left, np.broadcast_to(b, (len(w), len(b)))[..., None])
        return state[..., 0] @ np.asarray(system.c)

    def denominator(
        self, signals: list[int], w: Complex[np.ndarray, " values"]
    ) -> tuple[Complex[np.ndarray, " values"], int]:
        """Product of the filters' denominators per column, and its degree in w."""
        total, degree = np.ones(len(w), complex), 0
        for signal in signals:
            own = {f for s, _, f in self.entries if s == signal and f is not None}
            for filter_ in own:
                a = np.asarray(_system(filter_, self.network).a)
                left = np.eye(len(a))[None] - w[:, None, None] * a[None]
                total = total * np.linalg.det(left)
                degree += len(a)
        return total, degree

    def deepest(self, signals: list[int]) -> int:
        """Sum over signals of the largest lag at which each is looked at."""
        return sum(
            max((lag for s, lag, _ in self.entries if s == signal), default=0)
            for signal in signals
        )


def _system(filter_: AbstractFilter, network: Network) -> FilterSystem:
    return realise(filter_, float(network.sample_time))


def local_slopes(network: Network, data: Dataset, *, points: int = 600) -> LocalSlopes:
    """Linearise at `points` measured samples, evenly spaced.

    Local models with feedback of their own and hidden channels are refused: their past
    is not measured. If the network has limits, inputs beyond their range stand at its
    edge.
    """
    require_shared(network)
    data = match_records(network, data)
    batch = held_inputs(network, stack_records(data))
    at = even_places(
        batch, tables(network), network.history, points, "the network needs"
    )
    gain = np.asarray(network.gain)
    time = data.sample_time
    v = row_columns(batch, at, network.variables, time, gain=gain, ones=1)
    x = tuple(
        jnp.asarray(row_columns(batch, at, m.scheduling, time)) for m in network.models
    )
    by_v, by_x = _slopes(network, jnp.asarray(v), x)
    entries = list(network.variables.entries)
    scale = gain[np.array(network.signals)]
    inner = np.asarray(by_v)[:, :, 1:] / gain[network.variables.signal]
    slope = [inner * scale[None, :, None]]
    for o, model in enumerate(network.models):
        entries += model.scheduling.entries
        own = np.zeros((len(at), len(scale), len(model.scheduling)))
        own[:, o] = np.asarray(by_x[o]) * scale[o]
        slope.append(own)
    flat = np.asarray(batch.signals).reshape(-1, len(gain))
    lags = [
        min([d for s, d in tables(network) if s == n] or [0]) for n in range(len(gain))
    ]
    place = np.stack([flat[at - lag, s] for s, lag in enumerate(lags)], axis=1)
    slopes = np.concatenate(slope, axis=2).astype(float)
    return LocalSlopes(network, tuple(entries), slopes, place)


def require_shared(network: Network) -> None:
    """SpecError where local models have feedback of their own, or channels are
    hidden."""
    network.require_measured("An inverse")
    if network.parallel:
        raise SpecError(
            "the forward model has local models with feedback of their own, whose past "
            "is not measured; grow it with feedback of the network",
            field="forward",
        )


@program
def _slopes(
    network: Network,
    v: Float[Array, "vars points"],
    x: tuple[Float[Array, "_ points"], ...],
):
    """Derivative of the scaled outputs by scaled variables and physical scheduling."""

    def outputs(v, x):
        pairs = zip(network.models, x, strict=True)
        return [m(v, scheduling_values(m, one)) for m, one in pairs]

    def by_v(v, x):
        return jnp.stack(jax.jacrev(outputs)(v, x))

    def by_x(v, x):
        whole = jax.jacrev(outputs, argnums=1)(v, x)
        return tuple(row[o] for o, row in enumerate(whole))

    each = (1, tuple(1 for _ in x))
    return jax.vmap(by_v, each)(v, x), jax.vmap(by_x, each)(v, x)


def static_gain(
    local: LocalSlopes, targets: list[int], commands: list[int]
) -> Float[np.ndarray, "points targets commands"]:
    """(A(1)^-1 B(1)) from commands to targets; NaN where the network is not stable.

    `targets` are places among the modelled outputs, `commands` signals.
    """
    one = np.ones(1, complex)
    parts = local.feedback(one), local.through(commands, one)
    a, b = (np.real(part[:, 0]) for part in parts)
    stable = is_stable(local)
    a = np.where(stable[:, None, None], a, np.eye(a.shape[1])[None])
    gain = np.linalg.solve(a, b)[:, targets]
    return np.where(stable[:, None, None], gain, np.nan)


def is_stable(local: LocalSlopes) -> Bool[np.ndarray, " points"]:
    """Whether all poles of each linearisation lie inside the unit circle."""
    own = list(local.network.signals)
    w = _circle(local.deepest(own))
    coefficients = _coefficients(np.linalg.det(local.feedback(w)))
    return np.array([np.all(np.abs(_roots(c)) < 1) for c in coefficients])


def zeros(
    local: LocalSlopes, targets: list[int], commands: list[int]
) -> list[Complex[np.ndarray, " _"]]:
    """Finite invariant zeros of every point, from as many commands as targets.

    Roots in z = 1/w of det [[A(w), -B(w)], [T, 0]], T picking the targets, times the
    filters' denominators. Poles that no target shows are among them. Dead time (roots
    at w = 0) is left out.
    """
    own = list(local.network.signals)
    _, filters = local.denominator(commands, np.ones(1, complex))
    w = _circle(local.deepest([*own, *commands]) + filters)
    a, b = local.feedback(w), local.through(commands, w)
    count, outputs = len(targets), len(own)
    whole = np.zeros((*a.shape[:2], outputs + count, outputs + count), complex)
    whole[..., :outputs, :outputs], whole[..., :outputs, outputs:] = a, -b
    whole[..., outputs + np.arange(count), targets] = 1.0
    value = np.linalg.det(whole) * local.denominator(commands, w)[0][None]
    return [_roots(c) for c in _coefficients(value)]


def _circle(degree: int) -> Complex[np.ndarray, " values"]:
    """Points on the unit circle that determine a polynomial of this degree."""
    return np.exp(2j * np.pi * np.arange(degree + 1) / (degree + 1))


def _coefficients(
    values: Complex[np.ndarray, "points values"],
) -> Float[np.ndarray, "points values"]:
    """Coefficients in rising powers of real polynomials known on `_circle`."""
    return np.fft.fft(values, axis=1).real / values.shape[1]


def _roots(rising: Float[np.ndarray, " _"]) -> Complex[np.ndarray, " _"]:
    """z = 1/w for the roots w other than zero of a polynomial in w."""
    there = np.flatnonzero(
        np.abs(rising) > SMALL_LEADING_SHARE * np.abs(rising).max(initial=0.0)
    )
    if not len(there):
        return np.zeros(0, complex)
    # In z the same coefficients stand in falling powers.
    return np.roots(rising[there[0] : there[-1] + 1]).astype(complex)
