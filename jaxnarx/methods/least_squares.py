"""Settings of least squares and of adaptation while a model runs."""

import dataclasses
import math

from jaxnarx.checks import choice
from jaxnarx.errors import SpecError


def _forgetting(value: float | int) -> None:
    if not 0.0 < value <= 1.0:
        raise SpecError(
            f"forgetting must lie in (0, 1], got {value}; 1 forgets nothing, 0.99 "
            "remembers about 100 samples",
            field="forgetting",
        )


@dataclasses.dataclass(frozen=True)
class LeastSquares:
    """How a linear regression is computed.

    Thesis (4.13) normal equations, (4.14) to (4.18) QR, (4.19) SVD, (4.39) to (4.42)
    recursive; scaling of the columns, section 4.2.3.
    """

    algorithm: str = "qr"
    """"qr", "svd", "normal" or "recursive"."""
    scaling: str = "norm"
    """What columns are divided by beforehand: "norm", "mean" or "none"."""
    ridge: float | int = 0.0
    """Pull towards zero, as a share of each column's own sum of squares."""
    cutoff: float | int | None = None
    """Smallest singular value kept, as a share of the largest; None: by the precision.
    Not for the recursive algorithm."""
    forgetting: float | int = 1.0
    """Weight of a sample against the one after it, in (0, 1]; recursive algorithm."""

    def __post_init__(self):
        choice(self.algorithm, ("qr", "svd", "normal", "recursive"), "algorithm")
        choice(self.scaling, ("norm", "mean", "none"), "scaling")
        _forgetting(self.forgetting)
        if not 0.0 <= self.ridge < math.inf:
            raise SpecError(
                f"ridge must be finite and not negative, got {self.ridge}",
                field="ridge",
            )
        if self.cutoff is not None and not 0.0 <= self.cutoff < 1.0:
            raise SpecError(
                f"cutoff must lie in [0, 1) or be None, got {self.cutoff}",
                field="cutoff",
            )
        recursive = self.algorithm == "recursive"
        if recursive and self.cutoff is not None:
            raise SpecError(
                "the recursive algorithm has no singular values to cut; leave cutoff "
                "out, or use algorithm='svd'",
                field="cutoff",
            )
        if not recursive and self.forgetting != 1.0:
            raise SpecError(
                f"forgetting belongs to algorithm='recursive'; with {self.algorithm!r} "
                "give weights instead",
                field="forgetting",
            )


@dataclasses.dataclass(frozen=True)
class Recursive:
    """Adapt the coefficients of a running network sample by sample.

    Recursive least squares with forgetting, and with what keeps it safe in long use: it
    rests where nothing is to be learnt, its covariance is bounded, and what made the
    error grow is undone. K. J. Astrom, B. Wittenmark, Adaptive Control, 1995, section
    11.5; local estimation: O. Nelles, Nonlinear System Identification, 2001, 13.2.
    """

    forgetting: float | int = 0.998
    """Weight of a sample against the next, in (0, 1]; a local model forgets in
    proportion to its validity at the sample."""
    start: float | int = 1.0
    """Variance of a coefficient of gain-scaled signals at the start, in units of the
    variance of the error: small trusts the network, large the data."""
    regressors: str = "measured"
    """Past outputs in the regressors: "measured" (equation error) or "simulated" (the
    model's own, as in use; output error)."""
    estimation: str = "local"
    """"local": each local model on its own, weighted by its validity; "joint": all
    chosen ones together."""
    models: tuple[int, ...] | None = None
    """Local models to adapt, counted from 0, of every output; None: all."""
    dead_zone: float | int = 0.0
    """Rest where the error is within this share of the output's gain."""
    excitation: float | int = 0.01
    """Rest where the news in a sample, w x'Px, is below this share of 1 - forgetting,
    which one direction brings that is excited all the time."""
    largest_trace: float | int = 1.0
    """Forget only while the trace of P stays below this many times its start."""
    window: int = 100
    """Samples after which the error is compared with that of the starting network."""
    growth: float | int = 2.0
    """Undo a window whose root mean square error is this many times the start's."""

    def __post_init__(self):
        choice(self.regressors, ("measured", "simulated"), "regressors")
        choice(self.estimation, ("local", "joint"), "estimation")
        _forgetting(self.forgetting)
        for field in ("start", "largest_trace"):
            if not 0.0 < getattr(self, field) < math.inf:
                raise SpecError(
                    f"{field} must be positive, got {getattr(self, field)}",
                    field=field,
                )
        for field in ("dead_zone", "excitation"):
            if not 0.0 <= getattr(self, field) < math.inf:
                raise SpecError(
                    f"{field} must not be negative, got {getattr(self, field)}",
                    field=field,
                )
        if self.window < 1:
            raise SpecError(
                f"window must be at least 1 sample, got {self.window}", field="window"
            )
        if not self.growth > 1.0:
            raise SpecError(
                f"growth must be above 1, got {self.growth}", field="growth"
            )
        if self.models is not None and (
            not self.models or len(set(self.models)) != len(self.models)
        ):
            raise SpecError(
                f"models must name each local model once, at least one, got "
                f"{self.models}",
                field="models",
            )
