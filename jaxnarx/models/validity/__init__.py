"""Validity functions: where each local model speaks."""

import dataclasses

from jaxnarx.errors import SpecError
from jaxnarx.models.validity.abstract import EDGE, AbstractValidity, weights_of
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


def register_validity(kind: type[AbstractValidity]) -> type[AbstractValidity]:
    """Let model files hold validity functions of your own class; use as a decorator.

    Files know classes by name alone and load no code: the program that reads one must
    have registered the class before. All fields must be arrays. A class of your own may
    be registered anew, under a name that no other class has.
    """
    name = kind.__name__
    there = KINDS.get(name, kind)
    if (there.__module__, there.__qualname__) != (kind.__module__, kind.__qualname__):
        raise SpecError(
            f"validity functions of another class are called {name!r} already "
            f"({there.__module__}); give yours another name",
            field="kind",
        )
    static = [f.name for f in dataclasses.fields(kind) if f.metadata.get("static")]
    if static:
        raise SpecError(
            f"{name}.{static[0]} is a static field, which model files do not hold; "
            "make it an array",
            field=static[0],
        )
    KINDS[name] = kind
    return kind


__all__ = [
    "EDGE",
    "KINDS",
    "AbstractValidity",
    "Boxes",
    "Compact",
    "Gaussians",
    "LogSigmoids",
    "SigmoidTree",
    "register_validity",
    "weights_of",
]
