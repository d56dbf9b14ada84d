"""What is calibrated: a network, a virtual engine, or a function of one's own."""

import abc
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxnarx.design import rest_run
from jaxnarx.errors import SpecError
from jaxnarx.models import Network, input_memory, require_computed

LEAD_MEMORIES = 5.0
"""Memories of a network that it is run at rest before a cycle."""


class AbstractPlant(eqx.Module):
    """Outputs over time from inputs over time; pure."""

    inputs: eqx.AbstractVar[tuple[str, ...]]
    outputs: eqx.AbstractVar[tuple[str, ...]]
    sample_time: eqx.AbstractVar[float]

    @abc.abstractmethod
    def run(self, u: Float[Array, "time inputs"]) -> Float[Array, "time outputs"]:
        """Outputs of a run from rest under the first inputs; physical units."""

    @abc.abstractmethod
    def begin(self, u: Float[Array, " inputs"]) -> tuple[Any, Float[Array, " outputs"]]:
        """A state at rest under these inputs, and the outputs there."""

    @abc.abstractmethod
    def step(
        self, state: Any, u: Float[Array, " inputs"]
    ) -> tuple[Any, Float[Array, " outputs"]]:
        """The next state, and the outputs of this sample."""


class NetworkPlant(AbstractPlant):
    """A network that computes all outputs that it looks at."""

    network: Network
    inputs: tuple[str, ...] = eqx.field(static=True)
    outputs: tuple[str, ...] = eqx.field(static=True)
    sample_time: float = eqx.field(static=True)
    lead: int = eqx.field(static=True)

    @classmethod
    def of(cls, network: Network) -> "NetworkPlant":
        """The plant; SpecError where it looks at outputs that it does not compute."""
        require_computed(network, "plant")
        lead = math.ceil(LEAD_MEMORIES * input_memory(network)) + network.history
        return cls(
            network=network,
            inputs=tuple(network.channels.input_names),
            outputs=tuple(network.output_names),
            sample_time=float(network.sample_time),
            lead=lead,
        )

    @property
    def _gain(self) -> Float[Array, " outputs"]:
        own = self.network
        return own.gain[jnp.array(own.signals[: len(own.modelled)])]

    def run(self, u: Float[Array, "time inputs"]) -> Float[Array, "time outputs"]:
        """The free run behind a rest at the first inputs."""
        return rest_run(self.network, u, self.lead) * self._gain[None]

    def begin(self, u: Float[Array, " inputs"]) -> tuple[Any, Float[Array, " outputs"]]:
        """At rest."""
        state = self.network.init("steady", u[None])
        return self.network.step(state, u)

    def step(
        self, state: Any, u: Float[Array, " inputs"]
    ) -> tuple[Any, Float[Array, " outputs"]]:
        """One sample."""
        return self.network.step(state, u)


class EnginePlant(AbstractPlant):
    """A virtual engine, of `jnx.engines` or with the same methods, whose inputs are
    held for `every` events."""

    engine: Any
    inputs: tuple[str, ...] = eqx.field(static=True)
    outputs: tuple[str, ...] = eqx.field(static=True)
    sample_time: float = eqx.field(static=True)
    every: int = eqx.field(static=True)

    @classmethod
    def of(cls, engine: Any, every: int = 1) -> "EnginePlant":
        """The plant."""
        names = engine.channels
        return cls(
            engine=engine,
            inputs=tuple(names.input_names),
            outputs=tuple(names.output_names),
            sample_time=every * float(engine.sample_time),
            every=every,
        )

    def run(self, u: Float[Array, "time inputs"]) -> Float[Array, "time outputs"]:
        """Outputs at the first event of every sample."""
        return self.engine.run(jnp.repeat(u, self.every, axis=0))[:: self.every]

    def begin(self, u: Float[Array, " inputs"]) -> tuple[Any, Float[Array, " outputs"]]:
        """At rest."""
        return self.step(self.engine.rest(u), u)

    def step(
        self, state: Any, u: Float[Array, " inputs"]
    ) -> tuple[Any, Float[Array, " outputs"]]:
        """One sample of as many events."""
        held = jnp.broadcast_to(u, (self.every, *u.shape))
        state, y = jax.lax.scan(lambda s, row: self.engine.advance(s, row), state, held)
        return state, y[0]


class FunctionPlant(AbstractPlant):
    """A function of one's own, (time, inputs) to (time, outputs); it has no steps."""

    function: Callable[[Any], Any] = eqx.field(static=True)
    inputs: tuple[str, ...] = eqx.field(static=True)
    outputs: tuple[str, ...] = eqx.field(static=True)
    sample_time: float = eqx.field(static=True)

    def run(self, u: Float[Array, "time inputs"]) -> Float[Array, "time outputs"]:
        """Outputs of the function."""
        return self.function(u)

    def begin(self, u: Float[Array, " inputs"]) -> tuple[Any, Float[Array, " outputs"]]:
        """SpecError."""
        raise _no_steps()

    def step(
        self, state: Any, u: Float[Array, " inputs"]
    ) -> tuple[Any, Float[Array, " outputs"]]:
        """SpecError."""
        raise _no_steps()


def _no_steps() -> SpecError:
    return SpecError(
        "maps over outputs need a plant that makes steps: a network, or an engine; "
        "a function has none",
        field="plant",
    )


def as_plant(given: Any, every: int = 1) -> AbstractPlant:
    """A plant of what may be one."""
    if isinstance(given, AbstractPlant):
        return given
    if isinstance(given, Network):
        return NetworkPlant.of(given)
    if all(hasattr(given, n) for n in ("rest", "advance", "run", "channels")):
        return EnginePlant.of(given, every)
    raise SpecError(
        f"a plant is a network, a virtual engine or a FunctionPlant, not a "
        f"{type(given).__name__}",
        field="plant",
    )
