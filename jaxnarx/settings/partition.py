"""Settings of partition growth."""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any, Literal

from jaxnarx.checks import require
from jaxnarx.settings.fields import (
    Count,
    NotNegative,
    Positive,
    Seed,
    settings,
    unlike_settings,
)
from jaxnarx.settings.selection import ForwardOLS, StepwiseF


@settings
class Global:
    """One local model that is valid everywhere: an ordinary polynomial NARX model."""


@settings
class _Local:
    """The settings of the local models of every partition."""

    local: ForwardOLS | StepwiseF | None = dataclasses.field(default=None, kw_only=True)
    """How every local model chooses terms of its own, weighted with its validity;
    default: all have the terms that they are given."""
    ridge: NotNegative = dataclasses.field(default=0.0, kw_only=True)
    """Regularisation of a local model's coefficients towards the model it was split
    from (of a partition that is given: towards the global model), as a share of the
    data's own information about each. Not for local models with terms of their own."""
    feedback: Literal["network", "own", "choose"] = dataclasses.field(
        default="network", kw_only=True
    )
    """Feedback of a local model in a free run: the network's output, its own (an
    output-error model of its region; thesis chapter 8, the fourth item), or, region by
    region, what gives the smaller free-run error on the validation records, without any
    on the training records. It makes no difference one step ahead."""

    def __post_init__(self):
        require(
            self.local is None or self.ridge == 0,
            "ridge",
            "local models with terms of their own take no ridge",
        )


@settings
class _Scheduled(_Local):
    """The settings of every partition of several models."""

    scheduling: Sequence[str] = ()
    """Scheduling variables, such as "speed[t]" or "load[t-1]"."""

    def __post_init__(self):
        super().__post_init__()
        name = type(self).__name__
        _require_once(self.scheduling)
        require(
            bool(self.scheduling),
            "scheduling",
            f"{name} needs scheduling variables, such as "
            "scheduling=['speed[t]', 'load[t]']",
        )


def _require_once(scheduling: Sequence[str]) -> None:
    require(
        len(set(scheduling)) == len(scheduling),
        "scheduling",
        f"a scheduling variable is named twice: {', '.join(scheduling)}",
    )


@settings
class _Grown(_Scheduled):
    """The settings of every growth."""

    max_models: Count = dataclasses.field(default=8, kw_only=False)
    """Largest number of local models."""
    patience: Count = dataclasses.field(default=2, kw_only=True)
    """Stop after this many successive stages without a better criterion."""
    criterion: Literal["aicc", "bic", "validation", "none"] = dataclasses.field(
        default="aicc", kw_only=True
    )
    """Criterion for the number of models: the corrected Akaike or the Bayesian
    criterion with the effective number of parameters; the free run on the records that
    `grow` is given as `validation`; or nothing but `max_models`."""
    least: Positive | None = dataclasses.field(default=None, kw_only=True)
    """Least sum of a local model's validity over the samples; default: its number of
    parameters. A split that would leave less is forbidden."""
    scatter: NotNegative = dataclasses.field(default=0.0, kw_only=True)
    """Standard deviation of a random move of the grown partition, in the coordinates of
    the refinement (0.7 is that of `SimulationError.starts`); the local models are then
    fitted anew."""
    seed: Seed = dataclasses.field(default=0, kw_only=True)
    """Seed of that move."""

    def __post_init__(self):
        super().__post_init__()
        require(
            not self.scatter or self.local is None,
            "scatter",
            "a partition whose models have terms of their own is not moved",
        )


@settings
class Lolimot(_Grown):
    """Local linear model tree: axis-orthogonal halving of the worst local model.

    Nelles and Isermann 1996; thesis section 6.2.
    """

    k_sigma: Positive = 1 / 3
    """Width of a Gaussian as a share of its box's extension; with `compact` validity,
    half the width of the zone of transition."""
    _: dataclasses.KW_ONLY
    worst: Literal["squares", "nmse"] = "squares"
    """Criterion for the model that is split: the one with the largest sum of weighted
    squared errors (Nelles), or with the largest local NMSE (6.8) (thesis), blind to its
    size."""
    validity: Literal["gaussians", "compact", "boxes"] = "gaussians"
    """Form of the validity functions: normalised Gaussians, smooth curves of bounded
    support, or piecewise constant."""


@settings
class SigmoidTree(_Grown):
    """Hierarchical local model tree: the worst leaf is cut by a sigmoid gate.

    O. Nelles 2006; B. Hartmann and O. Nelles 2009 (HILOMOT); thesis section 7.2.
    """

    smoothness: Positive = 1.0
    """Width of a gate's transition: its steepness is 16 over this and over the distance
    between the middles of the regions on its sides."""
    _: dataclasses.KW_ONLY
    oblique: bool = True
    """Optimise the direction and place of every gate; False: gates across one variable
    each."""
    steps: Count = 15
    """Steps of that optimisation."""
    prune: bool = False
    """Merge sibling leaves again, after the growth, while AICc falls."""


