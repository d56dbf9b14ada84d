"""Whether a plant's model can be inverted, and where it cannot."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.data import Dataset, Finding, Findings
from jaxnarx.formatting import brief, page
from jaxnarx.inverse._reachable import Reach, reachable
from jaxnarx.inverse.dataset import Lead, target_leads
from jaxnarx.inverse.forward import dead_times, positions
from jaxnarx.inverse.linearise import (
    LocalSlopes,
    is_stable,
    local_slopes,
    static_gain,
    zeros,
)
from jaxnarx.inverse.region import Region, find_region
from jaxnarx.models import Network
from jaxnarx.settings import ActuatorLimits
from jaxnarx.solution import RESULTS, Solution

NAMED_SHARE = 0.02
"""Share of the points from which on a property is named."""
WEAK_SHARE = 0.02
"""A command is weak where its whole range moves the target by less than this share of
the target's range; gains below this share of their median count as zero."""
MAX_REST_SHARE = 0.05
"""Share of the target that a delayed inverse of a zero outside the unit circle may
miss."""
LONGEST_LEAD = 60
"""Additional lead [samples] beyond which no delayed inverse is offered."""


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Invertibility:
    """Local gains, zeros and dead times of a forward network, and what they forbid.

    Arrays run over the points (samples of the data): `place` holds the signals
    `place_names`, `gain[p, i, j]` the static gain from command j to target i (physical
    units, NaN where the linearisation is not stable), `zero` the largest modulus of a
    finite transmission zero (0 without; NaN unless there are as many commands as
    targets), `extra` the samples that a delayed inverse needs beyond the dead time
    (-1: more than 60). `dead_time[i, j]` is in samples, -1 where j never moves i.
    `lead` is what is recommended for every target. `regions` belong to `findings`, one
    each, None where a finding holds everywhere.
    """

    findings: Findings
    regions: tuple[Region | None, ...]
    command_names: tuple[str, ...]
    target_names: tuple[str, ...]
    place_names: tuple[str, ...]
    place: Float[np.ndarray, "points signals"]
    gain: Float[np.ndarray, "points targets commands"]
    zero: Float[np.ndarray, " points"]
    extra: Int[np.ndarray, " points"]
    dead_time: Int[np.ndarray, "targets commands"]
    lead: dict[str, int]
    reach: Reach | None = None

    def __str__(self) -> str:
        """Tell commands and targets, the recommended leads, then the findings."""
        targets, commands = map(", ".join, (self.target_names, self.command_names))
        ahead = ", ".join(str(self.lead[name]) for name in self.target_names)
        head = f"Invertibility: {targets} by {commands}, seen ahead by {ahead} samples"
        return f"{head}\n{self.findings}".rstrip()

    __repr__, _repr_html_ = brief, page


@guard_arguments
def invertible(
    forward: Network,
    data: Dataset,
    *,
    commands: Sequence[str],
    targets: Sequence[str],
    lead: Lead | None = None,
    references: Dataset | None = None,
    limits: ActuatorLimits | None = None,
    points: int = 600,
) -> Solution[Invertibility]:
    """Check whether `forward` has an inverse in the range of `data`.

    The network is linearised at `points` samples. Findings, by kind:

    - `gain_reversal` (error): the static gain of a command on a target, or the
      determinant of all of them, is positive at some points and negative at others. The
      same output then has several commands. The region with the rarer sign is named.
    - `non_minimum_phase`: finite zeros outside the unit circle; a warning with the lead
      that a delayed inverse needs, an error where that is beyond 60 samples more. The
      anticipation of a zero z decays as |z|^-k, so ln(20) / ln|z| samples leave 5 %.
    - `dead_time`: a note, or a warning where the given `lead` is shorter than that
      needed.
    - `weak_gain` (note): the whole range of the command moves the target by less than
      2 % of the target's range.
    - `no_effect` (error): no command moves a target.
    - `unstable` (warning): points at which the linearised network is not stable.
    - `unreachable` (warning): `references` that cannot be held at rest; `reach` then
      holds every sample's best commands, see `reachable`.

    A region is that half of one channel's range that tells the points apart best.
    Status `unidentifiable` with any error: there the inverse does not exist; else `ok`.

    Zeros: K. J. Astrom, P. Hagander, J. Sternby, Automatica 20, 1984.
    """
    u, y = positions(forward, commands, targets)
    local = local_slopes(forward, data, points=points)
    gain = static_gain(local, y, u)
    zero, extra = _outer_zeros(local, y, u)
    dead = dead_times(forward)[np.array(y)][:, np.array(u)]
    needed = _needed_lead(dead, extra, targets)
    given = (
        None
        if lead is None
        else target_leads(data, list(commands), list(targets), lead)
    )
    notes = _Notes(local, list(commands), list(targets))
    notes.effects(dead)
    notes.reversals(gain)
    notes.zeros(zero, extra, needed)
    notes.weakness(gain)
    notes.stability(is_stable(local))
    notes.dead_times(dead, needed, given)
    reach = None
    if references is not None:
        found = reachable(
            forward, references, commands=commands, targets=targets, limits=limits
        )
        reach = found.value
        if not found.is_okay:
            notes.add("warning", "unreachable", found.detail, ", ".join(targets))
    value = Invertibility(
        *notes.rank(),
        command_names=tuple(commands),
        target_names=tuple(targets),
        place_names=tuple(forward.channels.names),
        place=local.place.astype(float),
        gain=gain,
        zero=zero,
        extra=extra,
        dead_time=np.where(np.isfinite(dead), dead, -1).astype(int),
        lead=needed,
        reach=reach,
    )
    stats = {"errors": sum(f.severity == "error" for f in value.findings)}
    errors = [f for f in value.findings if f.severity == "error"]
    if errors:
        return Solution(value, RESULTS.unidentifiable, stats, errors[0].message)
    return Solution(value, RESULTS.ok, stats)


