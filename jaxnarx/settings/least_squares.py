"""Settings of least squares and of adaptation while a model runs."""

from collections.abc import Sequence
from typing import Annotated, Literal

from jaxnarx.checks import require
from jaxnarx.settings.fields import (
    Count,
    Forgetting,
    NotNegative,
    Positive,
    Rule,
    Share,
    settings,
)

Growth = Annotated[float | int, Rule("be above 1", lambda x: x > 1)]


@settings
class LeastSquares:
    """The settings of a linear regression.

    Thesis (4.13) normal equations, (4.14) to (4.18) QR, (4.19) SVD, (4.39) to (4.42)
    recursive; scaling of the columns, section 4.2.3.
    """

    algorithm: Literal["qr", "svd", "normal", "recursive"] = "qr"
    """"qr", "svd", "normal" or "recursive"."""
    scaling: Literal["norm", "mean", "none"] = "norm"
    """Divisor of the columns beforehand: "norm", "mean" or "none"."""
    ridge: NotNegative = 0.0
    """Pull towards zero, as a share of each column's own sum of squares."""
    cutoff: Share | None = None
    """Smallest singular value kept, as a share of the largest; None: by the precision.
    Not for the recursive algorithm."""
    forgetting: Forgetting = 1.0
    """Weight of a sample against the one after it, in (0, 1]; recursive algorithm."""

    def __post_init__(self):
        recursive = self.algorithm == "recursive"
        require(
            not recursive or self.cutoff is None,
            "cutoff",
            "the recursive algorithm has no singular values to cut; leave cutoff out, "
            "or use algorithm='svd'",
        )
        require(
            recursive or self.forgetting == 1.0,
            "forgetting",
            f"forgetting belongs to algorithm='recursive'; with {self.algorithm!r} "
            "give weights instead",
        )


LEAST_WINDOW_ERROR = 1e-4
"""Root mean square error of adaptation, as a share of an output's gain, below which no
window is undone: a start that is exact has no error to compare with."""


@settings
class Recursive:
    """Adapt the coefficients of a running network sample by sample.

    Recursive least squares with forgetting, and with what keeps it safe in long use: it
    rests where nothing is to be learnt, its covariance is bounded, and what made the
    error grow is undone. K. J. Astrom, B. Wittenmark, Adaptive Control, 1995, section
    11.5; local estimation: O. Nelles, Nonlinear System Identification, 2001, 13.2.
    """

    forgetting: Forgetting = 0.998
    """Weight of a sample against the next, in (0, 1]; a local model forgets in
    proportion to its validity at the sample."""
    start: Positive = 0.01
    """Variance of a coefficient of gain-scaled signals at the start, in units of the
    variance of the error: small trusts the network, large the data."""
    regressors: Literal["measured", "simulated"] = "measured"
    """Past outputs in the regressors: "measured" (equation error) or "simulated" (the
    model's own, as in use; output error)."""
    estimation: Literal["local", "joint"] = "joint"
    """"joint": all chosen local models together, as most networks are trained; "local":
    each on its own, weighted by its validity, with less memory and fewer operations,
    for networks that were trained so."""
    models: Sequence[int] | None = None
    """Local models to adapt, counted from 0, of every output; None: all."""
    dead_zone: NotNegative = 0.0
    """Rest where the error is within this share of the output's gain."""
    excitation: NotNegative = 0.01
    """Rest where the news in a sample, w x'Px, is below this share of 1 - forgetting,
    which one direction brings that is excited all the time."""
    largest_trace: Positive = 1.0
    """Forget only while the trace of P stays below this many times its start."""
    largest_index: Positive | None = 1.0
    """Rest where the index of the network's domain is larger, if it has one; None:
    nowhere."""
    window: Count = 100
    """Samples after which the error is compared with that of the starting network."""
    growth: Growth = 2.0
    """Undo a window whose root mean square error is this many times the start's."""

    def __post_init__(self):
        models = (0,) if self.models is None else self.models
        require(
            0 < len(models) == len(set(models)),
            "models",
            f"models must name each local model once, at least one, got {self.models}",
        )
