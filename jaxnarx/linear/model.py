"""Linear models: polynomials in the shift operator, as transfer functions or
networks.
"""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxnarx.checks import require_known
from jaxnarx.data import Channel, Channels
from jaxnarx.formatting import page
from jaxnarx.linear.structure import Polynomials, Structure
from jaxnarx.linear.transfer_function import TransferFunction
from jaxnarx.models import OUTPUT_MARGIN, Network, global_model
from jaxnarx.regressors import Variables


class LinearModel(eqx.Module):
    """A(q) y = sum_i B_i(q)/F_i(q) u_i(t - nk_i) + constant + C(q)/D(q) e: (2.3).

    For one output, in physical units. `parameters` lie as `structure` says;
    `covariance` is theirs, from the Gauss-Newton approximation of the information, and
    `noise_variance` that of e, in squares of the output's unit. `low` and `high` are
    the range of every signal in the training data.
    """

    structure: Structure = eqx.field(static=True)
    channels: Channels = eqx.field(static=True)
    output: int = eqx.field(static=True)
    parameters: Float[Array, " params"]
    covariance: Float[Array, "params params"]
    noise_variance: Float[Array, ""]
    sample_time: Float[Array, ""]
    low: Float[Array, " signals"]
    high: Float[Array, " signals"]

    def __check_init__(self):
        if self.parameters.shape != (self.structure.size,):
            raise ValueError(
                f"the structure has {self.structure.size} parameters, got an array "
                f"of shape {self.parameters.shape}"
            )

    @property
    def polynomials(self) -> Polynomials:
        """A, B_i, C, D, F_i and the constant."""
        return self.structure.split(self.parameters)

    def _host(self) -> Polynomials:
        return self.structure.split(np.asarray(self.parameters))

    @property
    def a(self) -> Float[Array, " _"]:
        """A(q) by rising powers of q^-1, from its one on."""
        return jnp.asarray(self.polynomials.a)

    @property
    def b(self) -> tuple[Float[Array, " _"], ...]:
        """B_i(q) behind the delay of every input."""
        return tuple(map(jnp.asarray, self.polynomials.b))

    @property
    def c(self) -> Float[Array, " _"]:
        """C(q)."""
        return jnp.asarray(self.polynomials.c)

    @property
    def d(self) -> Float[Array, " _"]:
        """D(q)."""
        return jnp.asarray(self.polynomials.d)

    @property
    def f(self) -> tuple[Float[Array, " _"], ...]:
        """F_i(q) of every input."""
        return tuple(map(jnp.asarray, self.polynomials.f))

    @property
    def constant(self) -> Float[Array, ""]:
        """The constant term, behind 1/A and not F; in the output's unit."""
        return jnp.asarray(self.polynomials.constant)

    @property
    def delays(self) -> tuple[int, ...]:
        """nk_i [samples]."""
        return self.structure.nk

    @property
    def input_names(self) -> list[str]:
        """Names of the inputs in use."""
        names = self.channels.input_names
        return [names[i] for i in self.structure.inputs]

    @property
    def output_channel(self) -> Channel:
        """The modelled output."""
        return self.channels.outputs[self.output]

    @property
    def parameter_names(self) -> list[str]:
        """`a2`, `b6(duty)`: the number is the lag."""
        return self.structure.names(self.channels.input_names)

    @property
    def standard_errors(self) -> Float[np.ndarray, " params"]:
        """Standard deviation of every parameter."""
        return np.sqrt(np.maximum(np.diagonal(np.asarray(self.covariance)), 0.0))

    @property
    def poles(self) -> np.ndarray:
        """The poles from every input and the constant to the output, slowest first."""
        p = self._host()
        roots = [np.roots(np.trim_zeros(np.asarray(x), "b")) for x in (p.a, *p.f)]
        every = np.concatenate(roots).astype(complex)
        return every[np.argsort(-np.abs(every), kind="stable")]

    @property
    def stable(self) -> bool:
        """Whether all of `poles` lie inside the unit circle."""
        return bool(np.all(np.abs(self.poles) < 1))

    def transfer_function(self, input: str | None = None) -> TransferFunction:
        """B/(A F) of one input, its delay included; unnamed, of the only one."""
        place, p = self._place(input), self._host()
        delay = np.zeros(self.structure.nk[place])
        return TransferFunction(
            np.concatenate([delay, np.asarray(p.b[place])]),
            np.convolve(p.a, p.f[place]),
            float(self.sample_time),
            self.channels.inputs[self.structure.inputs[place]],
            self.output_channel,
        )

    def noise_transfer_function(self) -> TransferFunction:
        """C/(A D), from the innovation to the output."""
        p = self._host()
        return TransferFunction(
            np.asarray(p.c),
            np.convolve(p.a, p.d),
            float(self.sample_time),
            None,
            self.output_channel,
        )

    def _place(self, name: str | None) -> int:
        if name is None and len(self.input_names) == 1:
            return 0
        told = f"no input {name!r} in the model"
        return self.input_names.index(
            require_known(name, self.input_names, "input", told)
        )

    def network(self) -> Network:
        """The deterministic part as a `Network`, for `simulate`, `predict`, `report`.

        Everything over the common denominator: y = (1 - A F) y + sum_i B_i F/F_i u_i +
        F(1) constant, F the product of all F_i. An ARX model is unchanged and its
        one-step predictions are the optimal ones. For the others only the free run is
        the model's own: their optimal one-step prediction needs C and D, see
        `innovations`. A free run starts from measured outputs.
        """
        s, p = self.structure, self._host()
        f = [np.asarray(x) for x in p.f]
        past = _product([np.asarray(p.a), *f])
        ahead = [
            np.convolve(b, _product(f[:i] + f[i + 1 :])) for i, b in enumerate(p.b)
        ]
        inputs = len(self.channels.inputs)
        rows = [
            (signal, s.nk[i] + k)
            for i, signal in enumerate(s.inputs)
            for k in range(len(ahead[i]))
        ]
        own = inputs + self.output
        rows += [(own, k) for k in range(1, len(past))]
        theta = [float(p.constant) * _product(f).sum(), *np.concatenate(ahead + [[]])]
        return self._network(rows, np.array([*theta, *-past[1:]]))

    def _network(self, rows: list[tuple[int, int]], theta: np.ndarray) -> Network:
        low, high = np.asarray(self.low), np.asarray(self.high)
        size = np.maximum(np.abs(low), np.abs(high))
        gain = np.where(size > 0, size, 1.0).astype(low.dtype)
        own = len(self.channels.inputs) + self.output
        scale = np.array([1.0, *(gain[s] for s, _ in rows)]) / gain[own]
        factor = np.arange(len(rows) + 1, dtype=np.int32)[:, None]
        wider = OUTPUT_MARGIN * (high - low)[own : own + 1]
        return Network(
            self.channels,
            (self.output,),
            Variables(tuple(rows)),
            (global_model(factor, (theta * scale).astype(low.dtype)),),
            jnp.asarray(gain),
            jnp.asarray((low[own : own + 1] - wider) / gain[own]),
            jnp.asarray((high[own : own + 1] + wider) / gain[own]),
            self.low,
            self.high,
            self.sample_time,
        )

    def __str__(self) -> str:
        """A line for every parameter, with its standard error and their ratio."""
        unit = self.output_channel.unit
        rms = math.sqrt(max(float(self.noise_variance), 0.0))
        lines = [
            f"{self.output_channel.name}: noise {rms:.4g}{f' {unit}' if unit else ''} "
            f"rms, {'stable' if self.stable else 'unstable'}, sample time "
            f"{float(self.sample_time):.6g} s"
        ]
        names = self.parameter_names
        width = max(map(len, names))
        values, errors = np.asarray(self.parameters), self.standard_errors
        for name, value, error in zip(names, values, errors, strict=True):
            ratio = f"{value / error:10.2f}" if error > 0 else f"{'-':>10s}"
            lines.append(f"  {name:{width}s} {value:14.6g} +- {error:10.3g} {ratio}")
        return "\n".join(lines)

    _repr_html_ = page


def _product(polynomials: list[np.ndarray]) -> np.ndarray:
    out = np.ones(1)
    for p in polynomials:
        out = np.convolve(out, p)
    return out