def _outer_zeros(
    local: LocalSlopes, targets: list[int], commands: list[int]
) -> tuple[Float[np.ndarray, " points"], Int[np.ndarray, " points"]]:
    """Largest modulus of a zero, and the lead that those outside ask for."""
    count = local.place.shape[0]
    if len(targets) != len(commands):
        return np.full(count, np.nan), np.zeros(count, int)
    largest, extra = np.zeros(count), np.zeros(count, int)
    for p, found in enumerate(zeros(local, targets, commands)):
        size = np.abs(found)
        largest[p] = size.max(initial=0.0)
        outside = size[size >= 1]
        if len(outside):
            nearest = float(outside.min())
            wait = math.log(1 / MAX_REST_SHARE) / math.log(max(nearest, 1 + 1e-9))
            extra[p] = math.ceil(wait) if wait <= LONGEST_LEAD else -1
    return largest, extra


def _needed_lead(
    dead: Float[np.ndarray, "targets commands"],
    extra: Int[np.ndarray, " points"],
    targets: Sequence[str],
) -> dict[str, int]:
    """Lead of every target: its dead time and what zeros ask for at most points."""
    offered = extra[extra >= 0]
    more = (
        int(np.quantile(offered, 1 - NAMED_SHARE, method="higher"))
        if len(offered)
        else 0
    )
    longest = [row[np.isfinite(row)].max(initial=0) for row in dead]
    return {name: int(d) + more for name, d in zip(targets, longest, strict=True)}


