"""What a predictive controller is asked to do: its network, commands and limits."""

import equinox as eqx
from jaxtyping import Array, Float

from jaxnarx.arrays import twin
from jaxnarx.control.observer import ErrorStatistics
from jaxnarx.models import Domain, Network, driving_signals


class ControlProblem(eqx.Module):
    """A network, what it is asked to do, and how: the fields of a controller, whose
    docstring explains them."""

    network: Network
    commands: tuple[int, ...] = eqx.field(static=True)
    targets: tuple[int, ...] = eqx.field(static=True)
    bounded: tuple[int, ...] = eqx.field(static=True)
    blocks: tuple[int, ...] = eqx.field(static=True)
    horizon: int = eqx.field(static=True)
    first: int = eqx.field(static=True)
    rounds: int = eqx.field(static=True)
    observe_states: bool = eqx.field(static=True)
    low: Float[Array, " commands"]
    high: Float[Array, " commands"]
    move: Float[Array, " commands"]
    effort: Float[Array, " commands"]
    weight: Float[Array, " targets"]
    floor: Float[Array, " limits"]
    ceiling: Float[Array, " limits"]
    guard: Float[Array, " limits"]
    size: Float[Array, " outputs"]
    span: Float[Array, " commands"]
    statistics: ErrorStatistics
    domain: Domain | None = None
    fade: Float[Array, " used"] | None = None

    @property
    def nameless(self) -> "ControlProblem":
        """Copy with a network without names, which are no part of a program."""
        return twin(self, network=self.network.nameless)

    @property
    def given(self) -> tuple[int, ...]:
        """Places of the inputs that the controller does not set."""
        every = range(len(driving_signals(self.network)))
        return tuple(c for c in every if c not in self.commands)
