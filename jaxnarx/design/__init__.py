"""Optimal adjustment of an excitation plan through a model.

An experiment is worth what it tells about the parameters. With S_t the derivative of
the outputs at t by the parameters, in standard deviations of the noise, its information
matrix is

    M = sum_t S_t' S_t ,

and M^-1 bounds the covariance of any unbiased estimate (Cramer and Rao). `adjust` moves
the levels of an APRBS plan so that a criterion of M improves, by gradient through the
model, within the plan's own range and rate limits.

`plan` makes the next test of a network from nothing but the network: stretch by
stretch, what tells most about its free run and about what it cannot express yet, within
ranges, rates, forbidden combinations and limits of outputs.

Reference: R. K. Mehra, IEEE Trans. Automatic Control 19, 1974; thesis section 6.2.1.
"""

from jaxnarx.design._adjust import adjust
from jaxnarx.design._criteria import Criteria, criteria
from jaxnarx.design._plan import TestPlan, plan
from jaxnarx.design._plan import plan_by as plan_by
from jaxnarx.design.greedy import asked_samples as asked_samples
from jaxnarx.design.limits import limits_for as limits_for
from jaxnarx.design.sensitivity import (
    AbstractSensitivity,
    NetworkSensitivity,
    ResponseSensitivity,
    network_sensitivity,
)
from jaxnarx.design.sensitivity import rest_run as rest_run
from jaxnarx.design.views import make_view as make_view
from jaxnarx.docstrings import document
from jaxnarx.settings import OptimalDesign

__all__ = [
    "AbstractSensitivity",
    "Criteria",
    "NetworkSensitivity",
    "OptimalDesign",
    "ResponseSensitivity",
    "TestPlan",
    "adjust",
    "criteria",
    "network_sensitivity",
    "plan",
]

document(OptimalDesign)
