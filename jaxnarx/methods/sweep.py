"""Settings of sweeps: what fixes the program, and what one sweeps without a new one."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Literal

from jaxnarx.errors import SpecError

Lags = Sequence[int] | Mapping[str, Sequence[int]] | Sequence[tuple[str, Sequence[int]]]
LagLimit = int | Mapping[str, int] | Sequence[tuple[str, int]]

FUSED = ("lolimot", "tree", "random", "cluster")
SELECTED = ("forward", "stepwise", "backward", "simulation")
TRAINED = ("staged", "joint", "coefficients", "partition", "none")


def _require(holds: bool, field: str, message: str) -> None:
    if not holds:
        raise SpecError(message, field=field)


def _choice(field: str, value: str, known: tuple[str, ...]) -> None:
    _require(value in known, field, f"{field} must be one of {known}, got {value!r}")


def _lags(value: Lags) -> tuple:
    """Lags as a value that can be compared and hashed; by name as pairs."""
    rows = value.items() if isinstance(value, Mapping) else value
    return tuple((r[0], tuple(r[1])) if isinstance(r, tuple) else r for r in rows)


@dataclasses.dataclass(frozen=True)
class Identification:
    """Select, grow and refine: everything that is the same for all cases of a sweep.

    Forward orthogonal least squares over a polynomial pool, a partition, and
    Levenberg-Marquardt on the error of the free run are one program for all engines and
    cases; changing a field compiles anew, what does not is in `Case`. With any other
    method every member runs the verbs, one after the other.
    """

    scheduling: Sequence[str] = ()
    """Scheduling variables, such as "speed[t]"; needed beyond one local model."""
    _: dataclasses.KW_ONLY
    input_lags: Lags = (0, 1, 2)
    """Lags of the inputs, for all or by name; see `polynomial_pool`."""
    output_lags: Lags = (1, 2)
    """Lags that are fed back."""
    degree: int = 2
    """Largest degree of a term."""
    output: str = ""
    """The modelled output; may be left out where there is only one."""
    max_terms: int = 8
    """Capacity for terms."""
    max_models: int = 4
    """Capacity for local models."""
    validity: Literal["gaussians", "compact", "boxes"] = "gaussians"
    """Form of the validity functions."""
    partition: Literal["lolimot", "tree", "random", "cluster", "log-sigmoids"] | Any = (
        "lolimot"
    )
    """How the models are placed: halving of the worst (LOLIMOT), oblique sigmoid gates
    (HILOMOT), at samples drawn at random, or at the means of clusters that begin there;
    the last two have Gaussians. By the verbs: equal log-sigmoids of one variable, or a
    method that `grow` takes, whose `scheduling` and `max_models` then hold. A case
    changes those of its settings that are not the usual ones."""
    select: Literal["forward", "stepwise", "backward", "simulation"] | Any = "forward"
    """How terms are chosen; all but forward by the verbs, or a method that `select`
    takes, whose `max_terms` then holds."""
    steps: int = 10
    """Levenberg-Marquardt steps on full records, accepted or not; 0: no refinement."""
    horizons: Sequence[int] = ()
    """Lengths of windows [samples] before the full records."""
    window_steps: int = 5
    """Steps at each window length, and of the coefficients alone on full records where
    a case is staged."""
    objective: Literal["simulation", "prediction"] = "simulation"
    """What the refinement lowers on the training records: the error of the free run or
    that of one step. It is judged by the free run of the validation records."""
    width_band: tuple[float | int, float | int] = (0.5, 2.0)
    """Limits of a Gaussian's width as multiples of its start."""

    def __post_init__(self):
        for field, owner in (
            ("max_terms", self.select),
            ("max_models", self.partition),
            ("scheduling", self.partition),
        ):
            value = None if isinstance(owner, str) else getattr(owner, field, None)
            if value:
                object.__setattr__(self, field, value)
        single = isinstance(self.scheduling, str)
        scheduling = (self.scheduling,) if single else tuple(self.scheduling)
        object.__setattr__(self, "scheduling", scheduling)
        object.__setattr__(self, "horizons", tuple(self.horizons))
        object.__setattr__(self, "width_band", tuple(self.width_band))
        for field in ("input_lags", "output_lags"):
            object.__setattr__(self, field, _lags(getattr(self, field)))
        for field in ("max_terms", "max_models", "degree", "window_steps"):
            value = getattr(self, field)
            _require(value >= 1, field, f"{field} must be at least 1, got {value}")
        _require(self.steps >= 0, "steps", f"steps must be at least 0: {self.steps}")
        _require(
            all(h >= 2 for h in self.horizons),
            "horizons",
            f"horizons must be at least 2 samples each, got {self.horizons}",
        )
        _choice("validity", self.validity, ("gaussians", "compact", "boxes"))
        if isinstance(self.partition, str):
            _choice("partition", self.partition, (*FUSED, "log-sigmoids"))
        if isinstance(self.select, str):
            _choice("select", self.select, SELECTED)
        _require(
            self.select == "forward" or self.partition not in ("random", "cluster"),
            "partition",
            f'partition="{self.partition}" goes with select="forward" alone',
        )
        _choice("objective", self.objective, ("simulation", "prediction"))
        _require(
            self.validity == "gaussians" or self.partition == "lolimot",
            "validity",
            f'partition="{self.partition}" has validity functions of its own; leave '
            'validity="gaussians"',
        )
        low, high = self.width_band
        _require(
            0 < low < 1 < high,
            "width_band",
            f"width_band must enclose one, got {self.width_band}",
        )
        _require(
            bool(self.scheduling) or self.max_models == 1,
            "scheduling",
            f"{self.max_models} local models need scheduling variables, such as "
            "scheduling=['speed[t]']",
        )

    @property
    def fused(self) -> bool:
        """Whether one program does it all."""
        named = isinstance(self.select, str) and isinstance(self.partition, str)
        return named and self.select == "forward" and self.partition in FUSED

    @property
    def lags(self) -> dict[str, Any]:
        """Both kinds of lags as `polynomial_pool` takes them."""
        both: dict[str, Any] = {
            "input_lags": self.input_lags,
            "output_lags": self.output_lags,
        }
        return {
            name: dict(lags) if lags and isinstance(lags[0], tuple) else lags
            for name, lags in both.items()
        }


