"""Settings of refinement."""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Literal

from jaxnarx.checks import require
from jaxnarx.settings.fields import (
    Count,
    NotNegative,
    Positive,
    Rule,
    Steps,
    settings,
)

Folds = Annotated[int, Rule("be 0 (none) or at least 2", lambda n: n == 0 or n >= 2)]
Band = Annotated[
    tuple[float | int, float | int],
    Rule("enclose one", lambda band: 0 < band[0] < 1 < band[1]),
]


@settings
class SimulationError:
    """Training on the error of the free run, by default least squares by
    Levenberg-Marquardt.

    The run is first restarted from the measurement every few samples; these windows
    grow until the whole record is one.
    """

    horizons: Sequence[int] | Literal["auto"] = (10, 30, 100, 300, 1000)
    """Window lengths in samples before the full record. `"auto"`: the first is the
    slowest time constant of the local models, each of the next three times longer."""
    max_steps: Steps = 40
    """Accepted steps on the full record."""
    window_steps: Steps = 20
    """Accepted steps at each window length, and of the coefficients alone on the full
    record."""
    train: Literal["staged", "joint", "either", "coefficients", "partition"] = "staged"
    """Order of training. `"staged"`: the coefficients alone in the windows, and for up
    to `window_steps` on the full record, then all together; `"joint"`: everything from
    the first window; `"either"`: one after the other, each to its end, and the better
    one by validation, at two to three times the cost; `"coefficients"` and
    `"partition"`: one kind alone, the other as it is. With noisy outputs a partition
    that moves in the windows adapts to biased coefficients and does not come back
    (`experiments/nelles`)."""
    tolerance: NotNegative = 1e-4
    """A stage ends when an accepted step lowers the loss by less than this share, twice
    in a row."""
    patience: Count = 15
    """Stop after this many accepted full-record steps without a better validation."""
    ridge: NotNegative = 1e-5
    """Regularisation of every parameter towards its start, as a share of the data's
    own information about it."""
    shrink: NotNegative = 0.0
    """Penalty of a coefficient's squared distance from its start, of columns made of
    variables with mean zero and spread one, in units of the output's spread: a model
    that says the mean costs one. Zero for none. Unlike the ridge it also constrains
    poorly excited directions."""
    width_band: Band = (0.5, 2.0)
    """Limits of a Gaussian's width as multiples of its start."""
    loss: Literal["squares", "huber", "log-cosh"] = "squares"
    """Loss of an error. The robust ones grow linearly beyond `corner`."""
    corner: Positive = 0.2
    """Error at which a robust loss turns linear, in standard deviations of the output
    (after its transform)."""
    box_cox: float | int | Mapping[str, float | int] = 1.0
    """Exponent p of the transform (y^p - 1) / p in which errors are measured, for all
    outputs or by name: 1 none, 0 the logarithm. For outputs of many decades, such as HC
    or particle number; they must be positive."""
    initial_conditions: Literal["measured", "estimated"] = "measured"
    """Whether training runs start from the measured outputs, or from ones estimated
    beside the parameters. The result is judged from measured starts in any case."""
    starts: Count = 1
    """Starting points. Those beyond the given network move the partition at random and
    take the coefficients of least squares there; the best by validation goes on."""
    folds: Folds = 0
    """Choose the length of the search by cross-validation over up to this many groups
    of what is left out together, then train on all; in place of validation records."""
    stability: NotNegative = 0.0
    """Weight of the penalty on samples at which the network does not contract; 0
    none."""
    contraction: Positive = 1.0
    """Norm of a step's linearisation above which the penalty acts."""
    stable: bool = False
    """Keep the certificate of the start: the result contracts for every input there is
    (`jaxnarx.refinement.certificate`)."""
    batch: Count = 32
    """Windows in one update, where `refine` is given a transformation of optax."""
    seed: int = 0
    """Seed of random starts and windows."""

    def __post_init__(self):
        horizons = () if self.horizons == "auto" else self.horizons
        require(
            all(h >= 2 for h in horizons),
            "horizons",
            f"horizons must be at least 2 samples each, got {self.horizons}",
        )
        powers = self.box_cox
        powers = powers.values() if isinstance(powers, Mapping) else (powers,)
        require(
            all(math.isfinite(p) for p in powers),
            "box_cox",
            f"box_cox must be finite, got {self.box_cox}",
        )
        require(
            not (self.folds and self.train == "either"),
            "train",
            'folds choose a position in one schedule; take train "staged" or "joint" '
            "with them",
        )


@settings
class PredictionError:
    """Least squares of the one-step error, by separable Gauss-Newton.

    Coefficients enter the one-step prediction linearly: for every partition they are
    solved for, and the search moves centres and widths alone (variable projection:
    Golub and Pereyra 1973, in Kaufman's form of 1975).
    """

    max_steps: Steps = 40
    """Accepted steps of the partition."""
    tolerance: NotNegative = 1e-4
    """The search ends when a step lowers the loss by less than this share, twice in a
    row."""
    patience: Count = 15
    """Stop after this many accepted steps without a better validation."""
    ridge: NotNegative = 1e-9
    """Regularisation of every parameter towards its start, as a share of the data's
    own information about it."""
    width_band: Band = (0.5, 2.0)
    """Limits of a Gaussian's width as multiples of its start."""
    train: Literal["joint", "coefficients", "partition"] = "joint"
    """Parameters that are trained: everything, or one kind alone."""
