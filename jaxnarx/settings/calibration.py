"""Settings of a calibration: what may be moved, what is wanted, what must be kept."""

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal

from jaxnarx.checks import require
from jaxnarx.formatting import page
from jaxnarx.settings.fields import Chance, Count, NotNegative, Positive, settings

TIME = "time"
"""Name of the signal that counts the seconds of a cycle: a curve over it is a
trajectory."""
KINDS = ("mean", "total", "peak", "lowest", "percentile", "tracking")
"""What is made of a signal over a cycle."""


@settings
class Calibratable:
    """A scalar, curve, map or trajectory that sets one input of a plant.

    Between its points it is linear in every signal, beyond them as at the last one, as
    control units compute it.
    """

    over: Sequence[str] = ()
    """Signals that it is looked up by, two at most: inputs of the cycle, outputs of the
    plant one sample before, or `time` [s]. None: one number."""
    axes: Sequence[Sequence[float | int]] = ()
    """Points of every signal, rising; default: `size` of them over what the cycle
    visits."""
    size: Sequence[int] = ()
    """Points of every signal where `axes` are not given; default 8."""
    start: Any = None
    """The calibration to begin with: one number, or one for every point, first signal
    first; default: the middle of the bounds."""
    low: float | int | None = None
    """Least value; default: that of the model's training."""
    high: float | int | None = None
    """Largest value."""
    steps: Sequence[float | int] = ()
    """Largest change from one point to the next along every signal; default: any."""
    rises: Sequence[str] = ()
    """Signals along which it must not fall."""
    falls: Sequence[str] = ()
    """Signals along which it must not rise."""
    away: Positive | None = None
    """Largest distance of every point from its start; default: any."""
    move_axes: bool = False
    """Whether the inner points of its axes move too."""

    def __post_init__(self) -> None:
        require(
            len(self.over) <= 2,
            "over",
            f"a map goes over two signals at most, got {', '.join(self.over)}",
        )
        for field in ("axes", "size", "steps"):
            given = len(getattr(self, field))
            require(
                given in (0, len(self.over)),
                field,
                f"{field} must be one for each of {len(self.over)} signals, got "
                f"{given}",
            )
        for axis in self.axes:
            rising = all(a < b for a, b in zip(axis, axis[1:], strict=False))
            require(
                len(axis) > 1 and rising,
                "axes",
                f"points of an axis must rise, and be two at least, got {tuple(axis)}",
            )
        require(
            all(n > 1 for n in self.size),
            "size",
            f"an axis needs two points at least, got {tuple(self.size)}",
        )
        unknown = [s for s in (*self.rises, *self.falls) if s not in self.over]
        require(
            not unknown,
            "rises",
            f"{', '.join(unknown)} is none of the signals it goes over",
        )
        if self.low is not None and self.high is not None:
            require(
                self.low < self.high,
                "low",
                f"low must be below high, got {self.low} and {self.high}",
            )


@settings
class Measure:
    """A number of a cycle: what is made of an output, or of a formula of signals."""

    of: str
    """Output, or formula of inputs, outputs and signals of the cycle: `fuel * speed`,
    `abs(NOx - 3)`; names that are no words in backticks."""
    kind: Literal["mean", "total", "peak", "lowest", "percentile", "tracking"] = "mean"
    """`total` is the integral over seconds, `tracking` the root mean square of the
    distance from `target`."""
    share: Chance = 0.95
    """Of `percentile`: the share of samples below."""
    target: str = ""
    """Of `tracking`: the signal, or formula, that is to be followed."""
    weight: NotNegative = 1.0
    """Weight in the objective, of the value over that of the start."""

    def __post_init__(self) -> None:
        require(
            (self.kind == "tracking") == bool(self.target),
            "target",
            "tracking needs a target, and nothing else takes one",
        )

    def __str__(self) -> str:
        """`95th percentile of NOx`."""
        if self.kind == "tracking":
            return f"distance of {self.of} from {self.target}"
        if self.kind == "percentile":
            return f"{100 * self.share:g} % percentile of {self.of}"
        return f"{self.kind} of {self.of}"

    _repr_html_ = page


@settings
class CycleLimit:
    """What a measure must keep."""

    measure: Measure
    at_most: float | int | None = None
    """Largest value."""
    at_least: float | int | None = None
    """Least value."""
    of_start: bool = False
    """Whether these are multiples of the value with the calibration to begin with; of
    several plants each of its own."""

    def __post_init__(self) -> None:
        require(
            (self.at_most is None) != (self.at_least is None),
            "at_most",
            "a limit is at_most or at_least a number",
        )

    @property
    def number(self) -> float:
        """The number that is kept."""
        number = self.at_most if self.at_most is not None else self.at_least
        assert number is not None
        return float(number)

    @property
    def sign(self) -> float:
        """One of a largest value, minus one of a least."""
        return 1.0 if self.at_most is not None else -1.0

    def __str__(self) -> str:
        """`mean of HC at most 1.2`."""
        word = "at most" if self.sign > 0 else "at least"
        of = " of the start" if self.of_start else ""
        return f"{self.measure} {word} {self.number:g}{of}"

    _repr_html_ = page


@settings
class CalibrationSearch:
    """An augmented Lagrangian: rounds of searches within bounds by L-BFGS-B.

    M. J. D. Powell, A method for nonlinear constraints in minimization problems, 1969;
    R. T. Rockafellar, J. Optim. Theory Appl. 12, 1973 (inequalities).
    """

    rounds: Count = 8
    """Rounds at most; after each the multipliers of the limits are made anew."""
    steps: Count = 40
    """Steps of a round at most."""
    tolerance: Positive = 1e-3
    """Share of a limit by which it may be broken, and gain of a round, in that of the
    start, that ends the search."""
    smooth: NotNegative = 1e-3
    """Weight of the roughness of maps: mean squared change of slope from point to
    point, of the range."""
    index: Positive | None = 1.0
    """Largest index of the model's domain, one at its border, or that of the start
    where this is larger; None: anything."""
    draws: Chance = 0.95
    """Share of the plants, where there are several, that must keep every limit."""
    sharp: Positive = 0.01
    """Error of smooth peaks, as a share of the signal's range, and share of the samples
    to each side that a smooth percentile is a mean of."""


@dataclasses.dataclass(frozen=True)
class CalibrationTask:
    """Everything but plant and cycle, as a TOML file has it."""

    maps: dict[str, Calibratable]
    objective: Sequence[Measure]
    limits: Sequence[CycleLimit] = ()
    search: CalibrationSearch = dataclasses.field(default_factory=CalibrationSearch)
