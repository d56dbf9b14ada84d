"""Choice of terms from a pool."""

from jaxnarx.selection.select_terms import select
from jaxnarx.selection.selection import Selection

__all__ = ["Selection", "select"]
