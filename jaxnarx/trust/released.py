"""What identification gives its model at the end: domain, certificate, and limits."""

import dataclasses

import jax
import numpy as np
from jaxtyping import Float

from jaxnarx.data import Dataset, Groups
from jaxnarx.errors import JaxnarxError
from jaxnarx.models import FLAG, LINEAR, Network, hold_to_range
from jaxnarx.refinement import certified
from jaxnarx.trust.errors import learn_errors
from jaxnarx.trust.learn import learn_domain

WIDE = 100.0
"""Bounds of the feedback of a network with a certificate, in widths of the range."""


def knowing(
    network: Network,
    data: Dataset,
    groups: Groups | None = None,
    left_out: Float[np.ndarray, "outputs groups"] | None = None,
    apart: Dataset | None = None,
) -> Network:
    """The network with its domain, where it has inputs and the records can be run, with
    its certificate, where there is one, and with prediction intervals, where the errors
    of groups left out are known, or there are records apart from the training."""
    network = certified(network)
    try:
        network = learn_domain(network, data, groups=groups)
    except JaxnarxError:
        return network
    if apart is not None:
        return learn_errors(network, apart)
    if left_out is None:
        return network
    return learn_errors(network, data, groups=groups, left_out=left_out)


def released(network: Network) -> Network:
    """The network with limits that let it follow inputs beyond their ranges.

    What is stable for every input needs no bound of its feedback: the bounds of a
    network with a certificate are wide, and inputs are taken as they are where it holds
    for such inputs too. Others go on from the edge of their ranges to first order. On
    virtual engines driven up to 2.5 times the trained ranges plain inputs had the
    smallest error on most outputs, and held ones the largest (`experiments/edge`).
    """
    margin = None if network.hold is None else float(network.hold)
    for outside in (FLAG, LINEAR):
        network = certified(hold_to_range(network, margin, outside=outside))
        if network.certificate is not None:
            break
    else:
        return network
    own = list(network.signals)
    ranges = network.low, network.high, network.gain
    low, high, gain = (np.asarray(a)[own] for a in ranges)
    wide = WIDE * (high - low)
    lower = np.minimum((low - wide) / gain, np.asarray(network.lower))
    upper = np.maximum((high + wide) / gain, np.asarray(network.upper))
    lower, upper = jax.device_put((lower, upper))
    return dataclasses.replace(network, lower=lower, upper=upper)
