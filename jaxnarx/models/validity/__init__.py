"""Validity functions: where each local model speaks."""

import dataclasses

from jaxnarx.errors import SpecError
from jaxnarx.extensions import Registry
from jaxnarx.models.validity.abstract import (
    CENTRE_ROOM,
    AbstractValidity,
    count_models,
    weights_of,
)
from jaxnarx.models.validity.additive_gates import AdditiveGates, tied_outputs
from jaxnarx.models.validity.boxes import Boxes
from jaxnarx.models.validity.compact import Compact
from jaxnarx.models.validity.gaussians import Gaussians
from jaxnarx.models.validity.log_sigmoids import LogSigmoids
from jaxnarx.models.validity.sigmoid_tree import GateProducts, SigmoidTree


def _require_arrays(name: str, kind: type[AbstractValidity]) -> None:
    """Model files hold arrays, and know a class by its own name."""
    if name != kind.__name__:
        raise SpecError(
            f"model files know a validity function by the name of its class, "
            f"{kind.__name__!r}, not {name!r}",
            field="name",
        )
    static = [f.name for f in dataclasses.fields(kind) if f.metadata.get("static")]
    if static:
        raise SpecError(
            f"{name}.{static[0]} is a static field, which model files do not hold; "
            "make it an array",
            field=static[0],
        )


VALIDITIES: Registry[type[AbstractValidity]] = Registry(
    "validity function",
    {
        kind.__name__: kind
        for kind in (
            *(Gaussians, Boxes, Compact, LogSigmoids, SigmoidTree),
            *(AdditiveGates, GateProducts),
        )
    },
    check=_require_arrays,
)
"""Every class by the name that model files use."""


def register_validity(kind: type[AbstractValidity]) -> type[AbstractValidity]:
    """Let model files hold validity functions of your own class; use as a decorator.

    Files know classes by name alone and load no code: the program that reads one must
    have registered the class before, or an installed package does
    (`jaxnarx.extensions`). All fields must be arrays. A class of your own may be
    registered anew, under a name that no other class has. An example for the contract
    goes to `VALIDITIES.register(name, kind, example=...)`.
    """
    return VALIDITIES.register(kind.__name__, kind)


__all__ = [
    "CENTRE_ROOM",
    "AbstractValidity",
    "AdditiveGates",
    "Boxes",
    "Compact",
    "GateProducts",
    "Gaussians",
    "LogSigmoids",
    "SigmoidTree",
    "VALIDITIES",
    "count_models",
    "register_validity",
    "tied_outputs",
    "weights_of",
]
