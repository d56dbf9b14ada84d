"""Terms of nested regions, filtered by the common feedback: columns of the free run.

    y(t) = s(t) + sum_(b,k) theta[b, k] [w_b p_k / A](t)

Block b holds the terms p_k times w_b, the product of the gates on the way from the root
of a tree of halvings to region b. The root has w = 1. Only the upper half of a halved
region enters: the lower one is the difference. So a term that is the same everywhere
needs one coefficient, and what is known of a region stays when it is divided. All local
models of a given partition but the last enter beside the root.
"""

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType

import numpy as np
from jaxtyping import Float, Int

from jaxnarx.models import AbstractValidity, count_models, weights_of
from jaxnarx.partition.closed_form.equations import NormalEquations
from jaxnarx.partition.closed_form.signals import RunSignals, Stretch
from jaxnarx.regressors import evaluate

GATE_WIDTH = 0.5
"""Standard deviation of the two Gaussians whose ratio a gate is, as a share of the half
region's extension; O. Nelles, "Nonlinear System Identification", 2001, 13.2.2."""
RANGE_MARGIN = 0.02
"""Share of the trained range by which predictions may leave it."""
LEVEL_STEEPNESS = 60.0
"""Steepness of a gate between levels, over their distance."""
TILE_NUMBERS = 32_768
"""Numbers that are taken through product, gates and filter together (256 kB)."""


@dataclasses.dataclass(frozen=True)
class Gate:
    """sigma(steepness (x_dim - border)), or one minus it where `side` is -1."""

    dim: int
    border: float
    steepness: float
    side: int = 1
    hard: bool = False
    """Between the levels of a variable that has few: it is not moved."""

    def __call__(self, x: Float[np.ndarray, "dims time"]) -> Float[np.ndarray, " time"]:
        a = np.clip(self.side * self.steepness * (x[self.dim] - self.border), -700, 700)
        return 1.0 / (1.0 + np.exp(-a))

    @property
    def other(self) -> "Gate":
        """The other half's."""
        return dataclasses.replace(self, side=-self.side)


@dataclasses.dataclass(frozen=True, eq=False)
class Share:
    """The weight of one local model of a partition that is given."""

    validity: AbstractValidity
    index: int

    def __call__(self, x: Float[np.ndarray, "dims time"]) -> Float[np.ndarray, " time"]:
        active = np.ones(count_models(self.validity, len(x)), bool)
        return np.asarray(weights_of(self.validity, x, active))[self.index]


Region = tuple[Gate | Share, ...]
"""The factors of a region's weight: gates on the way from the root, or the share of a
local model."""
Place = tuple[Region, Gate]
"""A gate, its upper side, behind the gates on the way to it."""


def gates_on_path(region: Region) -> Iterator[tuple[Gate, Place]]:
    """The gates on the way to a region, each with the place that both its sides have in
    common; shares are none."""
    for n, gate in enumerate(region):
        if isinstance(gate, Gate):
            yield gate, (region[:n], gate if gate.side > 0 else gate.other)


def with_gates(region: Region, gates: Mapping[Place, Gate]) -> Region:
    """The region behind other gates, given by their places; shares stay."""
    out = list(region)
    for gate, (way, upper) in gates_on_path(region):
        new = gates.get((way, upper), upper)
        out[len(way)] = new if gate.side > 0 else new.other
    return tuple(out)


def weight(region: Region, x: Float[np.ndarray, "dims time"]) -> np.ndarray:
    """Product of the factors at every sample."""
    out = np.ones(x.shape[1])
    for factor in region:
        out = out * factor(x)
    return out


@dataclasses.dataclass(frozen=True, eq=False)
class Block:
    """Filtered columns of one region at the samples that count, part by part."""

    region: Region
    terms: Int[np.ndarray, " terms"]
    columns: tuple[Float[np.ndarray, "terms _"], ...]

    @functools.cached_property
    def gram(self) -> Float[np.ndarray, "parts terms terms"]:
        """C'C of its columns C: kept, for growth offers a block again and again."""
        return np.stack([c @ c.T for c in self.columns])


