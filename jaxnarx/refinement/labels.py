"""Trained parameters as people read them: names, values and units of the signals."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.models import Gaussians, Network, OutputModel
from jaxnarx.refinement.layout import Layout
from jaxnarx.regressors import term_name, variable_names


@dataclasses.dataclass(frozen=True, eq=False)
class Labels:
    """Every entry of a layout's vector, padding included.

    `value` are the parameters as `Network.equations` shows them, `slope` their
    derivatives by the network's own; `output` is the position of the output an entry
    belongs to; `real` is False for padding.
    """

    names: tuple[str, ...]
    value: Float[np.ndarray, " params"]
    slope: Float[np.ndarray, " params"]
    output: Float[np.ndarray, " params"]
    real: Bool[np.ndarray, " params"]


Entries = tuple[list[str], np.ndarray, np.ndarray, np.ndarray]


def label(network: Network, layout: Layout) -> Labels:
    """Labels of the trained parameters of `network`, in the order of the layout."""
    names, value, slope, output, real = [], [], [], [], []
    for o, (model, keep) in enumerate(zip(network.models, layout.chosen, strict=True)):
        leaves = [_coefficients(network, o), *_validity(network, o, model)]
        for entries, trained in zip(leaves, keep, strict=True):
            if trained:
                names += entries[0]
                value.append(entries[1].reshape(-1))
                slope.append(entries[2].reshape(-1))
                real.append(entries[3].reshape(-1))
                output.append(np.full(len(entries[0]), float(o)))
    parts = [np.concatenate(p) for p in (value, slope, output, real)]
    return Labels(tuple(names), *parts)


def _coefficients(network: Network, o: int) -> Entries:
    """Coefficients of one output; physical units, as `Network.equations` has them."""
    model = network.models[o]
    factor = np.asarray(model.local.factor)[np.asarray(model.local.index)]
    gain = np.asarray(network.gain)
    scale = np.concatenate([[1.0], gain[[s for s, _ in network.variables]]])
    slope = gain[network.signals[o]] / np.prod(scale[factor], axis=2)
    known, output = network.variable_names, network.computed_names[o]
    names = [
        f"{output}: model {m + 1}: {term_name(known, row)}"
        for m, rows in enumerate(factor.tolist())
        for row in rows
    ]
    real = np.asarray(model.local.used) & np.asarray(model.active)[:, None]
    return names, np.asarray(model.local.coefficient) * slope, slope, real


def _validity(network: Network, o: int, model: OutputModel) -> list[Entries]:
    if not isinstance(model.validity, Gaussians):
        return _validity_entries(network.computed_names[o], model)
    span, offset = np.asarray(model.span)[None], np.asarray(model.offset)[None]
    centre = np.asarray(model.validity.centre)
    width = np.exp(np.asarray(model.validity.log_width)) * span
    real = np.broadcast_to(np.asarray(model.active)[:, None], centre.shape)
    known = variable_names(network.channels, model.scheduling)

    def names(kind: str) -> list[str]:
        stem = f"{network.computed_names[o]}: {kind} of model"
        return [f"{stem} {m + 1} in {n}" for m in range(len(centre)) for n in known]

    there = np.broadcast_to(span, centre.shape)
    return [
        (names("centre"), centre * span + offset, there, real),
        (names("width"), width, width, real),
    ]


def _validity_entries(output: str, model: OutputModel) -> list[Entries]:
    """Parameters of other validity functions, as they are inside the network."""
    found = []
    validity = model.validity
    for field, leaf in zip(validity.trained, validity.parameters, strict=True):
        value = np.asarray(leaf, float)
        stem = f"{output}: {field}"
        names = [f"{stem}{list(map(int, at))}" for at in np.ndindex(value.shape)]
        everywhere = np.ones(value.shape, bool)
        found.append((names, value, np.ones(value.shape), everywhere))
    return found
