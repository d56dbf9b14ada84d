"""Scheduling variables between physical units and what validity functions see."""

import numpy as np
from jaxtyping import Array, Float

from jaxnarx.models.network import OutputModel
from jaxnarx.models.validity import weights_of


def scheduling_values(
    model: OutputModel, x: Float[Array, "dims *rows"]
) -> Float[Array, "dims *rows"]:
    """Min-max scaled scheduling variables from physical ones."""
    tail = (1,) * (x.ndim - 1)
    return (x - model.offset.reshape(-1, *tail)) / model.span.reshape(-1, *tail)


def weights_at(
    model: OutputModel, x: Float[np.ndarray, "points dims"]
) -> Float[np.ndarray, "models points"]:
    """The active local models' weights at points in physical units, on the host."""
    active = np.asarray(model.active)
    return weights_of(model.validity, scaled_points(model, x).T, active)[active]


def scaled_points(
    model: OutputModel, x: Float[np.ndarray, "points dims"]
) -> Float[np.ndarray, "points dims"]:
    """Scale points of scheduling variables on the host, in float64; see
    `scheduling_values`."""
    offset, span = np.asarray(model.offset, float), np.asarray(model.span, float)
    return (x - offset[None]) / span[None]
