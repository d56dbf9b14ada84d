"""A virtual engine: one tank of air, filled by a throttle and emptied by a pump."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxnarx.data import Channel, Channels
from jaxnarx.engines import BEDS, AbstractEngine, Noise, parameter
from jaxnarx.excitation import aprbs


class Tank(AbstractEngine):
    """P' = (throttle - pump P)/volume, sampled every 0.1 s; exact for held inputs."""

    volume: Float[Array, ""] = parameter(2.0)
    pump: Float[Array, ""] = parameter(4.0)

    varied: ClassVar = {"volume": 1.0, "pump": 0.5}
    channels: ClassVar = Channels((Channel("throttle", "g/s"),), (Channel("P", "bar"),))
    ranges: ClassVar = {"throttle": (1.0, 4.0)}
    domain: ClassVar = {"throttle": (0.0, 5.0)}
    limits: ClassVar = {"P": (-0.1, 2.0)}
    noise: ClassVar = {"P": Noise(0.002, 0.0)}
    event: ClassVar = None

    @property
    def sample_time(self):
        return 0.1

    def steady_state(self, inputs):
        return inputs / self.pump

    def rest(self, inputs):
        return self.steady_state(inputs)

    def advance(self, carry, inputs):
        kept = jnp.exp(-self.sample_time * self.pump / self.volume)
        return kept * carry + (1 - kept) * inputs / self.pump, carry

    def margins(self, carry, inputs):
        return {"overpressure": 1.5 - carry[0]}

    def excite(self, key, length):
        return aprbs(key, length, hold=(5, 20), amplitude=(1.0, 4.0))[:, None]


BEDS.register("tank", Tank)
