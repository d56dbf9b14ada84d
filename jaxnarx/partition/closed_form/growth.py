"""Regions by halving, judged by the free run of groups left out."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from jaxnarx.models import AbstractValidity, count_models
from jaxnarx.partition.closed_form.design_matrix import (
    GATE_WIDTH,
    LEVEL_STEEPNESS,
    Block,
    BlockDesign,
    Gate,
    Place,
    Region,
    Share,
    gates_on_path,
    with_gates,
)
from jaxnarx.partition.stages import BestStage

RIDGES_TRIED = (1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
COARSE_RIDGES = 1e-4, 1e-2
"""Ridges tried for one region: it cannot tell what regions will make of its feedback,
and finer ones rank by chance."""
HALVINGS_TRIED = 3
"""Halvings that are tried with all terms, of those that gain most with linear ones: on
CO2 and exhaust temperature of a measured engine half the time for errors as small."""
SIZES_TRIED = (
    *(1, 2, 3, 4, 6, 8, 11, 15, 20, 27, 36, 48, 64, 85, 110, 140, 180, 220, 260, 320),
    *(380, 450),
)
"""Numbers of columns that are tried."""


@dataclasses.dataclass(frozen=True, eq=False)
class Box:
    """A region and the box it covers, in scheduling variables from 0 to 1."""

    region: Region
    low: Float[np.ndarray, " dims"]
    high: Float[np.ndarray, " dims"]

    def move(self, gates: Mapping[Place, Gate]) -> "Box":
        """The same leaf behind other gates; the box follows the borders."""
        region = with_gates(self.region, gates)
        low, high = np.zeros_like(self.low), np.ones_like(self.high)
        for gate, _ in gates_on_path(region):
            if gate.side > 0:
                low[gate.dim] = max(low[gate.dim], gate.border)
            else:
                high[gate.dim] = min(high[gate.dim], gate.border)
        return Box(region, low, high)

    def halve(self, gate: Gate) -> tuple["Box", "Box"]:
        """Upper and lower half."""
        low, high = self.low.copy(), self.high.copy()
        low[gate.dim] = high[gate.dim] = gate.border
        upper = Box((*self.region, gate), low, self.high)
        return upper, Box((*self.region, gate.other), self.low, high)

    def gate(self, dim: int, levels: Sequence[float] | None) -> Gate | None:
        """The gate that halves the box across a variable, between levels if any."""
        if levels is not None:
            inside = [v for v in levels if self.low[dim] <= v <= self.high[dim]]
            if len(inside) < 2:
                return None
            middle = len(inside) // 2
            below, above = inside[middle - 1 : middle + 1]
            return Gate(
                dim, (below + above) / 2, LEVEL_STEEPNESS / (above - below), hard=True
            )
        extent = self.high[dim] - self.low[dim]
        return Gate(dim, self.low[dim] + extent / 2, 2 / (GATE_WIDTH**2 * extent))


@dataclasses.dataclass(frozen=True, eq=False)
class GrownStage:
    """One partition with the number of columns and the ridge that serve it best."""

    design: BlockDesign
    leaves: tuple[Box, ...]
    losses: Float[np.ndarray, " groups"]
    """Sum of squared errors of every group left out."""
    size: int
    ridge: float
    rest_loss: float = 0.0
    """Sum of squared errors of operating points that were held out with the groups."""

    @property
    def error(self) -> float:
        """Root mean square error of the groups left out, in standard deviations."""
        count = self.design.equations.judged.sum()
        return float(np.sqrt(self.losses.sum() / max(count, 1.0)))

    @property
    def score(self) -> float:
        """The same of groups and operating points, by which stages are compared."""
        own, points = self.design.equations, 0.0
        if self.design.signals.has_rest:
            points = own.samples[-len(own.apart) :].sum()
        count = max(own.judged.sum() + points, 1.0)
        return float(np.sqrt((self.losses.sum() + self.rest_loss) / count))

    def held_out_runs(self) -> list[Float[np.ndarray, " _"]]:
        """Free runs over every group by a model made without it, not held."""
        out = []
        for g in range(len(self.losses)):
            theta = np.zeros((1, self.design.equations.columns))
            at, own = self.choose_columns(g)
            theta[0, at] = own
            out.append(self.design.answers(g, theta)[0])
        return out

    def choose_columns(
        self, without: int | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Columns and coefficients from all groups, or without one."""
        system = self.design.equations.exclude_group(without)
        first = constants(self.design)
        return system.select_forward(self.ridge, self.size, first).truncate(self.size)


