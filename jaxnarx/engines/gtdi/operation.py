"""Running the turbocharged engine: fuel and spark on schedule, usual excitation."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxnarx.engines.delays import lagging_speed
from jaxnarx.engines.gtdi.state import (
    EVENT,
    SLOWEST,
    GtdiDrive,
    GtdiQuantities,
    impose_columns,
)
from jaxnarx.excitation import aprbs

# `engine` is a `Gtdi` throughout; its type is not named to keep imports one-way.

SPEED_LAG = 0.5  # s [O]


@eqx.filter_jit
def operate(engine: Any, inputs: Float[Array, "time inputs"]) -> GtdiQuantities:
    """All quantities at the start of each event of a run, before delays and sensors."""

    def event(carry, row):
        now = engine.quantities(carry[0], impose_columns(row))
        return engine.advance(carry, row)[0], now

    return jax.lax.scan(event, engine.rest(inputs[0]), inputs)[1]


@eqx.filter_jit
def schedule_inputs(
    engine: Any, demands: Float[Array, "time inputs"]
) -> tuple[Float[Array, "time inputs"], GtdiQuantities]:
    """Inputs whose fuel and spark follow the engine, and what `operate` says of them.

    `demands` has the columns richness (factor on the fuel for lambda one at the present
    air flow), offset [deg] from the knock-limited spark, throttle angle [deg] and speed
    [rpm]. Fuel and spark are set at the start of each event and held. The returned
    inputs give the same run in `simulate`.
    """

    def to_drive(row: Float[Array, " inputs"]) -> GtdiDrive:
        richness, offset, throttle, speed = row
        return GtdiDrive(throttle, speed, richness=richness, offset=offset)

    def event(carry, row):
        now = engine.quantities(carry[0], to_drive(row))
        inputs = jnp.concatenate([jnp.stack([now.fuel, now.spark]), row[2:]])
        return engine.advance(carry, inputs)[0], (inputs, now)

    first = to_drive(demands[0])
    state = engine.balance(first)
    now = engine.quantities(state, first)
    inputs = jnp.concatenate([jnp.stack([now.fuel, now.spark]), demands[0, 2:]])
    carry = engine.settled_bench(state, inputs)
    return jax.lax.scan(event, carry, demands)[1]


def gtdi_demands(
    key: PRNGKeyArray,
    length: int,
    *,
    hold: tuple[int, int] = (20, 120),
    speed_hold: tuple[int, int] = (60, 240),
) -> Float[Array, "time inputs"]:
    """APRBS demands for `scheduled`, in events of 180 degrees.

    Richness 0.88 to 1.15, spark offset -12 to 4 deg, throttle 10 to 32 deg, each held
    for `hold`; speed 1200 to 3000 rpm, `speed_hold`, through a lag of 0.5 s [O].
    """
    keys = jax.random.split(key, 4)
    spans = ((0.88, 1.15), (-12.0, 4.0), (10.0, 32.0))
    signals = [
        aprbs(k, length, hold=hold, amplitude=span)
        for k, span in zip(keys[:3], spans, strict=True)
    ]
    target = aprbs(keys[3], length, hold=speed_hold, amplitude=(1200.0, 3000.0))

    speed = lagging_speed(target, degrees=EVENT, slowest=SLOWEST, lag=SPEED_LAG)
    return jnp.stack([*signals, speed], axis=1)
