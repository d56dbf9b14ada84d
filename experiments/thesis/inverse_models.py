"""The forward network and the inverses of `chapter7_inverse.py`, and their scores."""

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import numpy as np
from inverse_bed import COMMANDS, TARGETS

import jaxnarx as jnx
from jaxnarx.metrics import scores

LEAD = {"TRQ": 4, "lambda": 8}
"""Samples by which the inverse sees what is asked for."""
REGIONS, TERMS, FORWARD_TERMS = 3, 20, 80
SCHEDULING = ("MAP[t-1]", "RPM[t]")
DEEP = (1, 2, 3, 5, 8)
AIR = tuple(f"lambda_ahead8[t-{k}]*FUL[t]" for k in (2, 4, 6))
"""The air that is asked for, beside the pressure that is there."""
FORCED = ("MAP[t-1]", "MAP[t-2]", *AIR, "RPM[t]", "FUL[t]")
FORWARD_LAGS = dict.fromkeys(("FUL", "SA", "THR", "LEAN"), DEEP) | {"RPM": (1, 4)}
FORWARD_STEPS = jnx.SimulationError(
    horizons=(20, 100), window_steps=8, max_steps=20, patience=6
)
INVERSE_STEPS = jnx.SimulationError(
    horizons=(10, 50), window_steps=8, max_steps=20, patience=8
)


def forward_of(
    train: jnx.Dataset,
    guard: jnx.Dataset,
    *,
    lags: Sequence[int] | Mapping[str, Sequence[int]] = FORWARD_LAGS,
    every: jnx.Dataset | None = None,
    brief: bool = False,
) -> jnx.Network:
    """All outputs by cubic terms of ERR in these lags of the inputs, refined; the terms
    are those of `train`, or of `every` record."""
    chosen_by = train if every is None else every
    pool = jnx.polynomial_pool(
        train.channels,
        input_lags=lags,
        output_lags=(1, 2),
        degree=2 if brief else 3,
    )
    method = jnx.ForwardOLS(max_terms=15 if brief else FORWARD_TERMS)
    terms = jnx.select(pool, chosen_by, method).value
    start = jnx.grow(terms, chosen_by, jnx.Global()).value
    if brief:
        return start
    return jnx.refine(start, train, FORWARD_STEPS, validation=guard).value


def turned(data: jnx.Dataset) -> jnx.Dataset:
    """Read backwards: from torque and lambda to spark and throttle."""
    return jnx.inverse.inverse_data(
        data, commands=COMMANDS, targets=TARGETS, lead=LEAD, states=["MAP"]
    )


def inverse_pool(channels: jnx.Channels) -> jnx.Pool:
    """Products of two; the throttle remembers itself, the spark does not."""
    ahead = {f"{n}_ahead{k}": k for n, k in LEAD.items()}
    return jnx.polynomial_pool(
        channels,
        input_lags={name: range(k + 2) for name, k in ahead.items()}
        | dict.fromkeys(("FUL", "LEAN"), range(3))
        | {"RPM": (0, 1), "MAP": (1, 2)},
        output_lags={"THR": (1,)},
        degree=2,
    )


def inverse_of(
    train: jnx.Dataset,
    guard: jnx.Dataset,
    forced: Sequence[str] = (),
    *,
    brief: bool = False,
) -> tuple[jnx.Network, jnx.Network]:
    """The direct inverse: its tree as grown, and with its borders optimised."""
    data = turned(train)
    pool = inverse_pool(data.channels)
    # Small ones are of one size, so that direct and forced share their programs.
    count = TERMS if brief else TERMS + len(forced)
    method = jnx.ForwardOLS(max_terms=count, forced=forced)
    terms = jnx.select(pool, data, method).value
    tree = jnx.SigmoidTree(
        SCHEDULING, max_models=REGIONS, oblique=False, criterion="none"
    )
    grown = jnx.grow(terms, data, tree).value
    if brief:
        return grown, grown
    refined = jnx.refine(grown, data, INVERSE_STEPS, validation=turned(guard))
    return grown, refined.value


def throttle_alone(inverse: jnx.Network) -> jnx.Network:
    """What the tracking error trains: all that commands the throttle.

    The spark moves the torque by less than the forward model misses, so that training
    it through the model would fit the model's errors.
    """
    trained = jnx.freeze(inverse)
    still = jnx.freeze(inverse, coefficients=False, partition=False)
    at = inverse.output_names.index("THR")
    return eqx.tree_at(lambda n: n.models[at], still, trained.models[at])


def persisted(data: jnx.Dataset) -> list[np.ndarray]:
    """Every output as it was one sample ago."""
    return [np.concatenate([r.y[:1], r.y[:-1]]) for r in data]


def judged(network: jnx.Network, data: jnx.Dataset) -> dict[str, dict[str, Any]]:
    """Errors of every output: persistence, one step ahead, free run."""
    one, free = jnx.predict(network, data).value, jnx.simulate(network, data).value
    found = {
        "persistence": measured(data, persisted(data), free.scored),
        "one_step": measured(data, one.outputs, one.scored),
        "free_run": measured(data, free.outputs, free.scored),
    }
    flags = np.any(free.diverged, axis=0)
    for row, flag in zip(found["free_run"].values(), flags, strict=True):
        row["diverged"] = bool(flag)
    return found


def measured(data: jnx.Dataset, outputs: Any, scored: Any) -> dict[str, dict[str, Any]]:
    """fit, R2 and NRMSE by output, over all records."""
    columns = [np.concatenate([r.y for r in data])]
    columns += [np.concatenate(part) for part in (outputs, scored)]
    values = scores(*columns)
    names = data.channels.output_names
    return {
        name: {k: float(f"{values[k][i]:.6g}") for k in ("fit", "r2", "nrmse")}
        for i, name in enumerate(names)
    }
