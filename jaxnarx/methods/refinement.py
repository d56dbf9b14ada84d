"""Settings of refinement."""

import dataclasses
from collections.abc import Sequence

from jaxnarx.errors import SpecError


@dataclasses.dataclass(frozen=True)
class SimulationError:
    """Least squares of the free-run error by Levenberg-Marquardt.

    The run is first restarted from the measurement every few samples; these windows
    grow until the whole record is one.
    """

    horizons: Sequence[int] = (10, 30, 100, 300, 1000)
    """Window lengths in samples before the full record."""
    max_steps: int = 40
    """Accepted steps on the full record."""
    window_steps: int = 20
    """Accepted steps at each window length."""
    tolerance: float | int = 1e-4
    """A stage ends when an accepted step lowers the loss by less than this share, twice
    in a row."""
    patience: int = 15
    """Stop after this many accepted full-record steps without a better validation."""
    ridge: float | int = 1e-5
    """Pull of every parameter towards its start, as a share of the data's own
    information about it."""
    width_band: tuple[float | int, float | int] = (0.5, 2.0)
    """Limits of a Gaussian's width as multiples of its start."""

    def __post_init__(self):
        object.__setattr__(self, "horizons", tuple(self.horizons))
        if any(h < 2 for h in self.horizons):
            raise SpecError(
                f"horizons must be at least 2 samples, got {self.horizons}",
                field="horizons",
            )
        if self.max_steps < 0 or self.window_steps < 0:
            raise SpecError("step budgets must not be negative", field="max_steps")
        if not (self.ridge >= 0 and self.tolerance >= 0):
            raise SpecError(
                f"ridge and tolerance must not be negative, got {self.ridge} and "
                f"{self.tolerance}",
                field="ridge",
            )
        if self.patience < 1:
            raise SpecError(
                f"patience must be at least 1, got {self.patience}", field="patience"
            )
        if not 0 < self.width_band[0] < 1 < self.width_band[1]:
            raise SpecError(
                f"width_band must enclose one, got {self.width_band}",
                field="width_band",
            )
