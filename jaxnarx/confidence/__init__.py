"""How sure a model is: the domain of its data, prediction intervals, confidence bands,
standard errors of its parameters, and networks that it might as well have been.
"""

from jaxnarx.confidence._bands import Bands, bands
from jaxnarx.confidence._domain import DomainIndex, Excursion, domain
from jaxnarx.confidence._intervals import Intervals, intervals
from jaxnarx.confidence._jackknife import jackknife
from jaxnarx.confidence._uncertainty import Uncertainty, uncertainty
from jaxnarx.confidence.domain_fit import fit_domain
from jaxnarx.confidence.error_model import error_variables, fit_error_model
from jaxnarx.confidence.finalise import (
    apply_release_limits,
    attach_domain_and_intervals,
)

__all__ = [
    "Bands",
    "DomainIndex",
    "Excursion",
    "Intervals",
    "Uncertainty",
    "apply_release_limits",
    "attach_domain_and_intervals",
    "bands",
    "domain",
    "error_variables",
    "fit_domain",
    "fit_error_model",
    "intervals",
    "jackknife",
    "uncertainty",
]
