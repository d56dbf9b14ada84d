"""Analysis of variance: which lagged variables and interactions act at all."""

from jaxnarx.selection.anova.table import (
    AnovaTable,
    EffectTest,
    anova,
    significant_terms,
)

__all__ = ["AnovaTable", "EffectTest", "anova", "significant_terms"]
