"""How outputs depend on parameters during an experiment, by any model."""

import abc
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import whole
from jaxnarx.errors import SpecError
from jaxnarx.models import Network, OutputModel, run_record, scheduling_values


class AbstractSensitivity(eqx.Module):
    """Sensitivities of an experiment's outputs to a model's parameters."""

    @abc.abstractmethod
    def __call__(
        self, inputs: Float[Array, "time inputs"]
    ) -> Float[Array, "time outputs params"]:
        """Derivative of every output sample by every parameter, in units of the noise.

        Parameters are measured in the units their errors are to be compared in: the
        criteria A depends on it, D and G do not.
        """


class ResponseSensitivity(AbstractSensitivity):
    """Sensitivity of any simulation `response(parameters, inputs)` -> (time, outputs).

    `parameters` is the vector about which information is wanted, at its best present
    value; `noise` the standard deviation of each output. It uses forward mode, one
    tangent per parameter. A virtual engine, for example: `lambda p, u: place(engine,
    p).run(u)`.
    """

    response: Callable[..., Any]
    parameters: Float[Array, " params"]
    noise: Float[Array, " outputs"]

    def __call__(
        self, inputs: Float[Array, "time inputs"]
    ) -> Float[Array, "time outputs params"]:
        """Derivative of the response, in units of the noise."""
        slope = jax.jacfwd(lambda p: self.response(p, inputs))(self.parameters)
        return slope / self.noise[None, :, None]


class NetworkSensitivity(AbstractSensitivity):
    """Sensitivity of a network by its coefficients, from a free run under the inputs.

    With `one_step` the outputs are taken as measured, as in least squares of the
    equation error: S_t are the regressors weighted by the validity functions. Without,
    it is that of the free run itself, as in refinement on simulation error. `noise` is
    the standard deviation of each output in physical units. `lead` samples of the first
    inputs bring the run to rest before the experiment begins.
    """

    network: Network
    noise: Float[Array, " outputs"]
    used: tuple[tuple[tuple[int, int], ...], ...] = eqx.field(static=True)
    one_step: bool = eqx.field(static=True)
    lead: int = eqx.field(static=True)

    def place(self, p: Float[Array, " params"]) -> Network:
        """The network with these coefficients."""
        new, start = [], 0
        for model, used in zip(self.network.models, self.used, strict=True):
            at = tuple(np.array(used).T)
            values = p[start : start + len(used)]
            new.append(model.local.coefficient.at[at].set(values))
            start += len(used)
        where = lambda n: [m.local.coefficient for m in n.models]  # noqa: E731
        return eqx.tree_at(where, self.network, new)

    @property
    def parameters(self) -> Float[Array, " params"]:
        """All coefficients in use, outputs one after another."""
        pairs = zip(self.network.models, self.used, strict=True)
        pieces = [m.local.coefficient[tuple(np.array(at).T)] for m, at in pairs]
        return jnp.concatenate(pieces)

    def __call__(
        self, inputs: Float[Array, "time inputs"]
    ) -> Float[Array, "time outputs params"]:
        """Derivative of the outputs by `parameters`, in units of the noise."""
        network = self.network
        signals = jnp.array(network.signals)
        scale = self.noise / network.gain[signals]
        if self.one_step:
            slope = self._regressors(inputs)
        else:
            slope = jax.jacfwd(lambda p: self._run(self.place(p), inputs)[2])(
                self.parameters
            )
        return slope / scale[None, :, None]

    def _run(self, network: Network, inputs: Float[Array, "time inputs"]):
        """Lagged and scheduling variables and scaled outputs of the run."""
        u = _prepend_inputs(network, inputs, self.lead)
        y = _run_from_rest(network, u)
        at = jnp.array(network.modelled)
        gain = network.gain[jnp.array(network.signals)][None]
        outputs = jnp.zeros((u.shape[0], len(network.channels.outputs)), u.dtype)
        # What the model would have seen had its own run been measured.
        outputs = outputs.at[:, at].set(y * gain)
        v, x = network.columns(jnp.concatenate([u, outputs], axis=1))
        keep = slice(u.shape[0] - inputs.shape[0], None)
        return v[:, keep], tuple(one[:, keep] for one in x), y[keep]

    def _regressors(
        self, inputs: Float[Array, "time inputs"]
    ) -> Float[Array, "time outputs params"]:
        v, x, _ = self._run(self.network, inputs)

        def outputs(p):
            pairs = zip(self.place(p).models, x, strict=True)
            return jnp.stack([m(v, scheduling_values(m, one)) for m, one in pairs], 1)

        return jax.jacfwd(outputs)(self.parameters)


