"""Validity functions, local models and the network that blends them."""

from jaxnarx.models.assemble import (
    assemble,
    global_model,
    local_models,
    output_model,
)
from jaxnarx.models.feedback import (
    collapse,
    collapsed_step,
    collapses,
    depth,
    fed_back,
    general_step,
    respond,
    with_history,
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
    "assemble",
    "collapse",
    "collapsed_step",
    "collapses",
    "depth",
    "fed_back",
    "general_step",
    "global_model",
    "load",
    "load_about",
    "local_models",
    "output_model",
    "respond",
    "save",
    "scheduling_values",
    "with_history",
]
