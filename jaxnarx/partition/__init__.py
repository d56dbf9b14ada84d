"""How the operating space is divided among local models."""

from typing import TYPE_CHECKING

from jaxnarx.deprecation import find_old as _find_old
from jaxnarx.partition._grow import grow
from jaxnarx.partition._lolimot import lolimot, validity_of_boxes
from jaxnarx.partition.closed_form.model import ClosedForm as ClosedForm
from jaxnarx.partition.closed_form.model import ClosedStructure as ClosedStructure
from jaxnarx.partition.closed_form.profile import DataProfile as DataProfile
from jaxnarx.partition.closed_form.profile import profile_data as profile_data
from jaxnarx.partition.closed_form.rest import rest_points as rest_points
from jaxnarx.partition.closed_form.search import OF_ROOT as OF_ROOT
from jaxnarx.partition.closed_form.search import ClosedSearch as ClosedSearch
from jaxnarx.partition.closed_form.sums import Errors as Errors
from jaxnarx.partition.closed_form.sums import Sum as Sum
from jaxnarx.partition.closed_form.sums import Summand as Summand
from jaxnarx.partition.closed_form.sums import align_errors as align_errors
from jaxnarx.partition.closed_form.sums import best_sum as best_sum
from jaxnarx.partition.clusters import place, scatter_partition
from jaxnarx.partition.local_fit import fit_models
from jaxnarx.partition.scaffold import scheduling_table
from jaxnarx.partition.stages import best_stage
from jaxnarx.partition.switching import switch
from jaxnarx.partition.training_rows import (
    TrainingRows,
    make_training_rows,
    scheduling_ranges,
)
from jaxnarx.partition.tree import sigmoid_tree, validity_of_stage

__all__ = [
    "TrainingRows",
    "best_stage",
    "fit_models",
    "grow",
    "lolimot",
    "make_training_rows",
    "place",
    "scatter_partition",
    "scheduling_ranges",
    "scheduling_table",
    "sigmoid_tree",
    "switch",
    "validity_of_boxes",
    "validity_of_stage",
]

if not TYPE_CHECKING:

    def __getattr__(name):
        return _find_old(__name__, name, {"scattered": "scatter_partition"})
