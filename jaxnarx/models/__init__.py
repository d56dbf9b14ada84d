"""Validity functions, local models and the network that blends them."""

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
    "collapse",
    "collapsed_step",
    "collapses",
    "depth",
    "fed_back",
    "general_step",
    "load",
    "load_about",
    "respond",
    "save",
    "scheduling_values",
    "with_history",
]
