"""The structure of a fleet: chosen from donors together, with ranges of all."""

import dataclasses
from collections import Counter
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxnarx.arrays import Progress
from jaxnarx.data import Dataset, Groups, join
from jaxnarx.errors import DataError
from jaxnarx.fleet.broken import FAR_DEVIATIONS, LEAST_SPREAD, deviations
from jaxnarx.fleet.coefficients import FleetCoefficients
from jaxnarx.fleet.donors import Donors, prepare_donor, require_records
from jaxnarx.fleet.information import gather_information, parts_of
from jaxnarx.identification import identify
from jaxnarx.models import Network, ranges, set_bounds
from jaxnarx.settings import Identification
from jaxnarx.simulation import match_records

POOLED_DONORS = 64
"""Donors whose records choose a structure, tell domain and intervals, and colour."""
STRUCTURE_FOLDS = 4
"""Parts of them that are held out in turn while a structure is chosen."""
BOUND_WIDTHS = 10.0
"""Bounds of what is fed back, in widths of the donors' ranges."""


def pool_donors(donors: Donors, names: list[str]) -> Dataset:
    """Records of some donors together, each a group of its own; without those whose
    channels, sample time, or outputs are unlike most others'."""
    step = max(1, len(names) // POOLED_DONORS)
    found, last = {}, None
    for name in names[::step][:POOLED_DONORS]:
        data = donors[name]
        if isinstance(data, DataError):
            last = data
            continue
        require_records(name, data)
        found[name] = data
    if not found:
        raise last or DataError("no donor has records")
    kinds = {n: (*d.channels.all, round(d.sample_time, 9)) for n, d in found.items()}
    usual = Counter(kinds.values()).most_common(1)[0][0]
    alike = {n: d for n, d in found.items() if kinds[n] == usual}
    parts = [
        dataclasses.replace(
            d,
            records=tuple(
                dataclasses.replace(r, name=f"{n} {r.name}", group=n) for r in d
            ),
        )
        for n, d in alike.items()
    ]
    size = [[np.concatenate([r.y for r in d]).std(axis=0)] for d in parts]
    size = np.log(np.maximum(np.concatenate(size), 1e-300))
    far = np.abs(deviations(size, np.full(len(size), True), LEAST_SPREAD)).max(axis=1)
    kept = [d for d, f in zip(parts, far.tolist(), strict=True) if f < FAR_DEVIATIONS]
    return join(kept or parts)


def widen_ranges(network: Network, pooled: Dataset) -> Network:
    """The network with ranges of all donors, and bounds that let engines differ."""
    low, high = ranges(match_records(network, pooled))
    # Hidden channels, behind those measured, keep the ranges of their training.
    low = network.low.at[: len(low)].min(low)
    high = network.high.at[: len(high)].max(high)
    return set_bounds(dataclasses.replace(network, low=low, high=high), BOUND_WIDTHS)


def engine_groups(pooled: Dataset, parts: int = STRUCTURE_FOLDS) -> Groups:
    """Engines in so many groups that are held out together."""
    engines = list(dict.fromkeys(r.group for r in pooled))
    parts = min(parts, len(engines))
    place = {name: n % parts for n, name in enumerate(engines)}
    labels = tuple(np.full(len(r), place[r.group]) for r in pooled)
    return Groups(tuple(f"engines, part {n + 1}" for n in range(parts)), labels, True)


def choose_structure(
    pooled: Dataset,
    method: Identification | None,
    preset: str,
    folder: Path | None,
    progress: Progress | None,
) -> Network:
    """The structure of all engines, judged on engines left out."""
    if method is not None:
        return identify(pooled, method, progress=progress).value
    groups = engine_groups(pooled)
    given: dict[str, Any] = {"groups": groups} if len(groups) > 1 else {}
    given |= {"preset": preset, "folder": folder, "progress": progress}
    return identify(pooled, **given).value


def scale_coefficients(
    own: FleetCoefficients, pooled: Dataset, skip: int
) -> tuple[FleetCoefficients, Float[np.ndarray, " outputs"]]:
    """Coefficients in units of their effect on the outputs of some donors, and the
    variances of these, scaled."""
    runs = prepare_donor(own.layout.base, pooled, skip)
    part = jax.device_put(parts_of(runs, ()))
    found = gather_information(own, np.zeros(len(own.free)), runs, part, 1)
    y = np.asarray(runs.drive.measured)
    spread = [
        y[..., o][s].var() if (s := np.asarray(runs.scored)[..., o]).any() else 1.0
        for o in range(runs.scored.shape[2])
    ]
    spread = np.maximum(spread, 1e-12)
    total = np.asarray(found.samples)[0] * spread
    power = np.einsum("opp->op", np.asarray(found.gram)[0])
    size = np.sqrt((power / np.maximum(total, 1e-300)[:, None]).max(axis=0))
    if not np.all(np.isfinite(size)):
        raise DataError(
            "the free run of the network diverges on the donors: train it on some of "
            "them first"
        )
    scale = 1.0 / np.where(size > 0, size, 1.0)
    scale = jnp.asarray(scale, own.start.dtype)
    return dataclasses.replace(own, scale=scale), spread
