"""The last step of identification: domain, certificate and limits of the model."""

import numpy as np
from jaxtyping import Float

from jaxnarx.confidence.domain_fit import fit_domain
from jaxnarx.confidence.error_model import fit_error_model
from jaxnarx.data import Dataset, Groups
from jaxnarx.errors import JaxnarxError
from jaxnarx.models import FLAG, LINEAR, Network, hold_to_range, set_bounds
from jaxnarx.refinement import attach_certificate, stays_bounded

CERTIFIED_BOUND_WIDTHS = 1e6
"""Bounds of the feedback of a network whose runs are proven bounded, in widths of the
range: such a network runs away from nothing, however far its polynomials reach where
inputs come together as they never did (100 widths and more on a measured engine)."""


def attach_domain_and_intervals(
    network: Network,
    data: Dataset,
    groups: Groups | None = None,
    left_out: Float[np.ndarray, "outputs groups"] | None = None,
    apart: Dataset | None = None,
) -> Network:
    """The network with its domain, where it has inputs and the records can be run, with
    its certificate, where there is one, and with prediction intervals, where the errors
    of groups left out are known, or there are records apart from the training."""
    network = attach_certificate(network)
    try:
        network = fit_domain(network, data, groups=groups)
    except JaxnarxError:
        return network
    if apart is not None:
        return fit_error_model(network, apart)
    if left_out is None:
        return network
    return fit_error_model(network, data, groups=groups, left_out=left_out)


def _needs_no_limits(network: Network) -> bool:
    """Whether its runs are bounded by themselves: not by states that saturate."""
    return stays_bounded(network) and not np.asarray(network.saturates).any()


def apply_release_limits(network: Network) -> Network:
    """The network with limits that let it follow inputs beyond their ranges.

    A model whose runs are proven to stay bounded for every input needs no bound of its
    feedback: the bounds of such a network, with a certificate or with sigmoid gates
    beside a stable linear model, are wide, and inputs are taken as they are where the
    proof holds for such inputs too. Others go on from the edge of their ranges to first
    order. On virtual engines driven up to 2.5 times the trained ranges plain inputs had
    the smallest error on most outputs, and held ones the largest (`experiments/edge`).
    """
    margin = None if network.hold is None else float(network.hold)
    for outside in (FLAG, LINEAR):
        network = attach_certificate(hold_to_range(network, margin, outside=outside))
        if network.certificate is not None or _needs_no_limits(network):
            break
    else:
        return network
    return set_bounds(network, CERTIFIED_BOUND_WIDTHS)
