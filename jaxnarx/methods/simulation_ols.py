"""Settings of term selection on simulation error."""

import dataclasses

from jaxnarx.errors import SpecError


@dataclasses.dataclass(frozen=True)
class SimulationOLS:
    """Choose terms by what they promise for the free run, refining as they enter.

    Every round ranks all candidates by the derivative of the free-run error, takes in
    the one whose filtered column explains most of it, refines all coefficients on the
    free run, and drops a term whose loss costs less than the last entry brought.
    """

    max_terms: int = 20
    """Largest number of terms, the constant included."""
    start_terms: int | None = None
    """Terms chosen by one-step ERR to begin with, whose model must run; default: 4, or
    `max_terms` where that is less."""
    shortlist: int = 150
    """Candidates, the best by the plain derivative, whose filtered columns are made."""
    steps: int = 8
    """Accepted refinement steps after each change."""
    least_gain: float | int = 1e-3
    """Stop when no candidate promises to lower the loss by this share."""
    patience: int = 4
    """Stop after this many rounds that did not lower it by that share."""
    max_rounds: int = 100
    """Largest number of rounds, entries and exchanges together."""
    tau: float | int = 1e-8
    """Pass over a candidate whose filtered column keeps less than this share of its
    squared norm beside the chosen ones."""

    def __post_init__(self):
        for field in (
            "max_terms",
            "start_terms",
            "shortlist",
            "steps",
            "patience",
            "max_rounds",
        ):
            value = getattr(self, field)
            if value is not None and value < 1:
                raise SpecError(
                    f"{field} must be at least 1, got {value}",
                    field=field,
                )
        if self.start_terms is not None and self.start_terms > self.max_terms:
            raise SpecError(
                f"start_terms ({self.start_terms}) exceeds max_terms "
                f"({self.max_terms})",
                field="start_terms",
            )
        for field in ("least_gain", "tau"):
            if not 0.0 <= getattr(self, field) < 1.0:
                raise SpecError(
                    f"{field} must lie in [0, 1), got {getattr(self, field)}",
                    field=field,
                )

    @property
    def first_terms(self) -> int:
        """Terms to begin with."""
        return self.start_terms or min(4, self.max_terms)
