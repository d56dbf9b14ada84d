"""Choice of terms from a pool."""

from jaxnarx.selection._search import Program, make_lanes, search
from jaxnarx.selection.custom_selector import require_room as require_room
from jaxnarx.selection.path import path_of
from jaxnarx.selection.select_terms import choose_terms as choose_terms
from jaxnarx.selection.select_terms import select
from jaxnarx.selection.selection import Selection
from jaxnarx.selection.sizes import choose, criteria_of, errors_along
from jaxnarx.selection.table import coefficient_lines as coefficient_lines
from jaxnarx.selection.table import coefficient_table
from jaxnarx.selection.unusable import unusable_signals
from jaxnarx.selection.unusable import usable_terms as usable_terms

__all__ = [
    "Program",
    "Selection",
    "choose",
    "coefficient_table",
    "criteria_of",
    "errors_along",
    "make_lanes",
    "path_of",
    "search",
    "select",
    "unusable_signals",
]
