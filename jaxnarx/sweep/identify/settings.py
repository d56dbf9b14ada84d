"""Settings that one program of identification supports, and those that it takes as
arrays."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.identification import terms_of
from jaxnarx.regressors import Pool
from jaxnarx.settings import (
    ForwardOLS,
    Global,
    Identification,
    Lolimot,
    Placed,
    PredictionError,
    SigmoidTree,
    SimulationError,
)

Arrays = np.ndarray | Array
Grown = Global | Lolimot | SigmoidTree | Placed

TRACED_SETTINGS = {
    ForwardOLS: ("max_terms", "rho"),
    Global: (),
    Lolimot: ("max_models", "k_sigma", "ridge", "scatter", "seed"),
    SigmoidTree: ("max_models", "smoothness", "ridge", "scatter", "seed"),
    Placed: ("max_models", "k_sigma", "ridge", "seed"),
    SimulationError: ("max_steps", "ridge", "train", "tolerance", "patience"),
    PredictionError: ("max_steps", "ridge", "train", "tolerance", "patience"),
}
"""Settings that are data to the program."""
STATIC_SETTINGS = {
    ForwardOLS: (),
    Global: (),
    Lolimot: ("scheduling", "validity", "criterion", "patience"),
    SigmoidTree: ("scheduling", "criterion", "patience"),
    Placed: ("scheduling", "at"),
    SimulationError: ("horizons", "window_steps", "width_band"),
    PredictionError: ("width_band",),
}
"""Settings that one program supports; with any other that is not at its default the
verbs are run instead."""
TRAINING_ORDERS = ("staged", "joint", "coefficients", "partition")


class Settings(eqx.Module):
    """A case for the program; `allowed` tells which terms it may use."""

    terms: Int[Arrays, "*lanes"]
    models: Int[Arrays, "*lanes"]
    steps: Int[Arrays, "*lanes"]
    seed: Int[Arrays, "*lanes"]
    allowed: Bool[Arrays, "*lanes terms"]
    coefficients: Bool[Arrays, "*lanes"]
    partition: Bool[Arrays, "*lanes"]
    staged: Bool[Arrays, "*lanes"]
    k_sigma: Float[Arrays, "*lanes"]
    smoothness: Float[Arrays, "*lanes"]
    ridge: Float[Arrays, "*lanes"]
    growth_ridge: Float[Arrays, "*lanes"]
    rho: Float[Arrays, "*lanes"]
    scatter: Float[Arrays, "*lanes"]
    tolerance: Float[Arrays, "*lanes"]
    patience: Int[Arrays, "*lanes"]


@dataclasses.dataclass(frozen=True)
class Shape:
    """The shape of a program: settings without those that it takes as arrays, and the
    largest numbers of terms, models and steps of all its cases."""

    grow: Grown
    refine: SimulationError | PredictionError
    terms: int
    models: int
    steps: int


def is_fused(method: Identification) -> bool:
    """Whether one program does it all."""
    parts = [method.select, method.grow]
    if method.refine is not None:
        parts.append(method.refine)
    if not all(type(part) in TRACED_SETTINGS and _has_defaults(part) for part in parts):
        return False
    if getattr(method.grow, "criterion", "") == "validation":
        return False
    refine = method.refine
    if isinstance(refine, SimulationError):
        told = refine.train in TRAINING_ORDERS and refine.horizons != "auto"
        return told and refine.max_steps > 0
    return refine is None or refine.max_steps > 0


def _has_defaults(part: Any) -> bool:
    """Whether all that the program does not know has its default."""
    known = TRACED_SETTINGS[type(part)] + STATIC_SETTINGS[type(part)]
    return all(
        getattr(part, f.name) == f.default
        for f in dataclasses.fields(part)
        if f.name not in known and f.name != "_"
    )


def shapes(methods: Sequence[Identification]) -> list[Shape | None]:
    """The program of every case, None where the verbs do it.

    Cases that differ only in what a program takes as arrays share one. Without a
    refinement a case goes with the others' first.
    """
    mine = [m for m in methods if is_fused(m)]
    first = next((m.refine for m in mine if m.refine is not None), None)
    other = first or SimulationError(horizons=())
    keys = {n: _key(m, other) for n, m in enumerate(methods) if is_fused(m)}
    found: list[Shape | None] = []
    for n in range(len(methods)):
        if n not in keys:
            found.append(None)
            continue
        group = [methods[k] for k, key in keys.items() if key == keys[n]]
        found.append(
            Shape(
                *keys[n],
                terms=max(m.select.max_terms for m in group),  # pyright: ignore
                models=max(getattr(m.grow, "max_models", 1) for m in group),
                steps=max(m.refine.max_steps if m.refine else 0 for m in group),
            )
        )
    return found


def _key(method: Identification, other: Any) -> tuple[Any, Any]:
    """Partition and refinement with defaults in place of what is traced."""

    def bare(part):
        usual = {f.name: f.default for f in dataclasses.fields(part)}
        own = {name: usual[name] for name in TRACED_SETTINGS[type(part)]}
        return dataclasses.replace(part, **own)

    return bare(method.grow), bare(method.refine or other)


def make_settings(method: Identification, pool: Pool, dtype: np.dtype) -> Settings:
    """The arrays of one case; `pool` is that of the program."""
    grow, refine = method.grow, method.refine
    train = "none" if refine is None else getattr(refine, "train", "joint")
    numbers = {
        "k_sigma": getattr(grow, "k_sigma", 1.0),
        "smoothness": getattr(grow, "smoothness", 1.0),
        "growth_ridge": getattr(grow, "ridge", 0.0),
        "scatter": getattr(grow, "scatter", 0.0),
        "rho": method.select.rho,  # pyright: ignore
        "ridge": getattr(refine, "ridge", 0.0),
        "tolerance": getattr(refine, "tolerance", 0.0),
    }
    return Settings(
        terms=np.asarray(method.select.max_terms),  # pyright: ignore
        models=np.asarray(getattr(grow, "max_models", 1)),
        steps=np.asarray(getattr(refine, "max_steps", 0)),
        patience=np.asarray(getattr(refine, "patience", 1)),
        seed=np.asarray(getattr(grow, "seed", 0)),
        allowed=terms_of(method.pool, pool),
        coefficients=np.asarray(train in ("joint", "staged", "coefficients")),
        partition=np.asarray(train in ("joint", "staged", "partition")),
        staged=np.asarray(train == "staged"),
        **{name: np.asarray(value, dtype) for name, value in numbers.items()},
    )


def spare(settings: Settings) -> Settings:
    """The shortest fit there is, to fill up a call."""
    one, none = np.asarray(1), np.asarray(0)
    off = np.asarray(False)
    return dataclasses.replace(
        settings,
        terms=one,
        models=one,
        steps=none,
        coefficients=off,
        partition=off,
        staged=off,
    )
