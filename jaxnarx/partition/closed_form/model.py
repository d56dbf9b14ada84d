"""A candidate in closed form: its structure, its errors, its network."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from jaxnarx.data import Dataset
from jaxnarx.models import OUTPUT_MARGIN, Network
from jaxnarx.partition.closed_form.growth import GrownStage
from jaxnarx.partition.closed_form.network import make_network
from jaxnarx.partition.closed_form.signals import RunSignals
from jaxnarx.partition.closed_form.sums import Errors, Summand, root_mean_square
from jaxnarx.simulation import has_diverged

RUNAWAY_VALUE = 1e30
"""Stands for values that are not finite [standard deviations]."""


@dataclasses.dataclass(frozen=True)
class ClosedStructure:
    """How a candidate is made: by this it is made again of other records."""

    order: int = 0
    """Order of A(q)."""
    step: int = 1
    """Step of the lags."""
    degree: int = 1
    models: int = 1
    """Regions."""
    fine: bool = False
    """Whether the ridge was searched before the feedback moved."""
    feedback: bool = False
    """Whether the feedback of one region has moved ..."""
    gates: bool = False
    """... and the gates with it behind the last halving."""
    partition: str = ""
    """Name of a partition of another package."""

    def undivided(self) -> "ClosedStructure":
        """The polynomial whose region is divided."""
        return dataclasses.replace(self, models=1, gates=False)


@dataclasses.dataclass(frozen=True, eq=False)
class ClosedForm:
    """A candidate: its structure, its errors, and the network of all records."""

    family: str
    name: str
    stage: GrownStage
    data: Dataset
    structure: ClosedStructure
    given: Float[np.ndarray, " columns"] | None = None
    """Coefficients that are not those of least squares of the free run ..."""
    left_out: Sequence[Float[np.ndarray, " _"]] | None = None
    """... and what such models answer over every group made without it."""
    unconstrained: float | None = None
    """`free_run` without the constraints of physics; None where there are none."""
    turned: Mapping[str, tuple[int, int]] = dataclasses.field(default_factory=dict)
    """Gains at rest that are wrong without them, and all that are asked, by input."""

    @property
    def free_run(self) -> float:
        """NRMSE over the groups left out."""
        return self.stage.error

    def losses(self) -> Float[np.ndarray, " groups"]:
        """Mean squared error of every group; NaN where no sample of it counts."""
        count = self.stage.design.equations.judged
        return self.stage.losses / np.where(count > 0, count, np.nan)

    def count_diverged(self) -> int:
        """Runs that would leave the bounds of the feedback, far beyond the trained
        range more than now and then: records run by the model of all groups, and groups
        by the models made without them."""
        low, high = self._bounds
        left = self.stage.held_out_runs() if self.left_out is None else self.left_out
        every = (
            self._signals.to_output(run) for run in (*self._runs(), *map(tame, left))
        )
        return sum(
            bool(has_diverged((run < low) | (run > high))) for run in every if len(run)
        )

    def one_step(self) -> float:
        """One-step NRMSE of the model of all groups: A(q) y less what drives it."""
        return root_mean_square(self.one_step_errors()[1])

    def one_step_errors(self) -> Errors:
        """One-step errors of the model of all groups, where samples count."""
        a, order = self.stage.design.a, len(self.stage.design.a) - 1
        driven = self.stage.design.driven(self.coefficients())
        places, errors = [], []
        for one, raw in zip(self._signals.stretches, driven, strict=True):
            if one.at_rest:
                continue
            at = np.concatenate(one.counted)
            places.append(one.first + at)
            ahead = raw - a[1:] @ one.lags(one.y, order)
            seen, told = self._signals.to_output(np.stack([one.y, ahead])[:, at])
            errors.append(seen - told)
        return np.concatenate(places), np.concatenate(errors)

    def held_out_errors(self) -> list[Errors]:
        """Free-run errors of every group by the model made without it."""
        design = self.stage.design
        runs = self.stage.held_out_runs() if self.left_out is None else self.left_out
        return [(design.places(g), design.error(g, run)) for g, run in enumerate(runs)]

    @property
    def _signals(self) -> RunSignals:
        return self.stage.design.signals

    @property
    def _bounds(self) -> tuple[float, float]:
        y = self._signals.to_output(np.concatenate(self.stage.design.measured))
        margin = OUTPUT_MARGIN * (y.max() - y.min())
        return float(y.min() - margin), float(y.max() + margin)

    def part(self, network: Network) -> Summand:
        """The part of the candidate that a sum needs."""
        left = [(at, error.astype(np.float32)) for at, error in self.held_out_errors()]
        at, error = self.one_step_errors()
        return Summand(
            f"{self.family}, {self.name}", network, left, (at, error.astype(np.float32))
        )

    def _runs(self) -> list[np.ndarray]:
        """Free runs by the model of all groups."""
        with np.errstate(all="ignore"):
            runs = self.stage.design.runs(self.coefficients())
        pairs = zip(self._signals.stretches, runs, strict=True)
        return [tame(run) for one, run in pairs if not one.at_rest]

    def groups(self) -> Float[np.ndarray, " groups"]:
        """Free-run NRMSE of every group left out."""
        return np.sqrt(self.losses())

    def coefficients(self) -> Float[np.ndarray, " columns"]:
        """Coefficients of all columns, from all groups; zero where a column is not
        chosen."""
        if self.given is not None:
            return self.given
        at, theta = self.stage.choose_columns()
        full = np.zeros(self.stage.design.equations.columns)
        full[at] = theta
        return full

    def network(self) -> Network:
        """Coefficients trained on all records."""
        leaves = tuple(leaf.region for leaf in self.stage.leaves)
        return make_network(self.stage.design, leaves, self.coefficients(), self.data)


def tame(run: Float[np.ndarray, " _"]) -> Float[np.ndarray, " _"]:
    """Replace values that are not finite by a large bound."""
    return np.clip(np.nan_to_num(run, nan=RUNAWAY_VALUE), -RUNAWAY_VALUE, RUNAWAY_VALUE)
