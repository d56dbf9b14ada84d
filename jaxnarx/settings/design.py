"""Settings of experiment design."""

from typing import Literal

from jaxnarx.settings.fields import Positive, Steps, settings


@settings
class OptimalDesign:
    """Adjust the levels of an excitation plan by gradient of an optimality criterion.

    With M the information matrix of the p parameters: D minimises -log det M, the
    volume of the confidence ellipsoid; A minimises tr M^-1, the sum of the variances; G
    minimises the largest prediction variance over the samples of the starting plan.

    Thesis section 6.2.1; F. Pukelsheim, Optimal Design of Experiments, 1993.
    """

    criterion: Literal["D", "A", "G"] = "D"
    """"D", "A" or "G": which is improved; all three are reported."""
    max_steps: Steps = 100
    """Gradient steps; the best plan met is returned."""
    learning_rate: Positive = 0.03
    """Size of the first steps, as a share of each input's range; it falls to a tenth
    along a cosine."""
    power: Positive = 16
    """Exponent of the mean that stands in for the maximum in the gradient of G."""