def constants(design: BlockDesign) -> list[int]:
    """The constant, which every model has."""
    rows = np.asarray(design.signals.factor)
    return np.flatnonzero(np.all(rows == 0, axis=1))[:1].tolist()


def choose_size(
    design: BlockDesign,
    leaves: tuple[Box, ...],
    ridges: Sequence[float] = COARSE_RIDGES,
    *,
    search: bool = False,
) -> GrownStage:
    """Number of columns and ridge by the groups left out.

    The best of these ridges; with `search` from there on to the next smaller and larger
    ones of `RIDGES_TRIED` for as long as the groups gain.
    """
    equations = design.equations
    most = min(equations.columns, int(equations.samples.sum() / 8))
    sizes = [s for s in SIZES_TRIED if s < most] + [min(most, SIZES_TRIED[-1])]
    first = constants(design)

    @functools.cache
    def stage(place: int) -> GrownStage:
        curve = design.curve(RIDGES_TRIED[place], sizes, first)
        n = int(curve.sum(axis=(0, 1)).argmin())
        losses, points = curve[:, :, n]
        size, ridge = sizes[n], RIDGES_TRIED[place]
        return GrownStage(design, leaves, losses, size, ridge, float(points.sum()))

    at = min(
        (RIDGES_TRIED.index(ridge) for ridge in ridges), key=lambda n: stage(n).score
    )
    for way in (-1, 1) if search else ():
        while 0 <= at + way < len(RIDGES_TRIED):
            if stage(at + way).score >= stage(at).score:
                break
            at += way
    return stage(at)


def grow_regions(
    start: GrownStage,
    *,
    max_models: int,
    levels: Sequence[Sequence[float] | None],
    patience: int = 3,
) -> list[GrownStage]:
    """One more region a stage; those that no halving improves end it."""
    stages, kept, looks = [start], {}, {}
    best = BestStage(0, start.score)
    while best.going and len(stages[-1].leaves) < max_models:
        last = stages[-1]
        tried = _try_halvings(last, levels, kept, looks)
        if not tried:
            break
        _, n, gate, block = min(tried, key=lambda one: one[0])
        leaf = last.leaves[n]
        upper, lower = leaf.halve(gate)
        leaves = (*last.leaves[:n], lower, *last.leaves[n + 1 :], upper)
        for blocks in (kept, looks):
            for region in [r for r in blocks if r[:-1] == leaf.region]:
                del blocks[region]
        stage = choose_size(
            last.design.extend(block), leaves, (last.ridge,), search=True
        )
        best = best.update(len(stages), stage.score, patience)
        stages.append(stage)
    return stages


def divide_by(start: GrownStage, validity: AbstractValidity) -> GrownStage:
    """A single region divided as a partition says, with the same feedback."""
    design, (whole,) = start.design, start.leaves
    shares = [Share(validity, m) for m in range(count_models(validity, len(whole.low)))]
    for share in shares[:-1]:
        design = design.extend(design.block((share,)))
    leaves = tuple(Box((share,), whole.low, whole.high) for share in shares)
    return choose_size(design, leaves, (start.ridge,), search=True)


def _try_halvings(
    stage: GrownStage,
    levels: Sequence[Sequence[float] | None],
    kept: dict[Region, Block],
    looks: dict[Region, Block],
) -> list[tuple[float, int, Gate, Block]]:
    """Loss of halvings, with the chosen columns and all of the new block: of those that
    gain most with linear terms alone, which cost a fraction."""
    at, _ = stage.choose_columns()
    small, found = stage.design.select_columns(at), []
    factor = np.asarray(stage.design.signals.factor)
    linear = np.flatnonzero((factor > 0).sum(axis=1) < 2)
    for n, leaf in enumerate(stage.leaves):
        for dim, own in enumerate(levels):
            gate = leaf.gate(dim, own)
            if gate is None:
                continue
            region = (*leaf.region, gate)
            if region not in looks:
                looks[region] = stage.design.block(region, linear)
            loss = _loss_with_block(small, looks[region], stage.ridge)
            found.append((loss, n, gate, region))
    found.sort(key=lambda one: one[0])
    tried = []
    for _, n, gate, region in found[:HALVINGS_TRIED]:
        if region not in kept:
            kept[region] = stage.design.block(region)
        block = kept[region]
        loss = _loss_with_block(small, block, stage.ridge)
        tried.append((loss, n, gate, block))
    return tried


def _loss_with_block(small: BlockDesign, block: Block, ridge: float) -> float:
    return float(small.extend(block).held_out_losses(ridge).sum())
