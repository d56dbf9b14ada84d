"""Settings of structure detection by analysis of variance."""

import dataclasses
from typing import Literal

from jaxnarx.checks import whole
from jaxnarx.errors import SpecError


@dataclasses.dataclass(frozen=True)
class Anova:
    """Choose lagged variables and their interactions before any polynomial.

    Thesis (5.27) to (5.31); Lind and Ljung 2005 and 2008; Roll, Lind and Ljung 2006.
    """

    levels: int = 3
    """Intervals of equal frequency that each lagged variable is cut into. Two cannot
    see an even effect such as a square; more need more samples."""
    interactions: int = 2
    """Largest number of variables in one effect."""
    form: Literal["balanced", "penalised"] = "balanced"
    """F tests of balanced cells, or the convex penalised fit of one model of all
    effects.
    """
    significance: float | int = 0.01
    """Chance of keeping an effect that is none."""
    familywise: bool = True
    """Hold `significance` for all effects together, by Holm's rule (Bonferroni's in the
    penalised form), rather than for each one."""
    whole: bool = True
    """Test all variables in one factorial if the data fill its cells; otherwise, or if
    False, each effect among its own variables, one after the other."""
    balance: float | int = 0.2
    """Cells are thinned to equal size where this keeps at least this share of the
    samples; elsewhere all samples take part in an exact unbalanced test."""
    columns: int = 1000
    """Columns of the penalised form's model. Interactions that do not fit are passed
    over, the weakest first."""

    def __post_init__(self):
        whole(self.levels, "levels", 2, 10)
        whole(self.interactions, "interactions", 1, 4)
        whole(self.columns, "columns", 1, 5000)
        if self.form not in ("balanced", "penalised"):
            raise SpecError(
                f"form must be 'balanced' or 'penalised', got {self.form!r}",
                field="form",
            )
        if not 0.0 < self.significance < 1.0:
            raise SpecError(
                f"significance must lie in (0, 1), got {self.significance}",
                field="significance",
            )
        if not 0.0 <= self.balance <= 1.0:
            raise SpecError(
                f"balance must lie in [0, 1], got {self.balance}", field="balance"
            )
