"""The static map of a forward network: where its outputs rest under held signals."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.models import Network, respond
from jaxnarx.regressors import Variables, static_gains

NEWTON_STEPS = 12
"""Newton steps to the equilibrium; quadratic convergence needs about six."""
EQUILIBRIUM_TOLERANCE = 1e-6
"""Error allowed at an equilibrium, scaled."""


class Statics(eqx.Module):
    """A network and the static gains of the filters its variables pass."""

    network: Network
    terms: Float[Array, " vars"]
    scheduling: tuple[Float[Array, " _"], ...]

    def __call__(
        self, y: Float[Array, " outputs"], signals: Float[Array, " signals"]
    ) -> Float[Array, " outputs"]:
        """Scaled outputs one step on when everything has been held for ever."""
        network = self.network
        own = np.array(network.signals)
        held = network.hold_inputs(signals).at[own].set(y * network.gain[own])
        v = held[network.variables.signal] / network.gain[network.variables.signal]
        v = jnp.concatenate([jnp.ones(1, v.dtype), v * self.terms])
        pairs = zip(network.models, self.scheduling, strict=True)
        x = tuple(held[m.scheduling.signal] * size for m, size in pairs)
        return respond(network, v, x)

    def rest(
        self, signals: Float[Array, " signals"]
    ) -> tuple[Float[Array, " outputs"], Bool[Array, ""]]:
        """The equilibrium y = F(y), scaled, by Newton's method within the bounds of the
        feedback, and whether it was found. Begins at the outputs among `signals`.

        Its derivative by `signals` is that of the implicit function.
        """
        network = self.network
        own = np.array(network.signals)

        def newton(y, signals):
            slope = jax.jacfwd(self)(y, signals)
            missing = self(y, signals) - y
            return y + jnp.linalg.solve(
                jnp.eye(y.shape[0], dtype=y.dtype) - slope, missing
            )

        def step(_, y):
            moved = newton(y, held)
            moved = jnp.where(jnp.isfinite(moved), moved, y)
            return jnp.clip(moved, network.lower, network.upper)

        held = jax.lax.stop_gradient(signals)
        y = jax.lax.fori_loop(0, NEWTON_STEPS, step, held[own] / network.gain[own])
        y = jax.lax.stop_gradient(y)
        found = jnp.all(jnp.abs(self(y, held) - y) < EQUILIBRIUM_TOLERANCE)
        # One step more at the equilibrium carries the derivative of the implicit
        # function; the slope's own derivative meets a zero there.
        return newton(y, signals), found


def statics(network: Network) -> Statics:
    """The static map of a network."""
    time = float(network.sample_time)

    def sizes(table: Variables) -> Float[Array, " vars"]:
        gain = static_gains([f for _, _, f in table.entries], time)
        return jnp.asarray(gain, network.gain.dtype)

    scheduling = tuple(sizes(m.scheduling) for m in network.models)
    return Statics(network, sizes(network.variables), scheduling)
