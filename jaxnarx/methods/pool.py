"""Settings of the candidate terms."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from jaxnarx.errors import SpecError

Lags = Sequence[int] | Mapping[str, Sequence[int]]


@dataclasses.dataclass(frozen=True)
class Polynomial:
    """Candidate terms: all products of up to `degree` lagged variables.

    See `polynomial_pool`, which makes the pool for the channels of data.
    """

    outputs: Sequence[str] = ()
    """Outputs to model; default: all of the description."""
    input_lags: Lags = (0, 1, 2, 4, 8, 16)
    """Input lags in samples, for all inputs or by name, or none; `jaxnarx check`
    suggests some."""
    output_lags: Lags = (1, 2)
    """Output lags in samples, fed back in a free run; none: it cannot diverge."""
    filters: Sequence[Any] = ()
    """Time constants [s] of first-order lags; inputs enter through each of them too. In
    Python also other filters, such as `Laguerre`."""
    degree: int = 2
    """Largest number of factors of a term."""
    filter_lags: Sequence[int] = (0,)
    """Lags of the filtered inputs in samples."""

    def __post_init__(self):
        single = isinstance(self.outputs, str)
        outputs = (self.outputs,) if single else tuple(self.outputs)
        object.__setattr__(self, "outputs", tuple(dict.fromkeys(outputs)))
        for field in ("input_lags", "output_lags"):
            value = getattr(self, field)
            if not isinstance(value, Mapping):
                object.__setattr__(self, field, tuple(value))
        object.__setattr__(self, "filters", tuple(dict.fromkeys(self.filters)))
        object.__setattr__(self, "filter_lags", tuple(self.filter_lags))
        for value in self.filters:
            if isinstance(value, int | float) and not 0 < value < float("inf"):
                raise SpecError(
                    "filters must be positive time constants in seconds, got "
                    f"{' '.join(map(str, self.filters))}",
                    field="filters",
                )
        if not 1 <= self.degree <= 4:
            raise SpecError(f"degree must be 1 to 4, got {self.degree}", field="degree")