@dataclasses.dataclass(frozen=True, eq=False)
class BlockDesign:
    """Blocks for one A(q), their normal equations and the targets.

    Columns of the equations are terms, block by block.
    """

    signals: RunSignals
    a: Float[np.ndarray, " _"]
    blocks: tuple[Block, ...]
    target: tuple[Float[np.ndarray, " _"], ...]
    measured: tuple[Float[np.ndarray, " _"], ...]
    equations: NormalEquations

    @classmethod
    def of(cls, signals: RunSignals, a: Float[np.ndarray, " _"]) -> "BlockDesign":
        """A design without blocks."""
        target = _group_records([_target(s, a) for s in signals.stretches])
        parts = len(target)
        empty = NormalEquations(
            np.zeros((parts, 0, 0)),
            np.zeros((parts, 0)),
            np.array([e[0] @ e[0] for e in target]),
            np.array([e.shape[1] for e in target], float),
            signals.apart,
        )
        y = _group_records(
            [_select_counted(s.y[None], s.counted) for s in signals.stretches]
        )
        own = tuple(e[0] for e in target), tuple(e[0] for e in y)
        return cls(signals, a, (), *own, empty)

    def block(
        self, region: Region, terms: Int[np.ndarray, " terms"] | None = None
    ) -> Block:
        """Columns of a region, all terms unless said; a pass over the data."""
        factor = self.signals.factor
        terms = np.arange(len(factor)) if terms is None else terms
        columns = [np.empty((len(terms), len(e))) for e in self.target]
        edges = np.zeros(len(columns), int)
        for one in self.signals.stretches:
            counts = np.array([len(at) for at in one.counted])
            ends = edges + counts
            own = [c[:, k:e] for c, k, e in zip(columns, edges, ends, strict=True)]
            self._fill(own, one, region, factor[terms])
            edges = ends
        return Block(region, terms, tuple(columns))

    def _fill(
        self,
        out: list[Float[np.ndarray, "terms _"]],
        one: Stretch,
        region: Region,
        factor: Int[np.ndarray, "terms degree"],
    ) -> None:
        """Write a stretch's columns, a few at a time, which the processor's cache
        holds from the product to the choice of samples."""
        counted, z, x = one.counted, one.z, one.x
        if len(self.a) == 1:  # no sample needs the others
            at = np.concatenate(counted)
            borders = np.cumsum([len(own) for own in counted])[:-1]
            counted = tuple(np.split(np.arange(len(at)), borders))
            z, x = z[:, at], x[:, at]
        gates = weight(region, x)[None]
        step = max(1, TILE_NUMBERS // max(z.shape[1], 1))
        for k in range(0, len(factor), step):
            raw = np.asarray(evaluate(factor[k : k + step], z)) * gates
            run = one.filter_columns(raw, self.a)
            for own, at in zip(out, counted, strict=True):
                if len(at):
                    own[k : k + step] = run[:, at]

    def select_columns(self, at: Int[np.ndarray, " chosen"]) -> "BlockDesign":
        """The design with these columns alone; blocks have the terms that are left."""
        blocks, edge = [], 0
        for block in self.blocks:
            size = len(block.terms)
            own = at[(at >= edge) & (at < edge + size)] - edge
            edge += size
            if own.size:
                own = np.sort(own)
                columns = tuple(c[own] for c in block.columns)
                blocks.append(Block(block.region, block.terms[own], columns))
        equations = self.equations.select(np.sort(at))
        return dataclasses.replace(self, blocks=tuple(blocks), equations=equations)

    def move(
        self,
        a: Float[np.ndarray, " _"],
        gates: Mapping[Place, Gate] = MappingProxyType({}),
    ) -> "BlockDesign":
        """The same columns with other feedback and gates."""
        out = BlockDesign.of(self.signals, a)
        for block in self.blocks:
            region = with_gates(block.region, gates)
            out = out.extend(out.block(region, block.terms))
        return out

    def extend(self, block: Block) -> "BlockDesign":
        """The design with one more block."""
        gram, right = self.products(block)
        top = np.concatenate([self.equations.gram, gram.transpose(0, 2, 1)], axis=2)
        low = np.concatenate([gram, block.gram], axis=2)
        equations = dataclasses.replace(
            self.equations,
            gram=np.concatenate([top, low], axis=1),
            right=np.concatenate([self.equations.right, right], axis=1),
        )
        blocks = (*self.blocks, block)
        return dataclasses.replace(self, blocks=blocks, equations=equations)

    def products(self, block: Block) -> tuple[np.ndarray, np.ndarray]:
        """C'B and C'e of a block's columns C with those of the design, B."""
        own = [c @ e for c, e in zip(block.columns, self.target, strict=True)]
        empty = np.zeros((len(own), len(block.terms), 0))
        cross = [
            np.stack([c @ b.T for c, b in zip(block.columns, one.columns, strict=True)])
            for one in self.blocks
        ]
        return np.concatenate([empty, *cross], axis=2), np.stack(own)

    def runs(
        self, theta: Float[np.ndarray, " columns"]
    ) -> list[Float[np.ndarray, " time"]]:
        """Free runs of all stretches, in standard deviations of the output."""
        pairs = zip(self.signals.stretches, self.driven(theta), strict=True)
        return [
            one.filter_columns(raw[None], self.a)[0] + one.start_response(self.a)
            for one, raw in pairs
        ]

    def driven(
        self, theta: Float[np.ndarray, " columns"]
    ) -> list[Float[np.ndarray, " time"]]:
        """The input of A(q) y in all stretches: the sum of all terms, unfiltered."""
        out = []
        for one in self.signals.stretches:
            raw, edge = np.zeros(len(one.y)), 0
            for block in self.blocks:
                own = theta[edge : edge + len(block.terms)]
                edge += len(own)
                used = np.flatnonzero(own)
                p = evaluate(self.signals.factor[block.terms[used]], one.z)
                raw += weight(block.region, one.x) * (own[used] @ np.asarray(p))
            out.append(raw)
        return out

    def held_out_losses(self, ridge: float) -> Float[np.ndarray, "2 groups"]:
        """Sum of squared errors of every group by a model made without it, and of the
        operating points at rest that are held out with it."""
        out = []
        for g in range(len(self.signals.apart)):
            theta = self.equations.exclude_group(g).solve(ridge)
            out.append(self._losses(g, theta[None])[:, 0])
        return np.stack(out, axis=1)

    def _losses(
        self, group: int, theta: Float[np.ndarray, "models columns"]
    ) -> Float[np.ndarray, "2 models"]:
        """Squared errors of a group by several models, and of its operating points."""
        out = np.zeros((2, len(theta)))
        for row, part in enumerate((group, self.signals.rest_part(group))):
            if part is not None:
                out[row] = [self.loss(part, run) for run in self.answers(part, theta)]
        return out

    def curve(
        self, ridge: float, sizes: Sequence[int], first: Sequence[int]
    ) -> Float[np.ndarray, "2 groups sizes"]:
        """The same with so many columns, chosen anew without the group."""
        out = np.empty((2, len(self.signals.apart), len(sizes)))
        for g in range(len(self.signals.apart)):
            path = self.equations.exclude_group(g).select_forward(
                ridge, max(sizes), first
            )
            theta = np.zeros((len(sizes), self.equations.columns))
            for row, size in zip(theta, sizes, strict=True):
                at, own = path.truncate(size)
                row[at] = own
            out[:, g] = self._losses(g, theta)
        return out

    def answers(
        self, group: int, theta: Float[np.ndarray, "models columns"]
    ) -> Float[np.ndarray, "models _"]:
        """Free runs of several models where samples of a group count.

        Block by block: all columns in one array would be a copy of the largest thing
        there is.
        """
        out, edge = np.tile(self.start_response(group), (len(theta), 1)), 0
        for block in self.blocks:
            own = theta[:, edge : edge + len(block.terms)]
            edge += own.shape[1]
            out += own @ block.columns[group]
        return out

    def start_response(self, group: int) -> Float[np.ndarray, " _"]:
        """The contribution of the measured start to a group's free run."""
        return self.measured[group] - self.target[group]

    def loss(self, group: int, run: Float[np.ndarray, " _"]) -> float:
        """Sum of squared errors of a group, held within the trained range."""
        return float(np.sum(self.error(group, run) ** 2))

    def error(
        self, group: int, run: Float[np.ndarray, " _"]
    ) -> Float[np.ndarray, " _"]:
        """Measured output less that of a run, held within the trained range.

        The range is that of all records, to which the final model is held: held to the
        range of the other groups, a group that goes farther would judge the limits, and
        nothing else.
        """
        to_output = self.signals.to_output
        answer = np.clip(to_output(run), *self.trained_range())
        return to_output(self.measured[group]) - answer

    def places(self, group: int) -> Int[np.ndarray, " _"]:
        """The places of a group's samples among those of all records."""
        return np.concatenate(
            [one.first + one.counted[group] for one in self.signals.stretches]
        )

    def trained_range(self) -> tuple[float, float]:
        """The range of the output in all that is measured, widened as it is in use."""
        ends = [
            min(y.min(initial=np.inf) for y in self.measured),
            max(y.max(initial=-np.inf) for y in self.measured),
        ]
        low, high = self.signals.to_output(np.array(ends)).tolist()
        return low - RANGE_MARGIN * (high - low), high + RANGE_MARGIN * (high - low)

    def scheduling_values(self) -> list[Float[np.ndarray, "dims _"]]:
        """Scheduling variables at the samples that count, part by part."""
        return _group_records(
            [_select_counted(s.x, s.counted) for s in self.signals.stretches]
        )

    def rows(self) -> list[np.ndarray]:
        """Columns at the samples that count, part by part; not to be written to."""
        if len(self.blocks) == 1:
            return list(self.blocks[0].columns)
        return [
            np.concatenate(
                [np.zeros((0, len(e))), *(b.columns[g] for b in self.blocks)]
            )
            for g, e in enumerate(self.target)
        ]


def _target(one: Stretch, a: Float[np.ndarray, " _"]) -> list[np.ndarray]:
    error = one.y - one.start_response(a)
    return _select_counted(error[None], one.counted)


def _select_counted(rows: np.ndarray, counted) -> list[np.ndarray]:
    return [rows[:, at] for at in counted]


def _group_records(parts: list[list[np.ndarray]]) -> list[np.ndarray]:
    """The groups of all records from those of each."""
    return [np.concatenate(own, axis=1) for own in zip(*parts, strict=True)]
