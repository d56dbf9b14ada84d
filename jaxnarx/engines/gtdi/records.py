"""Excitation of the turbocharged engine: fuel and spark on schedule, limits flagged."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from jaxnarx.data import Dataset
from jaxnarx.data.excitation import aprbs
from jaxnarx.engines.events import event_duration
from jaxnarx.engines.gtdi.bed import EVENT, SLOWEST, Gtdi
from jaxnarx.engines.gtdi.state import Drive, Quantities, imposed

SPEED_LAG = 0.5  # s [O]


class Breaches(NamedTuple):
    """Which limits a sample breaks; any shape."""

    mixture: Bool[Array, "*time"]  # lambda outside 0.7 to 1.4
    heat: Bool[Array, "*time"]  # exhaust above 1250 K: enrich
    boost: Bool[Array, "*time"]  # above 230 kPa before the throttle
    turbo: Bool[Array, "*time"]  # above 190 krpm
    vacuum: Bool[Array, "*time"]  # intake below 25 kPa
    surge: Bool[Array, "*time"]  # the compressor runs on its surge tail

    @property
    def any(self) -> Bool[Array, "*time"]:
        """Where at least one limit is broken."""
        return jnp.any(jnp.stack(list(self)), axis=0)


def breaches(q: Quantities) -> Breaches:
    """Compare with the limits of the bed [O]; what is not finite breaks them all.

    Flags samples and ends nothing: a run that breaks them is simulated all the same,
    and its samples can be masked.
    """
    return Breaches(
        mixture=~((q.ratio >= 0.7) & (q.ratio <= 1.4)),
        heat=~(q.temperature <= 1250.0),
        boost=~(q.boost <= 230.0),
        turbo=~(q.turbo <= 190.0),
        vacuum=~(q.pressure >= 25.0),
        surge=~(q.surge_margin > 1e-6),
    )


@eqx.filter_jit
def operate(engine: Gtdi, inputs: Float[Array, "time inputs"]) -> Quantities:
    """All quantities at the start of each event of a run, before delays and sensors."""

    def event(carry, row):
        now = engine.quantities(carry[0], imposed(row))
        return engine.advance(carry, row)[0], now

    return jax.lax.scan(event, engine.rest(inputs[0]), inputs)[1]


@eqx.filter_jit
def scheduled(
    engine: Gtdi, demands: Float[Array, "time inputs"]
) -> tuple[Float[Array, "time inputs"], Quantities]:
    """Inputs whose fuel and spark follow the engine, and what `operate` says of them.

    `demands` has the columns richness (factor on the fuel for lambda one at the present
    air flow), offset [deg] from the knock-limited spark, throttle angle [deg] and speed
    [rpm]. Fuel and spark are set at the start of each event and held. The returned
    inputs give the same run in `simulate`.
    """

    def demanded(row: Float[Array, " inputs"]) -> Drive:
        richness, offset, throttle, speed = row
        return Drive(throttle, speed, richness=richness, offset=offset)

    def event(carry, row):
        now = engine.quantities(carry[0], demanded(row))
        inputs = jnp.concatenate([jnp.stack([now.fuel, now.spark]), row[2:]])
        return engine.advance(carry, inputs)[0], (inputs, now)

    first = demanded(demands[0])
    state = engine.steady_state(first)
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

    def follow(speed, demand):
        duration = event_duration(EVENT, speed, slowest=SLOWEST)
        return demand + (speed - demand) * jnp.exp(-duration / SPEED_LAG), speed

    speed = jax.lax.scan(follow, target[0], target)[1]
    return jnp.stack([*signals, speed], axis=1)


def gtdi_records(
    key: PRNGKeyArray,
    lengths: Sequence[int] = (3600, 3600, 3600),
    *,
    names: Sequence[str] | None = ("train", "validate", "test"),
    engine: Gtdi | None = None,
    noise: float | int = 1.0,
    outputs: Sequence[str] | None = None,
) -> Dataset:
    """Torque, air-fuel ratio and intake pressure under APRBS on all four inputs.

    One record for each of `lengths`, in events of 180 degrees, all different
    realisations of `gtdi_demands`. `noise` scales the measurement noise. `names` is
    `None` to number the records. Excitation as in section 3.11 of the bed's
    specification [O].
    """
    engine = Gtdi() if engine is None else engine
    excitation, noise_key = jax.random.split(key)
    inputs = [
        scheduled(engine, gtdi_demands(jax.random.fold_in(excitation, i), length))[0]
        for i, length in enumerate(lengths)
    ]
    return engine.simulate(inputs, noise_key, noise=noise, names=names, outputs=outputs)
