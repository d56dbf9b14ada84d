"""Stability of a network: poles, a contraction bound, and a penalty made of it."""

from jaxnarx.refinement._stability._certificate import (
    Certificate,
    attach_certificate,
    certificate,
    rate_of,
    stays_bounded,
)
from jaxnarx.refinement._stability._penalty import (
    Metric,
    find_metric,
    penalty,
    penalty_points,
    penalty_residuals,
)
from jaxnarx.refinement._stability.bound import Bound, Place
from jaxnarx.refinement._stability.check import Stability, stability
from jaxnarx.refinement._stability.points import Points
from jaxnarx.refinement._stability.poles import (
    Poles,
    first_horizon,
    largest_local_pole,
    slowest,
)

__all__ = [
    "Bound",
    "Certificate",
    "Metric",
    "Place",
    "Points",
    "Poles",
    "Stability",
    "certificate",
    "attach_certificate",
    "find_metric",
    "largest_local_pole",
    "first_horizon",
    "penalty",
    "penalty_points",
    "penalty_residuals",
    "rate_of",
    "slowest",
    "stability",
    "stays_bounded",
]
