"""Choice of terms from a pool."""

from jaxnarx.selection.frequency import SelectionFrequency, selection_frequency
from jaxnarx.selection.many import select_each, select_weighted
from jaxnarx.selection.path import path_of
from jaxnarx.selection.search import Program, make_lanes, search
from jaxnarx.selection.select_terms import select
from jaxnarx.selection.selection import Selection
from jaxnarx.selection.sizes import choose, criteria_of, errors_along
from jaxnarx.selection.table import coefficient_table
from jaxnarx.selection.unusable import unusable_signals

__all__ = [
    "Program",
    "Selection",
    "SelectionFrequency",
    "choose",
    "coefficient_table",
    "criteria_of",
    "errors_along",
    "make_lanes",
    "path_of",
    "search",
    "select",
    "select_each",
    "select_weighted",
    "selection_frequency",
    "unusable_signals",
]
