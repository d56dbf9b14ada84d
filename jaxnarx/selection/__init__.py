"""Choice of terms from a pool."""

from jaxnarx.selection.frequency import SelectionFrequency, selection_frequency
from jaxnarx.selection.many import select_each, select_weighted
from jaxnarx.selection.select_terms import select
from jaxnarx.selection.selection import Selection
from jaxnarx.selection.sizes import choose, criteria_of, errors_along
from jaxnarx.selection.table import coefficient_table

__all__ = [
    "Selection",
    "SelectionFrequency",
    "choose",
    "coefficient_table",
    "criteria_of",
    "errors_along",
    "select",
    "select_each",
    "select_weighted",
    "selection_frequency",
]