def rest_run(
    network: Network, inputs: Float[Array, "time inputs"], lead: int
) -> Float[Array, "time outputs"]:
    """Scaled outputs of a free run, hidden channels left out.

    `lead` samples of the first inputs bring it to rest before.
    """
    y = _run_from_rest(network, _prepend_inputs(network, inputs, lead))
    return y[-inputs.shape[0] :, : len(network.modelled)]


def _prepend_inputs(
    network: Network, inputs: Float[Array, "time inputs"], lead: int
) -> Float[Array, "samples inputs"]:
    """Put the first inputs before them."""
    before = max(lead, network.history)
    return jnp.concatenate([jnp.tile(inputs[:1], (before, 1)), inputs])


def _run_from_rest(
    network: Network, u: Float[Array, "time inputs"]
) -> Float[Array, "time states"]:
    """All that a free run computes, begun in the middle of its bounds; scaled."""
    signals = jnp.pad(u, ((0, 0), (0, len(network.channels.outputs))))
    v, x = network.columns(signals)
    middle = ((network.lower + network.upper) / 2)[None]
    anchor = jnp.arange(u.shape[0]) == network.history
    return run_record(network, v, x, jnp.tile(middle, (u.shape[0], 1)), anchor)


@guard_arguments
def network_sensitivity(
    network: Network,
    *,
    noise: Mapping[str, float] | None = None,
    one_step: bool = True,
    lead: int = 200,
) -> NetworkSensitivity:
    """`NetworkSensitivity` by all coefficients in use.

    `noise` is the standard deviation by output, in its unit; without, one hundredth of
    each output's training range. A network that uses measured outputs it does not model
    is refused: nobody knows what they would be under another plan. So is one with
    hidden channels.
    """
    network.require_measured("The design of experiments")
    _require_own(network)
    whole(lead, "lead", 0)
    at = jnp.array(network.signals)
    deviation = 0.01 * (network.high - network.low)[at]
    if noise is not None:
        deviation = jnp.asarray(
            _list_noise(noise, network.output_names), deviation.dtype
        )
    return NetworkSensitivity(
        network, deviation, _coefficients(network), one_step, lead
    )


def run_sensitivity(network: Network, lead: int) -> NetworkSensitivity:
    """Sensitivity of a free run, also of a network with hidden channels; noise of size
    one."""
    _require_own(network)
    noise = jnp.ones(len(network.models), network.gain.dtype)
    return NetworkSensitivity(network, noise, _coefficients(network), False, lead)


def _require_own(network: Network) -> None:
    """SpecError where it uses measured outputs that it does not model."""
    own = {*range(len(network.channels.inputs)), *network.signals}
    tables = [network.variables, *(m.scheduling for m in network.models)]
    if any(s not in own for table in tables for s, _ in table):
        raise SpecError(
            "the network uses measured outputs that it does not model; a plan can only "
            "be designed through a model that computes all its outputs",
            field="network",
        )


def _coefficients(network: Network) -> tuple[tuple[tuple[int, int], ...], ...]:
    """Model and slot of all coefficients in use, by output."""
    return tuple(
        tuple((m, s) for m, s in np.argwhere(_used_slots(model)).tolist())
        for model in network.models
    )


def _used_slots(model: OutputModel) -> Bool[np.ndarray, "models slots"]:
    return np.asarray(model.local.used) & np.asarray(model.active)[:, None]


def _list_noise(noise: Mapping[str, float], names: list[str]) -> list[float]:
    if set(noise) != set(names) or not all(0 < v < np.inf for v in noise.values()):
        raise SpecError(
            f"noise must give a positive standard deviation for {', '.join(names)}, "
            f"got {dict(noise)}",
            field="noise",
        )
    return [float(noise[name]) for name in names]
