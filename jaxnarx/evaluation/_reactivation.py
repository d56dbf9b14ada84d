"""Validity that comes back where it is not wanted."""

from typing import Any

import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.data import Dataset
from jaxnarx.evaluation.regions import scheduling_cloud
from jaxnarx.models import (
    AbstractValidity,
    Gaussians,
    Network,
    scaled_points,
    weights_of,
)
from jaxnarx.regressors import variable_names

NOTICEABLE_REACTIVATION = 0.05
"""Reactivation that a report mentions."""


def reactivation(
    validity: AbstractValidity,
    active: Bool[Array, " models"] | Bool[np.ndarray, " models"],
    z: Float[np.ndarray, "points dims"],
) -> Float[np.ndarray, " models"]:
    """The weight that each local model gets back behind another one; 0 is none.

        r_m = max over j, z of  phi_m(z) - phi_m(c_j) / (phi_m(c_j) + phi_j(c_j)) ,

    at least 0, over other active models j and those points z that lie farther along
    than their centre, sum_d (z - c_j)_d (c_j - c_m)_d / s_md^2 > 0: nearer to c_j than
    to c_m. That is the weight at z less what m has of the two at c_j. Normalised
    Gaussians of one common width never gain (their quotients fall monotonically), those
    of unequal width do, up to 1. Every other class gives 0: the weights of trees and
    log-sigmoids have one hill along any line, boxes and compact curves end.

    `z` are scaled points, as they occur in the data. R. Shorten and R. Murray-Smith,
    "Side effects of normalising radial basis function networks", 1996; O. Nelles,
    "Nonlinear System Identification", on normalised Gaussians.
    """
    if not isinstance(validity, Gaussians) or not len(z):
        return np.zeros(len(active))
    return _rise(validity, np.asarray(active), z).max(axis=(1, 2), initial=0.0)


def _rise(
    validity: Gaussians,
    active: Bool[np.ndarray, " models"],
    z: Float[np.ndarray, "points dims"],
) -> Float[np.ndarray, "models models points"]:
    """The weight of model m at each point behind model j, less its share at c_j; else
    0."""
    centre = np.asarray(validity.centre, float)
    weight = np.exp(-2 * np.asarray(validity.log_width, float))
    # All points in one call: compilation is what it costs.
    phi = weights_of(validity, np.concatenate([z, centre]).T, active)
    there, at_centres = phi[:, : len(z)], phi[:, len(z) :]
    own = np.diagonal(at_centres)
    pair = at_centres + own[None]
    share = at_centres / np.where(pair > 0, pair, 1.0)
    step = centre[None] - centre[:, None]
    along = np.einsum("jmd,md,pd->mjp", -step, weight, z)
    edge = np.einsum("mjd,md,jd->mj", step, weight, centre)
    both = active[:, None] & active[None] & ~np.eye(len(active), dtype=bool)
    behind = (along > edge[..., None]) & both[..., None]
    return np.where(behind, np.maximum(there[:, None] - share[..., None], 0.0), 0.0)


def reactivation_notes(network: Any, data: Dataset) -> list[str]:
    """A sentence for every output whose data meet reactivation above 5 %."""
    if not isinstance(network, Network):
        return []
    notes = []
    for name, model in zip(network.computed_names, network.models, strict=True):
        validity, active = model.validity, np.asarray(model.active)
        if not isinstance(validity, Gaussians) or active.sum() < 2:
            continue
        if not network.tells(model.scheduling):
            continue
        x = scheduling_cloud(data, model.scheduling)
        rise = _rise(validity, active, scaled_points(model, x))
        if rise.size and rise.max() > NOTICEABLE_REACTIVATION:
            m, j, p = np.unravel_index(rise.argmax(), rise.shape)
            variables = variable_names(network.channels, model.scheduling)
            place = ", ".join(
                f"{v} = {value:.4g}" for v, value in zip(variables, x[p], strict=True)
            )
            notes.append(
                f"{name}: local model {m + 1} is valid again behind model {j + 1}, by "
                f"{rise.max():.2f} at {place}. Gaussians of unequal width do so; equal "
                "or smaller widths, a sigmoid tree or compact curves do not."
            )
    return notes
