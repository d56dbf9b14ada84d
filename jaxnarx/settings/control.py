"""Settings of a predictive controller: what it sets, and what must be kept."""

import math

from jaxnarx.checks import require
from jaxnarx.formatting import page
from jaxnarx.settings.fields import NotNegative, Positive, settings


@settings
class Command:
    """An input of the plant that the controller sets."""

    low: float | int | None = None
    """Least value; default: that of the model's training."""
    high: float | int | None = None
    """Largest value."""
    rate: Positive | None = None
    """Largest change per second in either direction; default: any."""
    effort: NotNegative = 0.1
    """Price of a move: one by the whole trained range costs as much as an error, all
    over the horizon, of sqrt(effort) quarters of a target's trained range."""

    def __post_init__(self) -> None:
        require(
            self.low is None or self.high is None or self.low < self.high,
            "low",
            f"a command's bounds must be low < high, got {self.low} and {self.high}",
        )

    _repr_html_ = page


@settings
class OutputLimit:
    """What an output must keep where it can: a limit that gives way, at a price, where
    nothing else is left."""

    at_most: float | int | None = None
    """Largest value."""
    at_least: float | int | None = None
    """Least value."""
    guard: NotNegative = 3.0
    """Standard deviations of what errors may change by in a sample, that are kept to
    spare."""

    def __post_init__(self) -> None:
        require(
            self.at_most is not None or self.at_least is not None,
            "at_most",
            "a limit of an output needs at_most, at_least or both",
        )
        for field in ("at_most", "at_least"):
            value = getattr(self, field)
            require(
                value is None or math.isfinite(value),
                field,
                f"{field} must be finite, got {value}",
            )
        require(
            self.at_most is None
            or self.at_least is None
            or self.at_least < self.at_most,
            "at_least",
            f"a limit must have at_least < at_most, got {self.at_least} and "
            f"{self.at_most}",
        )

    _repr_html_ = page
