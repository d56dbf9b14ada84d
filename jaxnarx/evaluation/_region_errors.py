"""Share of each local model in the error of the free run."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from jaxnarx.data import Batch, Dataset
from jaxnarx.evaluation.rows import ScoredSamples
from jaxnarx.models import Network, scaled_points, weights_of
from jaxnarx.regressors import row_columns
from jaxnarx.simulation import Prepared, stack_batch

EXAMINED_SAMPLES = 4096
"""Samples looked at, evenly spaced; always as many, so that one program serves."""
UNEVEN_ERROR_FACTOR = 1.5
"""Share of the error over the share of samples from which a region is pointed at."""


@dataclasses.dataclass(frozen=True)
class RegionError:
    """A local model's part in the free-run error: samples at which it leads.

    `model` counts from 1 and `region` tells where that is; `samples` is the share of
    the samples, `error` that of the squared error, `rmse` in the unit of the output.
    """

    output: str
    model: int
    region: str
    samples: float
    error: float
    rmse: float | None


def region_errors(
    network: Any, data: Dataset | Prepared, free: list[list[ScoredSamples]]
) -> tuple[RegionError, ...]:
    """The part of every local model, the largest error first, by output.

    `free` is the free run on `data`; records that diverged are left out, and so are
    outputs with a single local model, or with regions of hidden channels.
    """
    if not isinstance(network, Network):
        return ()
    (_, batch), found = stack_batch(network, data), []
    length = batch.valid.shape[1]
    for o, samples in enumerate(free):
        calm = [(n, one) for n, one in enumerate(samples) if not one.diverged]
        if not calm:
            continue
        at = [n * length + np.flatnonzero(one.scored[:, 0]) for n, one in calm]
        error = [(one.measured - one.predicted)[one.scored] for _, one in calm]
        at, error = np.concatenate(at), np.concatenate(error)
        if not len(at):
            continue
        step = max(1, -(-len(at) // EXAMINED_SAMPLES))
        at, error = at[::step], error[::step]
        lead = leading_models(network, batch, o, at)
        if lead is not None:
            found += _shares(network, o, lead, error)
    return tuple(found)


def _has_regions(network: Network, output: int) -> bool:
    """Whether it has several regions, told by what is measured."""
    model = network.models[output]
    several = len(model.scheduling) > 0 and np.asarray(model.active).sum() > 1
    return bool(several and network.tells(model.scheduling))


def leading_models(
    network: Network, batch: Batch, output: int, at: Int[np.ndarray, " points"]
) -> Int[np.ndarray, " points"] | None:
    """The local model of the largest weight at up to 4,096 rows of a batch; None where
    an output has one alone, or regions of hidden channels."""
    if not _has_regions(network, output):
        return None
    model = network.models[output]
    x = row_columns(batch, at, model.scheduling, float(network.sample_time))
    x = x.T.astype(float)
    padded = np.concatenate([x, np.repeat(x[:1], EXAMINED_SAMPLES - len(x), axis=0)])
    active = np.asarray(model.active)
    phi = weights_of(model.validity, scaled_points(model, padded).T, active)
    return np.where(active[:, None], phi, -1.0)[:, : len(x)].argmax(axis=0)


def _shares(
    network: Network,
    o: int,
    lead: Int[np.ndarray, " points"],
    error: Float[np.ndarray, " points"],
) -> list[RegionError]:
    unit = float(np.abs(error).max()) or 1.0
    square = np.bincount(lead, (error / unit) ** 2, len(network.models[o].active))
    count = np.bincount(lead, minlength=len(square))
    regions, all_of_it = network.regions(o), float(square.sum()) or 1.0
    return [
        RegionError(
            output=network.output_names[o],
            model=int(m) + 1,
            region=region_text(regions[m]),
            samples=float(count[m] / count.sum()),
            error=float(square[m] / all_of_it),
            rmse=unit * float(np.sqrt(square[m] / count[m])) if count[m] else None,
        )
        for m in np.argsort(-square, kind="stable").tolist()
        if np.asarray(network.models[o].active)[m]
    ]


def region_text(region: Mapping[str, Mapping[str, float]]) -> str:
    """`speed[t] above 2000, load[t] 10 to 30`."""
    told = []
    for name, bounds in region.items():
        low, high = bounds.get("above"), bounds.get("below")
        if "centre" in bounds:
            width = bounds.get("width")
            more = f" ± {width:.3g}" if width is not None else ""
            told.append(f"{name} near {bounds['centre']:.4g}{more}")
        elif low is not None and high is not None:
            told.append(f"{name} {low:.4g} to {high:.4g}")
        elif low is not None or high is not None:
            side, level = ("above", low) if high is None else ("below", high)
            told.append(f"{name} {side} {level:.4g}")
    return ", ".join(told) or "everywhere"


def region_sentence(errors: tuple[RegionError, ...], output: str, part: str) -> str:
    """The region that carries the error of an output, in words; empty where there are
    none."""
    own = [one for one in errors if one.output == output]
    if not own:
        return ""
    one = own[0]
    if one.error < UNEVEN_ERROR_FACTOR * one.samples:
        return f"The error on {part} is spread over the regions as the samples are."
    return (
        f"Region {one.model} ({one.region}) carries {one.error:.0%} of the squared "
        f"free-run error on {part} with {one.samples:.0%} of the samples: data there "
        "would help."
    )
