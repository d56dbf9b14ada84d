"""Settings of inverse models: what actuators can do, and how an inverse is trained."""

import dataclasses
from collections.abc import Mapping, Sequence

from jaxnarx.checks import require
from jaxnarx.settings.fields import NotNegative, Steps, settings

Number = float | int


@settings
class ActuatorLimits:
    """The limits of the actuators behind the commands, by name of the command.

    A command that is not named keeps the range in which the inverse was trained,
    widened as its feedback is, and moves as fast as it likes.
    """

    range: Mapping[str, tuple[Number, Number]] = dataclasses.field(default_factory=dict)
    """Smallest and largest value, in the command's unit."""
    rate: Mapping[str, Number] = dataclasses.field(default_factory=dict)
    """Largest change per second in either direction, in the command's unit."""

    def __post_init__(self):
        for name, (low, high) in self.range.items():
            require(
                low < high,
                "range",
                f"the range of {name} must be (low, high) with low < high, got "
                f"({low}, {high})",
            )
        for name, rate in self.rate.items():
            require(
                rate > 0,
                "rate",
                f"the rate of {name} must be positive, in its unit per second, got "
                f"{rate}",
            )


@settings
class TrackingError:
    """Training of an inverse through a forward network that does not move.

        J = sum_o mean_t ((y_o - r_o) / s_o)^2
            + effort sum_c mean_t ((u_c(t) - u_c(t-1)) / w_c)^2

    s_o is the standard deviation of the reference, w_c the range of the command in the
    inverse's training data. Least squares by Levenberg-Marquardt; limits act inside.
    """

    effort: NotNegative = 1e-3
    """Price of moving the commands. A change by the whole range in every sample costs
    as much as a tracking error of sqrt(effort) standard deviations."""
    horizons: Sequence[int] = ()
    """Window lengths [samples] before the full record: windows begin at recorded
    commands and outputs. Useful where the direct inverse runs away."""
    max_steps: Steps = 40
    """Accepted steps on the full record."""
    window_steps: Steps = 10
    """Accepted steps at each window length."""
    tolerance: NotNegative = 1e-4
    """Stop when an accepted step lowers the loss by less than this share, twice in a
    row."""
    patience: Steps = 10
    """Stop after this many accepted steps on full records without a better
    validation."""
    ridge: NotNegative = 1e-5
    """Regularisation of every parameter towards its start, as a share of the data's own
    information about it."""
    width_band: tuple[Number, Number] = (0.5, 2.0)
    """Limits of a validity's width as multiples of its start."""

    def __post_init__(self):
        require(
            all(h >= 1 for h in self.horizons),
            "horizons",
            f"horizons must be at least 1 sample, got {list(self.horizons)}",
        )
        low, high = self.width_band
        require(
            0 < low <= 1 <= high,
            "width_band",
            f"width_band must hold 0 < low <= 1 <= high, got {self.width_band}",
        )