@settings
class Placed(_Scheduled):
    """Gaussians at samples drawn at random, or at the means of clusters from there.

    Clusters: S. Lloyd, "Least squares quantization in PCM", 1982.
    """

    max_models: Count = 8
    """Number of local models."""
    k_sigma: Positive = 1 / 3
    """Width of a Gaussian as a share of the extension of one of as many equal boxes; of
    a cluster, of its own."""
    _: dataclasses.KW_ONLY
    at: Literal["samples", "clusters"] = "clusters"
    """Places of the centres."""
    seed: Seed = 0
    """Seed of the samples that are drawn."""

    def __post_init__(self):
        super().__post_init__()
        require(
            self.local is None, "local", "models that are placed have terms in common"
        )


Numbers = Sequence[float | int]


@settings
class Grid(_Scheduled):
    """A partition that is given: equal boxes, borders, or centres.

    One of `models`, `borders` and `centres`.
    """

    models: Sequence[int] = ()
    """Local models along each scheduling variable, whose range in the data is divided
    equally."""
    borders: Sequence[Numbers] = ()
    """Inner borders along each scheduling variable, in its unit, ascending."""
    centres: Sequence[Numbers] = ()
    """A centre for each local model: a value per scheduling variable, in its unit."""
    widths: Sequence[Numbers] = ()
    """Widths of the Gaussians about `centres`, in the same form; default: `k_sigma`
    times the distance to the nearest other centre (ranges scaled to one)."""
    validity: Literal["gaussians", "compact", "boxes", "log-sigmoids"] = "gaussians"
    """Form of the validity functions; log-sigmoids divide one variable."""
    k_sigma: Positive = 1 / 3
    """Width of a Gaussian as a share of its box's extension; with `compact` validity,
    half the width of the zone of transition."""
    steepness: Positive | None = None
    """Steepness of the log-sigmoids, per unit of the scheduling variable; default: 5
    over the mean distance between borders."""

    def __post_init__(self):
        super().__post_init__()
        given = [n for n in ("models", "borders", "centres") if len(getattr(self, n))]
        require(
            len(given) == 1,
            "models",
            f"give one of models, borders and centres, got {given or 'none'}",
        )
        self._check_sizes()

    def _check_sizes(self) -> None:
        dims = len(self.scheduling)
        for name in ("models", "borders"):
            value = getattr(self, name)
            require(
                not value or len(value) == dims,
                name,
                f"{name} needs one entry for each of {', '.join(self.scheduling)}, "
                f"got {len(value)}",
            )
        for name in ("centres", "widths"):
            require(
                all(len(row) == dims for row in getattr(self, name)),
                name,
                f"every entry of {name} needs {dims} numbers, one for each scheduling "
                "variable",
            )
        require(
            not self.models or min(self.models) >= 1,
            "models",
            f"models must be at least 1 along every variable, got {self.models}",
        )
        require(
            all(a < b for row in self.borders for a, b in itertools.pairwise(row)),
            "borders",
            f"borders must ascend, got {self.borders}",
        )
        require(
            len(set(self.centres)) == len(self.centres),
            "centres",
            "two centres are the same; give every local model its own",
        )
        require(
            not self.widths or len(self.widths) == len(self.centres),
            "widths",
            f"{len(self.widths)} widths for {len(self.centres)} centres",
        )
        require(
            all(w > 0 for row in self.widths for w in row),
            "widths",
            "widths must be positive",
        )
        require(
            not self.centres or self.validity in ("gaussians", "log-sigmoids"),
            "validity",
            f"centres go with gaussians or log-sigmoids, not {self.validity}",
        )
        require(
            self.validity != "log-sigmoids" or dims == 1,
            "validity",
            f"log-sigmoids divide one variable, not {dims}",
        )


@unlike_settings
class Given(_Local):
    """A partition from elsewhere: only the local models are made here.

    So outputs can share the regions that were grown for one of them, an engine those
    of its sister, regions can be drawn by hand, and a method of one's own can make
    them.
    """

    partition: Any
    """A `Network`, whose regions are taken, a validity function of `jaxnarx.models`,
    a `Partitioner`, which is a function of the data that returns one, or the name of a
    registered one."""
    output: str | None = None
    """Output of a network whose regions serve all; default: each output has those of
    the output of its name, or those of the network's only output."""
    scheduling: Sequence[str] = ()
    """Its scheduling variables, but for a network, which has them."""
    ranges: Sequence[Numbers] = ()
    """But for a network: what 0 and 1 of each scheduling variable stand for, in
    its unit; default: the ends of its range in the data."""

    def __post_init__(self):
        super().__post_init__()
        _require_once(self.scheduling)
        ranges = self.ranges
        require(
            not ranges or len(ranges) == len(self.scheduling),
            "ranges",
            f"{len(ranges)} ranges for {len(self.scheduling)} scheduling variables",
        )
        require(
            all(len(row) == 2 and row[0] < row[1] for row in ranges),
            "ranges",
            f"a range is a lower and a higher value, got {self.ranges}",
        )
