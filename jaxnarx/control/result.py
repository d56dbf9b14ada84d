"""What a controller has made of a plant."""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.data import Channel
from jaxnarx.formatting import align_columns, brief, count, page
from jaxnarx.metrics import nrmse

NEAR = 1e-9
"""Share of a command's range within which a bound counts as reached."""


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class ControlledRun:
    """Commands and outputs of a closed loop, one array per record, physical units.

    `outputs` are those of the plant that the controller's network computes, without the
    noise of `measured`; `references` those of the `targets`. `disturbances` are what
    the observer has added to the network's outputs. `floor` and `ceiling` are limits
    of the outputs, infinite where there is none, `low` and `high` bounds of the
    commands, `move` their largest change a sample. `solved` marks samples whose
    quadratic program was solved, `restarted` those at which the network's run had come
    to its bounds and began anew from what was measured.
    """

    command_channels: tuple[Channel, ...]
    output_channels: tuple[Channel, ...]
    targets: tuple[int, ...]
    names: tuple[str, ...]
    sample_time: float
    commands: tuple[Float[np.ndarray, "time commands"], ...]
    outputs: tuple[Float[np.ndarray, "time outputs"], ...]
    measured: tuple[Float[np.ndarray, "time outputs"], ...]
    references: tuple[Float[np.ndarray, "time targets"], ...]
    disturbances: tuple[Float[np.ndarray, "time outputs"], ...]
    solved: tuple[Bool[np.ndarray, " time"], ...]
    restarted: tuple[Bool[np.ndarray, " time"], ...]
    low: Float[np.ndarray, " commands"]
    high: Float[np.ndarray, " commands"]
    move: Float[np.ndarray, " commands"]
    floor: Float[np.ndarray, " outputs"]
    ceiling: Float[np.ndarray, " outputs"]

    @property
    def target_names(self) -> tuple[str, ...]:
        """Names of the targets."""
        return tuple(self.output_channels[o].name for o in self.targets)

    def nrmse(self, skip: int = 0) -> Float[np.ndarray, " targets"]:
        """Tracking error of every target over all records: its root mean square over
        the standard deviation of the reference; without the first `skip` samples of
        every record."""
        own = list(self.targets)
        wanted = np.concatenate([r[skip:] for r in self.references])
        reached = np.concatenate([y[skip:, own] for y in self.outputs])
        return np.asarray(nrmse(wanted, reached, np.isfinite(reached)))

    def excess(self) -> Float[np.ndarray, "samples outputs"]:
        """By how much outputs are beyond their limits, all samples; zero within."""
        y = np.concatenate(self.outputs)
        over = np.maximum(y - self.ceiling[None], self.floor[None] - y)
        return np.maximum(over, 0.0)

    def share_kept(self, skip: int = 0) -> float:
        """Share of the samples in which all limits are kept, without the first `skip`
        of every record; NaN where no sample is left."""
        over = np.split(self.excess(), np.cumsum([len(y) for y in self.outputs])[:-1])
        within = [np.all(one[skip:] == 0, axis=1) for one in over]
        every = np.concatenate(within)
        return float(np.mean(every)) if len(every) else float("nan")

    @property
    def command_names(self) -> tuple[str, ...]:
        """Names of the commands."""
        return tuple(c.name for c in self.command_channels)

    @property
    def at_range(self) -> tuple[Bool[np.ndarray, "time commands"], ...]:
        """Where a command stands at one of its bounds, by record."""
        near = NEAR * (self.high - self.low)[None]
        return tuple(
            (u <= self.low[None] + near) | (u >= self.high[None] - near)
            for u in self.commands
        )

    @property
    def at_rate(self) -> tuple[Bool[np.ndarray, "time commands"], ...]:
        """Where a command moves as fast as it may, by record."""
        most = (self.move - NEAR * (self.high - self.low))[None]
        return tuple(
            np.abs(np.diff(u, axis=0, prepend=u[:1])) >= most for u in self.commands
        )

    def at_bounds(self) -> Float[np.ndarray, " commands"]:
        """Share of samples in which a command stands at one of its bounds."""
        return np.concatenate(self.at_range).mean(axis=0)

    @property
    def restarts(self) -> int:
        """How often the network's run began anew, over all records."""
        return sum(int(r.sum()) for r in self.restarted)

    def __str__(self) -> str:
        """Tracking errors, limits and commands."""
        errors = self.nrmse()
        rows = [("target", "NRMSE", "mean error", "")]
        for k, (o, error) in enumerate(zip(self.targets, errors, strict=True)):
            wanted = np.concatenate(self.references)[:, k]
            mean = float(np.mean(np.concatenate(self.outputs)[:, o] - wanted))
            own = self.output_channels[o]
            rows.append((own.name, f"{error:.4f}", f"{mean:.3g}", own.unit))
        parts = ["Closed loop", *align_columns(rows)]
        over = self.excess()
        for o, own in enumerate(self.output_channels):
            edges = self.floor[o], self.ceiling[o]
            if np.isfinite(edges).any():
                told = " and ".join(
                    f"{word} {edge:g}"
                    for word, edge in zip(("at least", "at most"), edges, strict=True)
                    if np.isfinite(edge)
                )
                unit = f" {own.unit}" if own.unit else ""
                parts.append(
                    f"{own.name} {told}{unit}: kept in "
                    f"{100 * np.mean(over[:, o] == 0):.2f} % of samples, broken by "
                    f"{over[:, o].max():.3g} at most"
                )
        for own, share in zip(self.command_channels, self.at_bounds(), strict=True):
            parts.append(f"{own.name}: at a bound in {100 * share:.1f} % of samples")
        if self.restarts:
            told = count(self.restarts, "time")
            parts.append(f"the network's run began anew {told}")
        return "\n".join(parts)

    def to_dict(self) -> dict[str, Any]:
        """Figures as JSON has them."""
        return {
            "nrmse": dict(zip(self.target_names, self.nrmse().tolist(), strict=True)),
            "kept": {
                own.name: float(np.mean(self.excess()[:, o] == 0))
                for o, own in enumerate(self.output_channels)
                if np.isfinite([self.floor[o], self.ceiling[o]]).any()
            },
            "restarts": self.restarts,
            "at_bounds": {
                own.name: float(share)
                for own, share in zip(
                    self.command_channels, self.at_bounds(), strict=True
                )
            },
        }

    __repr__, _repr_html_ = brief, page