@dataclasses.dataclass(frozen=True)
class Case:
    """One point of a sweep: settings that are data to the compiled program.

    None stands for the capacity that `Identification` gives.
    """

    terms: int | None = None
    """Largest number of terms."""
    models: int | None = None
    """Largest number of local models."""
    steps: int | None = None
    """Levenberg-Marquardt steps on full records."""
    k_sigma: float | int = 1 / 3
    """Width of a Gaussian as a share of its box's extension."""
    smoothness: float | int = 1.0
    """Width of a sigmoid gate's transition."""
    ridge: float | int = 1e-5
    """Pull of every parameter towards its start in the refinement, as a share of the
    data's own information about it."""
    growth_ridge: float | int = 0.0
    """Pull of a new local model's coefficients towards the model it was split from."""
    rho: float | int = 0.0
    """Selection stops when 1 - sum(ERR) falls to this."""
    lags: LagLimit | None = None
    """Largest lag that may be used [samples], for all channels or by name (a channel it
    leaves out is not limited, one with -1 is left out)."""
    train: Literal["staged", "joint", "coefficients", "partition", "none"] = "staged"
    """What the refinement moves, and in what order: coefficients alone in the windows
    and for `window_steps` on full records, then everything (as `SimulationError.train`
    has it); everything from the beginning; or one kind alone."""
    scatter: float | int = 0.0
    """Standard deviation of a random move of the grown partition, in the coordinates of
    the refinement (0.7 is that of `SimulationError.starts`); the local models are then
    fitted anew."""
    seed: int = 0
    """Of that move, and of random and clustered partitions."""

    def __post_init__(self):
        lags = self.lags
        if isinstance(lags, Mapping):
            pairs = sorted((str(k), int(v)) for k, v in lags.items())
            object.__setattr__(self, "lags", tuple(pairs))
        elif isinstance(lags, Sequence):
            object.__setattr__(self, "lags", tuple((str(k), int(v)) for k, v in lags))
        for field in ("terms", "models"):
            value = getattr(self, field)
            _require(
                value is None or value >= 1,
                field,
                f"{field} must be at least 1, got {value}",
            )
        _require(
            self.steps is None or self.steps >= 0,
            "steps",
            f"steps must not be negative, got {self.steps}",
        )
        for field in ("k_sigma", "smoothness"):
            value = getattr(self, field)
            _require(
                0 < value < float("inf"),
                field,
                f"{field} must be positive, got {value}",
            )
        for field in ("ridge", "growth_ridge", "scatter"):
            value = getattr(self, field)
            _require(
                0 <= value < float("inf"),
                field,
                f"{field} must be finite and not negative, got {value}",
            )
        _require(0 <= self.rho < 1, "rho", f"rho must lie in [0, 1), got {self.rho}")
        _require(
            0 <= self.seed < 2**31, "seed", f"seed must lie in [0, 2^31): {self.seed}"
        )
        _choice("train", self.train, TRAINED)

    def labels(self) -> dict[str, str | int | float | None]:
        """The settings as plain scalars, for a table."""
        values = dataclasses.asdict(self)
        if isinstance(self.lags, tuple):
            values["lags"] = ", ".join(f"{name} {lag}" for name, lag in self.lags)
        elif self.lags is not None:
            values["lags"] = str(self.lags)
        return values
