"""The quantities imposed on the turbocharged engine, and all that is known of it."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, ScalarLike

SLOWEST = 1000.0  # rpm
EVENT = 180.0  # degrees crank angle


class GtdiDrive(NamedTuple):
    """Inputs that are imposed on the engine; an entry that is `None` takes care of
    itself.

    `throttle` angle [deg, 4 is shut]. `speed` [rpm], held by the dynamometer. `fuel`
    [mg/stroke], else what the present air flow needs for lambda one times `richness`.
    `spark` advance [deg BTDC], else the knock-limited schedule plus `offset` [deg].
    """

    throttle: ScalarLike
    speed: ScalarLike
    fuel: ScalarLike | None = None
    spark: ScalarLike | None = None
    richness: ScalarLike = 1.0
    offset: ScalarLike = 0.0


class GtdiQuantities(NamedTuple):
    """Everything the model knows at one instant; derivatives are per second."""

    fuel: Float[Array, "*time"]  # mg/stroke
    spark: Float[Array, "*time"]  # deg BTDC
    best_spark: Float[Array, "*time"]  # deg BTDC, of greatest torque
    torque: Float[Array, "*time"]  # Nm, brake, before delay and sensor
    indicated: Float[Array, "*time"]  # Nm, of the fuel
    drag: Float[Array, "*time"]  # Nm, friction and gas exchange
    ratio: Float[Array, "*time"]  # lambda, dimensionless
    afr: Float[Array, "*time"]  # air to fuel by mass
    pressure: Float[Array, "*time"]  # kPa, intake manifold
    boost: Float[Array, "*time"]  # kPa, before the throttle
    back_pressure: Float[Array, "*time"]  # kPa, exhaust manifold
    turbo: Float[Array, "*time"]  # krpm
    temperature: Float[Array, "*time"]  # K, exhaust manifold
    wastegate: Float[Array, "*time"]  # opening, 0 to 1
    compressor_flow: Float[Array, "*time"]  # g/s
    throttle_flow: Float[Array, "*time"]  # g/s
    air: Float[Array, "*time"]  # g/s, into the cylinders
    fuel_flow: Float[Array, "*time"]  # g/s
    turbine_flow: Float[Array, "*time"]  # g/s, with that of the wastegate
    tail_flow: Float[Array, "*time"]  # g/s, out of the exhaust pipe
    compressor_power: Float[Array, "*time"]  # W
    turbine_power: Float[Array, "*time"]  # W
    surge_margin: Float[Array, "*time"]  # dimensionless; surge at 1e-6 and below
    derivative: Float[Array, "*time states"]


def impose_columns(
    inputs: Float[Array, " inputs"], arrived: Float[Array, ""] | None = None
) -> GtdiDrive:
    """The columns of a record: fuel, spark, throttle, speed; `arrived` is the throttle
    command behind its dead time, if not the present one."""
    fuel, spark, throttle, speed = inputs
    throttle = throttle if arrived is None else arrived
    return GtdiDrive(throttle, speed, fuel=fuel, spark=spark)


def value_or_default(
    value: ScalarLike | None, otherwise: Float[Array, ""]
) -> Float[Array, ""]:
    """`value` as an array of the dtype of `otherwise`, which it replaces if given."""
    if value is None:
        return otherwise
    return jnp.asarray(value, otherwise.dtype)


def gtdi_margins(q: GtdiQuantities) -> dict[str, Float[Array, "*time"]]:
    """Margins to the limits of the bed [O]; any shape.

    `mixture`: lambda inside 0.7 to 1.4. `heat`: exhaust up to 1250 K, enrich above.
    `boost`: up to 230 kPa before the throttle. `turbo`: up to 190 krpm. `vacuum`:
    intake at least 25 kPa. `surge`: the compressor not on its surge tail. `spark`:
    inside -40 to 20 degrees from the best, where the torque curve holds.
    """
    early = q.spark - q.best_spark
    return {
        "mixture": jnp.minimum(q.ratio - 0.7, 1.4 - q.ratio),
        "heat": 1250.0 - q.temperature,
        "boost": 230.0 - q.boost,
        "turbo": 190.0 - q.turbo,
        "vacuum": q.pressure - 25.0,
        "surge": q.surge_margin - 1e-6,
        "spark": jnp.minimum(early + 40.0, 20.0 - early),
    }
