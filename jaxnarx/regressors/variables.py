"""Lagged variables: rows (signal, lag) into the signal table of a dataset."""

import dataclasses
from collections.abc import Collection, Iterator

import numpy as np

from jaxnarx.errors import SpecError
from jaxnarx.regressors.filters import AbstractFilter, require_filter

Entry = tuple[int, int, AbstractFilter | None]
"""Signal, lag [samples], and the filter the signal passes before it is shifted."""


@dataclasses.dataclass(frozen=True)
class Variables:
    """Lagged variables x_1 ... x_V; row v is (signal, lag in samples).

    The signal table is inputs, then outputs, in the order of the channels. The table is
    static, unlike the terms: which variables are fed back is part of the program of the
    time loop, and knowing it while tracing lets that loop hold nothing but constants.

    `filters` is empty, or has an entry for every row: None, or the filter its signal
    passes first. Only signals that are measured in every use can be filtered, that is
    inputs and outputs that are not modelled. A filtered variable has the unit and the
    gain of its signal and is valid where its signal is at that lag.
    """

    rows: tuple[tuple[int, int], ...]
    filters: tuple[AbstractFilter | None, ...] = ()

    def __post_init__(self):
        for filter_ in self.filters:
            if filter_ is not None:
                require_filter(filter_)
        if self.filters and len(self.filters) != len(self.rows):
            raise SpecError(
                f"filters must be none or one per variable, got {len(self.filters)} "
                f"for {len(self.rows)} variables",
                field="filters",
            )
        if all(f is None for f in self.filters):
            object.__setattr__(self, "filters", ())

    @classmethod
    def of(cls, entries: Collection[Entry]) -> "Variables":
        """The table of these (signal, lag, filter)."""
        return cls(tuple((s, d) for s, d, _ in entries), tuple(f for *_, f in entries))

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[tuple[int, int]]:
        return iter(self.rows)

    @property
    def entries(self) -> tuple[Entry, ...]:
        """(signal, lag, filter or None) of every variable."""
        filters = self.filters or (None,) * len(self.rows)
        return tuple((s, d, f) for (s, d), f in zip(self.rows, filters, strict=True))

    @property
    def filtered(self) -> tuple[tuple[int, AbstractFilter], ...]:
        """Every (signal, filter) in use, once."""
        pairs = [(s, f) for s, _, f in self.entries if f is not None]
        return tuple(dict.fromkeys(pairs))

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

    @property
    def slowest(self) -> float:
        """Time constant [s] of the slowest filter; zero without any."""
        filters = [f for *_, f in self.entries if f is not None]
        return max((1 / -p.real for f in filters for p in f.sections), default=0.0)

    def require_measured(self, modelled: Collection[int], names: list[str]) -> None:
        """SpecError if a signal among `modelled` is filtered: it is not known before
        the run."""
        for signal, _ in self.filtered:
            if signal in modelled:
                raise SpecError(
                    f"{names[signal]} is computed by the model and cannot be filtered; "
                    "filters are for inputs and for outputs that are not modelled",
                    field="filters",
                )
