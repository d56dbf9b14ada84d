"""Settings of experiment design."""

import dataclasses

from jaxnarx.errors import SpecError


@dataclasses.dataclass(frozen=True)
class OptimalDesign:
    """Adjust the levels of an excitation plan by gradient of an optimality criterion.

    With M the information matrix of the p parameters: D minimises -log det M, the
    volume of the confidence ellipsoid; A minimises tr M^-1, the sum of the variances; G
    minimises the largest prediction variance over the samples of the starting plan.

    Thesis section 6.2.1; F. Pukelsheim, Optimal Design of Experiments, 1993.
    """

    criterion: str = "D"
    """"D", "A" or "G": which is improved; all three are reported."""
    max_steps: int = 100
    """Gradient steps; the best plan met is returned."""
    learning_rate: float | int = 0.03
    """Size of the first steps, as a share of each input's range; it falls to a tenth
    along a cosine."""
    power: float | int = 16
    """Exponent of the mean that stands in for the maximum in the gradient of G."""

    def __post_init__(self):
        if self.criterion not in ("D", "A", "G"):
            raise SpecError(
                f"criterion must be 'D', 'A' or 'G', got {self.criterion!r}",
                field="criterion",
            )
        if self.max_steps < 0:
            raise SpecError(
                f"max_steps must not be negative, got {self.max_steps}",
                field="max_steps",
            )
        for name in ("learning_rate", "power"):
            value = getattr(self, name)
            if not 0 < value < float("inf"):
                raise SpecError(f"{name} must be positive, got {value}", field=name)
