"""Validity functions, local models and the network that blends them."""

from jaxnarx.models.assemble import (
    assemble,
    global_model,
    local_models,
    output_model,
)
from jaxnarx.models.feedback import (
    advance,
    collapse,
    collapsed_step,
    collapses,
    depth,
    fed_back,
    folded,
    general_step,
    places,
    respond,
    sources,
    widened,
    with_history,
    with_own,
)
from jaxnarx.models.network import LocalModels, Network, OutputModel, scheduling_values
from jaxnarx.models.storage import load, load_about, save
from jaxnarx.models.validity import (
    AbstractValidity,
    Boxes,
    Compact,
    Gaussians,
    LogSigmoids,
    SigmoidTree,
)

__all__ = [
    "AbstractValidity",
    "Boxes",
    "Compact",
    "Gaussians",
    "LocalModels",
    "LogSigmoids",
    "Network",
    "OutputModel",
    "SigmoidTree",
    "advance",
    "assemble",
    "collapse",
    "collapsed_step",
    "collapses",
    "depth",
    "fed_back",
    "folded",
    "general_step",
    "global_model",
    "load",
    "load_about",
    "local_models",
    "output_model",
    "places",
    "respond",
    "save",
    "scheduling_values",
    "sources",
    "widened",
    "with_history",
    "with_own",
]
