"""Settings of partition growth."""

import dataclasses
from collections.abc import Sequence

from jaxnarx.errors import SpecError


@dataclasses.dataclass(frozen=True)
class Global:
    """One local model that is valid everywhere: an ordinary polynomial NARX model."""


@dataclasses.dataclass(frozen=True)
class Lolimot:
    """Local linear model tree: axis-orthogonal halving of the worst local model.

    Nelles and Isermann 1996; thesis section 6.2.
    """

    scheduling: Sequence[str] = ()
    """Scheduling variables, such as "speed[t]" or "load[t-1]"."""
    max_models: int = 8
    """Largest number of local models."""
    k_sigma: float | int = 1 / 3
    """Width of a Gaussian as a share of its box's extension."""
    patience: int = 2
    """Stop after this many successive stages without a better criterion."""

    def __post_init__(self):
        if isinstance(self.scheduling, str):
            object.__setattr__(self, "scheduling", (self.scheduling,))
        object.__setattr__(self, "scheduling", tuple(self.scheduling))
        if not self.scheduling:
            raise SpecError(
                "Lolimot needs scheduling variables, such as "
                "scheduling=['speed[t]', 'load[t]']",
                field="scheduling",
            )
        if self.max_models < 1:
            raise SpecError(
                f"max_models must be at least 1, got {self.max_models}",
                field="max_models",
            )
        if not self.k_sigma > 0:
            raise SpecError(
                f"k_sigma must be positive, got {self.k_sigma}", field="k_sigma"
            )
