"""Settings of term selection on simulation error."""

from jaxnarx.checks import require
from jaxnarx.settings.fields import Count, Share, settings


@settings
class SimulationOLS:
    """Choose terms by what they promise for the free run, refining as they enter.

    Every round ranks all candidates by the derivative of the free-run error, takes in
    the one whose filtered column explains most of it, refines all coefficients on the
    free run, and drops a term whose loss costs less than the last entry brought.
    """

    max_terms: Count = 20
    """Largest number of terms, the constant included."""
    start_terms: Count | None = None
    """Terms chosen by one-step ERR to begin with, whose model must run; default: 4, or
    `max_terms` where that is less."""
    shortlist: Count = 150
    """Candidates, the best by the plain derivative, whose filtered columns are made."""
    steps: Count = 8
    """Accepted refinement steps after each change."""
    least_gain: Share = 1e-3
    """Stop when no candidate promises to lower the loss by this share."""
    patience: Count = 4
    """Stop after this many rounds that did not lower it by that share."""
    max_rounds: Count = 100
    """Largest number of rounds, entries and exchanges together."""
    tau: Share = 1e-8
    """Pass over a candidate whose filtered column keeps less than this share of its
    squared norm beside the chosen ones."""

    def __post_init__(self):
        require(
            self.start_terms is None or self.start_terms <= self.max_terms,
            "start_terms",
            f"start_terms ({self.start_terms}) exceeds max_terms ({self.max_terms})",
        )

    @property
    def first_terms(self) -> int:
        """Terms to begin with."""
        return self.start_terms or min(4, self.max_terms)
