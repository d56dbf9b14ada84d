"""Validity functions, local models and the network that blends them."""

from jaxnarx.models.assemble import assemble, global_model, output_model
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
from jaxnarx.models.validity import AbstractValidity, Gaussians

__all__ = [
    "AbstractValidity",
    "Gaussians",
    "LocalModels",
    "Network",
    "OutputModel",
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
    "output_model",
    "respond",
    "save",
    "scheduling_values",
    "with_history",
]
