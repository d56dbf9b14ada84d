"""Validity functions: where each local model speaks."""

from jaxnarx.models.validity.abstract import EDGE, AbstractValidity
from jaxnarx.models.validity.boxes import Boxes
from jaxnarx.models.validity.compact import Compact
from jaxnarx.models.validity.gaussians import Gaussians
from jaxnarx.models.validity.log_sigmoids import LogSigmoids
from jaxnarx.models.validity.sigmoid_tree import SigmoidTree

KINDS: dict[str, type[AbstractValidity]] = {
    kind.__name__: kind
    for kind in (Gaussians, Boxes, Compact, LogSigmoids, SigmoidTree)
}
"""Every class by the name that model files use."""

__all__ = [
    "EDGE",
    "KINDS",
    "AbstractValidity",
    "Boxes",
    "Compact",
    "Gaussians",
    "LogSigmoids",
    "SigmoidTree",
]
