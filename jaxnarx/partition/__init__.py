"""How the operating space is divided among local models."""

from jaxnarx.partition.ground import Ground, make_ground
from jaxnarx.partition.grow import grow
from jaxnarx.partition.local_fit import local_fit
from jaxnarx.partition.lolimot import lolimot, validity_of_boxes
from jaxnarx.partition.scaffold import scheduling_table
from jaxnarx.partition.switching import switch
from jaxnarx.partition.tree import sigmoid_tree, validity_of_stage

__all__ = [
    "Ground",
    "grow",
    "local_fit",
    "lolimot",
    "make_ground",
    "scheduling_table",
    "sigmoid_tree",
    "switch",
    "validity_of_boxes",
    "validity_of_stage",
]
