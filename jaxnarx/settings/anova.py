"""Settings of structure detection by analysis of variance."""

from typing import Annotated, Literal

from jaxnarx.settings.fields import Chance, Rule, settings

Levels = Annotated[int, Rule("be a whole number from 2 to 10", lambda n: 2 <= n <= 10)]
Order = Annotated[int, Rule("be a whole number from 1 to 4", lambda n: 1 <= n <= 4)]
Columns = Annotated[
    int, Rule("be a whole number from 1 to 5000", lambda n: 1 <= n <= 5000)
]
Part = Annotated[float | int, Rule("lie in [0, 1]", lambda x: 0 <= x <= 1)]


@settings
class Anova:
    """Choose lagged variables and their interactions before any polynomial.

    Thesis (5.27) to (5.31); Lind and Ljung 2005 and 2008; Roll, Lind and Ljung 2006.
    """

    levels: Levels = 3
    """Intervals of equal frequency that each lagged variable is cut into. Two cannot
    see an even effect such as a square; more need more samples."""
    interactions: Order = 2
    """Largest number of variables in one effect."""
    form: Literal["balanced", "penalised"] = "balanced"
    """F tests of balanced cells, or the convex penalised fit of one model of all
    effects.
    """
    significance: Chance = 0.01
    """Chance of keeping an effect that is none."""
    familywise: bool = True
    """Hold `significance` for all effects together, by Holm's rule (Bonferroni's in the
    penalised form), rather than for each one."""
    whole: bool = True
    """Test all variables in one factorial if the data fill its cells; otherwise, or if
    False, each effect among its own variables, one after the other."""
    balance: Part = 0.2
    """Cells are thinned to equal size where this keeps at least this share of the
    samples; elsewhere all samples take part in an exact unbalanced test."""
    columns: Columns = 1000
    """Columns of the penalised form's model. Interactions that do not fit are passed
    over, the weakest first."""
