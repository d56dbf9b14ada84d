"""Stability of a network: poles, a contraction bound, and a penalty made of it."""

from jaxnarx.refinement.stability.bound import Bound, Place
from jaxnarx.refinement.stability.check import Stability, stability
from jaxnarx.refinement.stability.penalty import (
    Metric,
    find_metric,
    penalty,
    penalty_points,
    penalty_residuals,
)
from jaxnarx.refinement.stability.points import Points
from jaxnarx.refinement.stability.poles import Poles, first_horizon, slowest

__all__ = [
    "Bound",
    "Metric",
    "Place",
    "Points",
    "Poles",
    "Stability",
    "find_metric",
    "first_horizon",
    "penalty",
    "penalty_points",
    "penalty_residuals",
    "slowest",
    "stability",
]
