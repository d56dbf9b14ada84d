"""The `gtdi` bed at the rate of its controller, for `chapter7_inverse.py`.

A sample is `DOWN` events, one cycle of the engine. Spark and throttle are held for it;
fuel and speed go on from event to event.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxnarx as jnx
from jaxnarx.engines import Gtdi
from jaxnarx.engines.delays import lagging_speed
from jaxnarx.engines.gtdi import schedule_inputs
from jaxnarx.excitation import aprbs

DOWN = 4
"""Events of a sample."""
STEP = DOWN * 0.015
"""Nominal duration of a sample, at 2,000 rpm [s]."""
STOICHIOMETRIC = 14.6
SPANS = ((0.88, 1.15), (-12.0, 4.0), (14.0, 26.0))
"""Richness, spark from its schedule [deg], throttle [deg], as `chapter7_forward`."""
SPEEDS = (1500.0, 2500.0)  # rpm
HOLD, SPEED_HOLD = (5, 30), (15, 60)
"""Samples between steps of those, and of the speed."""
INPUTS = (
    *(jnx.Channel("FUL", "mg/stroke"), jnx.Channel("SA", "deg")),
    *(jnx.Channel("THR", "deg"), jnx.Channel("RPM", "rpm")),
    jnx.Channel("LEAN", "stroke/g"),
)
"""LEAN is 1000/FUL, which makes lambda a product."""
OUTPUTS = (
    *(jnx.Channel("TRQ", "Nm"), jnx.Channel("lambda", "-")),
    jnx.Channel("MAP", "kPa"),
)
COMMANDS, TARGETS = ("SA", "THR"), ("TRQ", "lambda")
UNIT = np.array([1.0, 1 / STOICHIOMETRIC, 1.0])
"""From the bed's outputs to ours."""


def excite(key: Any, length: int) -> np.ndarray:
    """Inputs per event of `length` samples: random steps, fuel follows the air."""
    keys = jax.random.split(key, 4)
    signals = [
        jnp.repeat(aprbs(k, length, hold=HOLD, amplitude=span), DOWN)
        for k, span in zip(keys[:3], SPANS, strict=True)
    ]
    target = aprbs(keys[3], length, hold=SPEED_HOLD, amplitude=SPEEDS)
    speed = lagging_speed(
        jnp.repeat(target, DOWN), degrees=180.0, slowest=SPEEDS[0], lag=0.5
    )
    u = np.array(schedule_inputs(Gtdi(), jnp.stack([*signals, speed], axis=1))[0])
    u[:, 1:3] = np.repeat(u[::DOWN, 1:3], DOWN, axis=0)
    return u


def recorded(
    seed: int, length: int, parts: Sequence[str]
) -> tuple[jnx.Dataset, list[np.ndarray], list[np.ndarray]]:
    """Measured records at the controller's rate; the bed's inputs per event of each;
    and its outputs without noise at the controller's rate."""
    key, noise = jax.random.split(jax.random.key(seed))
    u = [excite(jax.random.fold_in(key, i), length) for i in range(len(parts))]
    bed = Gtdi().simulate(u, noise, names=parts)
    clean = Gtdi().simulate(u, noise, names=parts, noise=0)
    return sampled(bed), u, [r.y[::DOWN] * UNIT[None] for r in clean]


def sampled(bed: jnx.Dataset) -> jnx.Dataset:
    """Every `DOWN`-th event, with our channels."""
    return jnx.Dataset.from_arrays(
        [given(record.u) for record in bed],
        [record.y[::DOWN] * UNIT[None] for record in bed],
        inputs=list(INPUTS),
        outputs=list(OUTPUTS),
        sample_time=STEP,
        names=[record.name for record in bed],
    )


def given(u: np.ndarray) -> np.ndarray:
    """Columns of `INPUTS` from the bed's inputs per event."""
    u = u[::DOWN]
    return np.column_stack([u, 1000 / u[:, 0]])


def asked(data: jnx.Dataset, clean: Sequence[np.ndarray]) -> jnx.Dataset:
    """The same records with outputs without noise, as references."""
    return jnx.Dataset.from_arrays(
        [record.u for record in data],
        list(clean),
        inputs=list(INPUTS),
        outputs=list(OUTPUTS),
        sample_time=data.sample_time,
        names=data.names,
    )