class _Notes:
    """Collects findings with their regions."""

    def __init__(self, local: LocalSlopes, commands: list[str], targets: list[str]):
        self.local, self.commands, self.targets = local, commands, targets
        names = local.network.channels.names
        self.wide = {
            n: float(np.ptp(np.quantile(local.place[:, s], [0.05, 0.95])))
            for s, n in enumerate(names)
        }
        self.found: list[tuple[Finding, Region | None]] = []

    def add(self, severity, kind, message, channel, region=None) -> None:
        """One finding."""
        self.found.append((Finding(severity, kind, message, channel), region))

    def rank(self) -> tuple[Findings, tuple[Region | None, ...]]:
        """Findings, errors first, and their regions in the same order."""
        findings = Findings(tuple(f for f, _ in self.found))
        regions = {id(f): region for f, region in self.found}
        return findings, tuple(regions[id(f)] for f in findings)

    def region(self, flag: Bool[np.ndarray, " points"]) -> Region:
        """The region of the flagged points; targets follow and are no place."""
        channels = self.local.network.channels
        use = [s for s, n in enumerate(channels.names) if n not in self.targets]
        names = [channels.all[s].label for s in use]
        return find_region(self.local.place[:, use], names, flag)

    def effects(self, dead: Float[np.ndarray, "targets commands"]) -> None:
        """Targets that no command moves."""
        for name, row in zip(self.targets, dead, strict=True):
            if not np.isfinite(row).any():
                text = (
                    f"no command ({', '.join(self.commands)}) moves {name} in the "
                    "forward model; command it by another channel"
                )
                self.add("error", "no_effect", text, name)

    def reversals(self, gain: Float[np.ndarray, "points targets commands"]) -> None:
        """Gains, and the determinant of all, that take both signs."""
        for i, target in enumerate(self.targets):
            for j, command in enumerate(self.commands):
                what = f"the static gain of {command} on {target}"
                self._reversal(gain[:, i, j], what, command)
        if len(self.targets) == len(self.commands) > 1:
            what = (
                f"the determinant of the static gains of {', '.join(self.commands)} on "
                f"{', '.join(self.targets)}"
            )
            known = np.isfinite(gain).all(axis=(1, 2))
            value = np.full(len(gain), np.nan)
            value[known] = np.linalg.det(gain[known])
            self._reversal(value, what, ", ".join(self.commands))

    def _reversal(self, value: Float[np.ndarray, " points"], what: str, channel: str):
        known = np.isfinite(value)
        if not known.any():
            return
        least = WEAK_SHARE * np.median(np.abs(value[known]))
        above, below = value > least, value < -least
        rare = above if above.sum() < below.sum() else below
        share = rare.sum() / known.sum()
        if share < NAMED_SHARE:
            return
        region = self.region(rare)
        sign = "positive" if rare is above else "negative"
        text = (
            f"{what} passes through zero: it is {sign} at {share:.0%} of the points, "
            f"{region}; confine the commands to one side, or use another channel"
        )
        self.add("error", "gain_reversal", text, channel, region)

    def zeros(self, zero, extra, needed: dict[str, int]) -> None:
        """Points with zeros outside the unit circle."""
        for flag, severity in ((extra > 0, "warning"), (extra < 0, "error")):
            if flag.mean() < NAMED_SHARE:
                continue
            region = self.region(flag) if not flag.all() else None
            where = str(region) if region is not None else "everywhere"
            leads = ", ".join(f"{n} {k} samples" for n, k in needed.items())
            offer = f"a delayed inverse needs the lead {leads}"
            if severity == "error":
                offer = (
                    f"no lead of up to {LONGEST_LEAD} samples more helps; slow it down"
                )
            text = (
                f"from {', '.join(self.commands)} to {', '.join(self.targets)} the "
                f"plant is not minimum phase at {flag.mean():.0%} of the points, "
                f"{where} (zeros of modulus up to {zero[flag].max():.3g}); {offer}"
            )
            self.add(
                severity, "non_minimum_phase", text, ", ".join(self.targets), region
            )

    def weakness(self, gain: Float[np.ndarray, "points targets commands"]) -> None:
        """Commands whose whole range hardly moves a target."""
        for i, target in enumerate(self.targets):
            for j, command in enumerate(self.commands):
                moved = np.abs(gain[:, i, j]) * self.wide[command]
                weak = moved < WEAK_SHARE * self.wide[target]
                if weak.mean() < max(NAMED_SHARE, 0.1):
                    continue
                region = self.region(weak) if not weak.all() else None
                where = str(region) if region is not None else "everywhere"
                text = (
                    f"{command} hardly moves {target} at {weak.mean():.0%} of the "
                    f"points, {where}"
                )
                self.add("note", "weak_gain", text, command, region)

    def stability(self, stable: Bool[np.ndarray, " points"]) -> None:
        """Points that say nothing about static gains."""
        if (~stable).mean() >= NAMED_SHARE:
            region = self.region(~stable) if stable.any() else None
            where = str(region) if region is not None else "everywhere"
            text = (
                f"the linearised forward model is not stable at {(~stable).mean():.0%} "
                f"of the points, {where}; static gains there are left out"
            )
            self.add("warning", "unstable", text, ", ".join(self.targets), region)

    def dead_times(self, dead, needed: dict[str, int], given: list[int] | None) -> None:
        """Note what an inverse must see ahead, and whether it does."""
        for i, target in enumerate(self.targets):
            row = dead[i]
            if not np.isfinite(row).any() or needed[target] == 0:
                continue
            each = ", ".join(
                f"{c} after {int(d)}"
                for c, d in zip(self.commands, row, strict=True)
                if np.isfinite(d)
            )
            text = (
                f"{target} answers {each} samples: an inverse needs the lead "
                f"{needed[target]}"
            )
            short = given is not None and given[i] < needed[target]
            if short and given is not None:
                text += f", it is given {given[i]}"
            self.add("warning" if short else "note", "dead_time", text, target)
