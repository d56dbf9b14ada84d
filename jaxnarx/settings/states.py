"""Settings of models with hidden states."""

import math
from collections.abc import Sequence

from jaxnarx.checks import require
from jaxnarx.settings.fields import Count, NotNegative, Steps, settings


@settings
class HiddenStates:
    """A state-space model with polynomials of states and inputs, or with local models
    in regions of them, trained on the free run.

    Linear models by subspace identification and a chain of first-order lags are its
    starts; products come with coefficients of zero, regions by division.
    """

    outputs: Sequence[str] = ()
    """Names of the outputs it computes; default: all."""
    states: Count = 2
    """Number of hidden states."""
    degree: Count = 2
    """Most factors of a product."""
    regions: Count = 1
    """Most regions, in each of which everything has local models; with degree one they
    are linear. Every number from two on is trained."""
    gates: int = 0
    """Sigmoid gates along learned directions of states and inputs, which outputs and
    states share; with degree one and one region."""
    draw: int = 0
    """Number of the draw of the gates: another number draws other ones."""
    saturation: NotNegative = 0.0
    """Standard deviations of a state of the linear start at which it saturates, in
    training and as a part of the model: products of states can run away from a short
    record, and where a tank overflows they have to. 0: nowhere."""
    times: Sequence[float] = ()
    """Time constants [s] of a bank of first-order lags to start from, one for every
    state, each input at its dead time and a little later; for one output. By default
    subspace identification."""
    shrink: Sequence[float] = (0.1, 0.01, 0.001)
    """Regularisation of the coefficients, see `SimulationError`: at first towards the
    linear model, then towards where the last value has led. The training goes through
    these values one after another."""
    ridge: NotNegative = 1e-4
    """Ridge of what has gates or regions, as a share of what the data say, towards
    where each value of `shrink` begins. A model that errs by far less than a
    hundredth of the output's spread wants less of it."""
    window: Count = 50
    """Measured samples that a run's first states are estimated from."""
    start: str = ""
    """Name of the linear model to start from; by default the one with the smallest
    error in training."""
    max_steps: Steps = 40
    """Accepted steps at each value of `shrink`, on all samples."""
    first_steps: Steps = 12
    """Steps that every start is given first, at each degree."""
    first_rows: Count = 3000
    """Samples, in stretches of all records, that these are taken on. Where there are
    more the best start goes on alone."""
    stretch: Steps = 0
    """Least samples of such a stretch, where a record's share is that long: several
    times the memory of slow states, which leave the data otherwise."""

    def __post_init__(self):
        plain = self.degree == 1 and self.regions == 1
        require(
            self.gates >= 0 and (self.gates == 0 or plain),
            "gates",
            f"gates must be at least 0, and need degree 1 and one region; got "
            f"{self.gates} gates, degree {self.degree}, {self.regions} regions",
        )
        require(
            not len(self.times) or len(self.times) == self.states,
            "times",
            f"times must be one for each of the {self.states} states, got {self.times}",
        )
        require(
            all(0 < time < math.inf for time in self.times),
            "times",
            f"times must be positive and finite, got {self.times}",
        )
        falling = all(a > b for a, b in zip(self.shrink, self.shrink[1:], strict=False))
        require(
            len(self.shrink) > 0 and falling and self.shrink[-1] >= 0,
            "shrink",
            f"shrink must fall, and not below zero, got {tuple(self.shrink)}",
        )

    @property
    def stages(self) -> tuple[tuple[int, float], ...]:
        """Number of regions and pull of every network that the training ends with."""
        counts = range(min(self.regions, 2), self.regions + 1)
        return tuple((count, pull) for count in counts for pull in self.shrink)
