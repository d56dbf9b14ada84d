"""The work of a sweep, seen from its folder: members by number, rows out."""

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable


@runtime_checkable
class Work(Protocol):
    """A list of members and how to compute them; it must survive pickling.

    The run folder, the processes and the cluster use a sweep only through these
    methods.
    """

    @property
    def members(self) -> list[dict[str, Any]]:
        """One flat dictionary of labels per member, JSON scalars, in a fixed order."""
        ...

    def describe(self) -> dict[str, Any]:
        """Settings, digests of data and seeds: what a resumed sweep must agree in."""
        ...

    def run(self, indices: Sequence[int]) -> list[dict[str, Any]]:
        """One row per index: scalars, strings and lists, the same keys in all rows.

        Every row has a `"status"`, a name of `RESULTS`.
        """
        ...
