"""Lagged variables: rows (signal, lag) into the signal table of a dataset."""

import dataclasses
from collections.abc import Iterator

import numpy as np


@dataclasses.dataclass(frozen=True)
class Variables:
    """Lagged variables x_1 ... x_V; row v is (signal, lag in samples).

    The signal table is inputs, then outputs, in the order of the channels. The table is
    static, unlike the terms: which variables are fed back is part of the program of the
    time loop, and knowing it while tracing lets that loop hold nothing but constants.
    """

    rows: tuple[tuple[int, int], ...]

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[tuple[int, int]]:
        return iter(self.rows)

    @property
    def signal(self) -> np.ndarray:
        """Signal of each variable, integers."""
        return np.array([s for s, _ in self.rows], dtype=np.int64)

    @property
    def lag(self) -> np.ndarray:
        """Lag of each variable [samples]."""
        return np.array([d for _, d in self.rows], dtype=np.int64)

    @property
    def longest(self) -> int:
        """Largest lag; 0 without variables."""
        return max((d for _, d in self.rows), default=0)
