"""Settings of the candidate terms."""

from collections.abc import Hashable, Mapping, Sequence
from typing import Annotated, Any

from jaxnarx.checks import require
from jaxnarx.settings.fields import Rule, settings

Lags = Sequence[int] | Mapping[str, Sequence[int]]
Degree = Annotated[int, Rule("be 1 to 4", lambda n: 1 <= n <= 4)]


@settings
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
    degree: Degree = 2
    """Largest number of factors of a term."""
    filter_lags: Sequence[int] = (0,)
    """Lags of the filtered inputs in samples."""

    def __post_init__(self):
        for field in ("outputs", "filters"):
            given = getattr(self, field)
            require(
                all(isinstance(each, Hashable) for each in given),
                field,
                f"{field} must be one after the other, got {given!r}",
            )
            once = tuple(dict.fromkeys(given))
            object.__setattr__(self, field, once)
        times = [f for f in self.filters if isinstance(f, int | float)]
        require(
            all(0 < time < float("inf") for time in times),
            "filters",
            "filters must be positive time constants in seconds, got "
            f"{' '.join(map(str, self.filters))}",
        )
