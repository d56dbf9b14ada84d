"""Candidates in closed form, in order: linear models first, regions with products last.

Every candidate is judged by the free run of groups of records left out, which the
normal equations of the simulation error give without another pass over the data.
"""

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxnarx.data import Dataset, Groups
from jaxnarx.models import AbstractValidity, RestPairs, count_models
from jaxnarx.partition.closed_form.denominator import (
    denominator_from_times,
    is_stable,
    limit_poles,
)
from jaxnarx.partition.closed_form.design_matrix import Block, BlockDesign
from jaxnarx.partition.closed_form.equation_error import equation_error
from jaxnarx.partition.closed_form.gauss_newton import (
    movable_gates,
    move_feedback_and_gates,
)
from jaxnarx.partition.closed_form.growth import (
    Box,
    GrownStage,
    choose_size,
    divide_by,
    grow_regions,
)
from jaxnarx.partition.closed_form.model import ClosedForm, ClosedStructure, tame
from jaxnarx.partition.closed_form.physics import (
    LEAST_VIOLATION,
    constrain,
    rises,
)
from jaxnarx.partition.closed_form.profile import DataProfile
from jaxnarx.partition.closed_form.rest import add_rest, rest_points
from jaxnarx.partition.closed_form.signals import RunSignals, make_signals
from jaxnarx.partition.closed_form.terms import (
    Memory,
    choose_scheduling,
    linear_pool,
    product_pool,
)
from jaxnarx.partition.fixed import ask_partition
from jaxnarx.settings import Partitioner

LARGEST_ORDER = 4
"""Largest order of A(q)."""
FEEDBACK_RIDGE = 1e-4
"""Ridge while the feedback of linear models is sought."""
FILTERED_FAMILIES = "filtered inputs", "OE with filtered inputs"
SCALES_TRIED = 5
"""Scales of lags and filters that are tried, each twice the last one."""
ROUND_ERROR_SHARE = 0.995
"""Share of the error that must be left at most for another round."""
NEARLY_BEST_FACTOR, FEWEST_FACTOR = 1.1, 1.03
"""Error of a partition, over that of the best, up to which the gates of the one with
the most regions are moved too, and of the one with the fewest."""
OF_ROOT = ", root"
"""Behind the family of candidates that model a root of the output."""
GROWN_ROOTS = 2
"""How many of the polynomials are grown."""


Root = tuple[int, int, ClosedForm]
"""Step of the lags, order of the feedback, and the candidate."""


class ClosedSearch:
    """Candidates for one output; what several of them need is formed once."""

    def __init__(
        self,
        data: Dataset,
        profile: DataProfile,
        groups: Groups,
        *,
        root: bool = False,
        pairs: RestPairs | None = None,
        longest: float | int | None = None,
        at_rest: Dataset | None = None,
    ):
        """With `root` a root of the output is modelled; all errors are those of the
        output. With `pairs` the output of every candidate rises along them at rest.
        Feedback and filters have no time constant beyond `longest` [s]. Samples of
        `at_rest` are operating points that train too."""
        self.data, self.profile, self.groups = data, profile, groups
        self.points = None if at_rest is None else rest_points(at_rest, profile.output)
        self.modelled_root, self.pairs = root, pairs
        self.longest = np.inf if longest is None else longest / data.sample_time
        """The longest time constant [samples]."""
        self.known: dict[tuple[Memory, int], RunSignals] = {}
        self.roots: list[ClosedForm] = []
        """The polynomials that `candidates` has divided."""
        self.grown: tuple[ClosedStructure, list[GrownStage]] | None = None
        """The last structure that `repeat` has divided, and all its partitions."""

    def signals(self, memory: Memory, degree: int) -> RunSignals:
        """Variables and terms of a memory."""
        key = memory, degree
        if key not in self.known:
            pool = linear_pool(self.data, self.profile, memory)
            if degree > 1:
                pool = product_pool(pool, self.profile, memory, degree)
            table = choose_scheduling(self.data, self.profile, memory)
            signals = make_signals(
                self.data,
                pool,
                table,
                *self.groups.parts(),
                history=LARGEST_ORDER,
                every=self.profile.every,
                begin=self.profile.begin,
                root=self.modelled_root,
                least=np.inf if self.points is None else self.points.least,
                largest_pole=self.largest_pole,
            )
            if self.points is not None:
                signals = add_rest(signals, self.points, self.profile.memory)
            self.known = {key: signals}
        return self.known[key]

    def memory(self, step: int) -> Memory:
        """Lags and filters in this scale."""
        own = self.profile.reach, self.profile.memory
        return Memory.of(step, *own, longest=self.longest)

    @property
    def largest_pole(self) -> float:
        """The modulus of the poles of the feedback at most."""
        return np.inf if np.isinf(self.longest) else float(np.exp(-1 / self.longest))

    def make_candidate(
        self, family: str, name: str, stage: GrownStage, structure: ClosedStructure
    ) -> ClosedForm:
        """A candidate."""
        if self.modelled_root:
            family += OF_ROOT
        return ClosedForm(family, name, stage, self.data, structure)

    def root(
        self,
        signals: RunSignals,
        a: Float[np.ndarray, " _"],
        *,
        search: bool = True,
    ) -> GrownStage:
        """One region with this feedback; the ridge is a coarse one or searched."""
        design = BlockDesign.of(signals, a)
        design = design.extend(design.block(()))
        dims = len(signals.scheduling)
        leaf = Box((), np.zeros(dims), np.ones(dims))
        return choose_size(design, (leaf,), search=search)

    def retune(
        self, stage: GrownStage, *, gates: bool = False, most: int = 1
    ) -> GrownStage:
        """The same regions with the feedback (and gates) that suit them best.

        This repeats as long as the held-out groups gain: every time columns are chosen
        anew.
        """
        for _ in range(most):
            new = self._retune_once(stage, gates)
            if new is None or new.score > ROUND_ERROR_SHARE * stage.score:
                return stage if new is None or new.score > stage.score else new
            stage = new
        return stage

    def _retune_once(self, stage: GrownStage, gates: bool) -> GrownStage | None:
        at, _ = stage.choose_columns()
        start = stage.design.select_columns(at)
        end = move_feedback_and_gates(start, stage.ridge, gates=gates)[0]
        if end is start:
            return None
        pairs = zip(movable_gates(start), movable_gates(end), strict=True)
        gate_of = {old: new[1] for old, new in pairs}
        moved = stage.design.move(end.a, gate_of)
        leaves = tuple(leaf.move(gate_of) for leaf in stage.leaves)
        return choose_size(moved, leaves, (stage.ridge,), search=True)

    def constant(self) -> ClosedForm:
        """The mean."""
        signals = self.signals(Memory(1, (0,), ()), 1)
        design = BlockDesign.of(signals, np.ones(1))
        place = np.flatnonzero(np.all(signals.factor == 0, axis=1))
        design = design.extend(design.block((), place))
        dims = len(signals.scheduling)
        leaf = Box((), np.zeros(dims), np.ones(dims))
        losses, points = design.held_out_losses(0.0)
        stage = GrownStage(design, (leaf,), losses, 1, 0.0, float(points.sum()))
        return self.make_candidate("constant", "mean", stage, ClosedStructure())

    def linear(self) -> Iterator[ClosedForm]:
        """Output-error models of rising order without filters (OE)."""
        last = np.ones(1)
        for order in range(1, LARGEST_ORDER + 1):
            signals = self.signals(Memory(1, tuple(range(order + 2)), ()), 1)
            a = self.feedback(signals, order, last)
            stage = self.root(signals, a)
            last = a
            yield self.make_candidate(
                "OE", f"order {order}", stage, ClosedStructure(order)
            )

    def feedback(
        self, signals: RunSignals, order: int, last: Float[np.ndarray, " _"]
    ) -> Float[np.ndarray, " _"]:
        """A(q) of linear terms: the best of several starts, tuned."""
        starts = [
            limit_poles(a, self.largest_pole)
            for a in self._starts(signals, order, last)
        ]
        starts = [a for a in starts if is_stable(a)]
        every = []
        for a in starts:
            design = BlockDesign.of(signals, a)
            design = design.extend(design.block(()))
            every.append(move_feedback_and_gates(design, FEEDBACK_RIDGE, steps=1))
        every.sort(key=lambda one: one[1])
        return min(
            (move_feedback_and_gates(one, FEEDBACK_RIDGE) for one, _ in every[:2]),
            key=lambda one: one[1],
        )[0].a

    def _starts(self, signals: RunSignals, order: int, last) -> Iterator[np.ndarray]:
        if len(last) == order + 1:
            yield last
        elif len(last) == order:
            yield np.convolve(last, [1.0, -0.3])
            yield np.convolve(last, [1.0, -0.9])
        yield equation_error(signals, order)[0]
        unit = self.data.sample_time
        rise, slow = max(self.profile.rise, 1.0), max(self.profile.memory / 3, 2.0)
        times = [rise, float(np.sqrt(rise * slow)), slow] if order <= 2 else [slow]
        for time in dict.fromkeys(times):
            yield denominator_from_times(
                [time * unit / 3**k for k in range(order)], unit
            )

    def search_filters(self, orders: dict[int, np.ndarray]) -> Iterator[ClosedForm]:
        """Linear terms at lags and through filters, without feedback and with it."""
        memory = self.memory(max(1, round(self.profile.rise / 4)))
        signals = self.signals(memory, 1)
        for order in (0, 1):
            a = self.feedback(signals, order, orders[order]) if order else np.ones(1)
            stage, name = self.root(signals, a), describe_memory(memory, a)
            structure = ClosedStructure(order)
            yield self.make_candidate(FILTERED_FAMILIES[order], name, stage, structure)

    def polynomials(
        self, orders: dict[int, np.ndarray], degree: int
    ) -> tuple[list[Root], list[Root]]:
        """Products in several scales of lags and filters, with several feedbacks; best
        first, with a coarse ridge and with the one that serves them best.

        The best single region need not be the best when it is divided: some of both
        orders are grown.
        """
        known = self.profile
        most = max(min(known.rise, known.reach), known.memory / 64, 1.0)
        step = max(1, 2 ** int(np.log2(most) - SCALES_TRIED + 1))
        coarse, fine = [], []
        while step <= most:
            memory = self.memory(step)
            signals = self.signals(memory, degree)
            for order, a in ((0, np.ones(1)), (1, orders[1]), (2, orders[2])):
                stage = self.root(signals, a, search=False)
                name = f"degree {degree}, {describe_memory(memory, a)}"
                own = ClosedStructure(order, step, degree)
                found = self.make_candidate("polynomial", name, stage, own)
                coarse.append((step, order, found))
                stage, own = _with_ridge(stage), dataclasses.replace(own, fine=True)
                found = dataclasses.replace(found, stage=stage, structure=own)
                fine.append((step, order, found))
            step *= 2
        return _rank(coarse), _rank(fine)

    @property
    def spread(self) -> float:
        """Standard deviation of the output, in its unit."""
        (one,) = self.known.values()
        return one.output_spread

    def constrain(self, form: ClosedForm) -> ClosedForm:
        """The candidate under the signs of physics, where there are some."""
        return form if self.pairs is None else constrain(form, self.pairs)

    def candidates(
        self, max_models: int, degree: int = 2, grown_roots: int = GROWN_ROOTS
    ) -> Iterator[ClosedForm]:
        """Candidates from the mean to regions, cheap ones first; of a root output-error
        models and what follows.

        Structures are grown without constraints; what is judged and kept has them. One
        whose constrained coefficients cannot be found is left out.
        """
        for form in self._grow_all(max_models, degree, grown_roots):
            try:
                signed = self.constrain(form)
            except np.linalg.LinAlgError:
                continue
            yield signed

    def _grow_all(
        self, max_models: int, degree: int, grown_roots: int
    ) -> Iterator[ClosedForm]:
        if not self.modelled_root:
            yield self.constant()
            for order in (1, 2, 3):
                yield self.equation_error(order)
        orders = {}
        for one in self.linear():
            orders[len(one.stage.design.a) - 1] = one.stage.design.a
            yield one
        yield from self.search_filters(orders)
        if degree < 2:
            return
        coarse, fine = self.polynomials(orders, degree)
        yield from (one[2] for one in _distinct(fine, lambda one: one[1]))
        for root in _choose_to_grow(coarse, fine)[:grown_roots]:
            stage = self.retune(root.stage)
            if stage is not root.stage:
                own = dataclasses.replace(root.structure, feedback=True)
                root = dataclasses.replace(root, stage=stage, structure=own)
                yield dataclasses.replace(root, name=f"{root.name}, feedback moved")
            self.roots.append(root)
            levels = self.levels(root.stage.design.signals)
            stages = grow_regions(root.stage, max_models=max_models, levels=levels)
            best = int(np.argmin([one.score for one in stages]))
            if best:
                for stage in stages[1 : best + 1]:
                    if len(stage.leaves) % 2 == 0 or stage is stages[best]:
                        yield self.make_divided(root, stage)
            for stage in _choose_to_move(stages, best):
                end = self.retune(stage, gates=True, most=3)
                if end is not stage:
                    yield self.make_divided(root, end, gates=True)

    def repeat(
        self,
        family: str,
        structure: ClosedStructure,
        partitions: Mapping[str, Partitioner],
    ) -> ClosedForm:
        """A candidate made once more, of the records of this search.

        Its structure stays: what it is made of, the number of regions, the step of the
        lags. Feedback, halvings, gates, the number of columns and their ridge are
        chosen anew.
        """
        return self.constrain(self._make_again(family, structure, partitions))

    def _make_again(
        self,
        family: str,
        structure: ClosedStructure,
        partitions: Mapping[str, Partitioner],
    ) -> ClosedForm:
        family, order = family.removesuffix(OF_ROOT), structure.order
        if family == "constant":
            return self.constant()
        if family == "ARX":
            return self.equation_error(order)
        if family == "shared feedback" and not structure.partition:
            stage = self._grow_again(structure)
            if structure.gates:
                stage = self.retune(stage, gates=True, most=3)
            return self.make_candidate(family, "", stage, structure)
        linear = list(itertools.islice(self.linear(), max(order, 1)))
        if family == "OE":
            return linear[order - 1]
        if family in FILTERED_FAMILIES:
            return list(self.search_filters(_feedbacks(linear)))[order]
        stage = self._polynomial_again(structure)
        if structure.partition:
            partition = partitions[structure.partition]
            stage = divide_by(stage, _ask(partition, stage.design))
        return self.make_candidate(family, "", stage, structure)

    def _polynomial_again(self, structure: ClosedStructure) -> GrownStage:
        """One region of `repeat`."""
        linear = itertools.islice(self.linear(), max(structure.order, 1))
        a = _feedbacks(linear)[structure.order]
        signals = self.signals(self.memory(structure.step), structure.degree)
        stage = self.root(signals, a, search=False)
        stage = _with_ridge(stage) if structure.fine else stage
        return self.retune(stage) if structure.feedback else stage

    def _grow_again(self, structure: ClosedStructure) -> GrownStage:
        """So many regions of `repeat`. They are kept: fewer are among them."""
        known = None if self.grown is None else self.grown[0]
        if (
            known is None
            or known.undivided() != structure.undivided()
            or known.models < structure.models
        ):
            stage = self._polynomial_again(structure)
            levels = self.levels(stage.design.signals)
            stages = grow_regions(stage, max_models=structure.models, levels=levels)
            self.grown = structure, stages
        assert self.grown is not None
        stages = self.grown[1]
        return stages[min(structure.models, len(stages)) - 1]

    def divide_by_partition(
        self, name: str, partition: Partitioner
    ) -> Iterator[ClosedForm]:
        """The polynomials of `roots`, divided by a partition from elsewhere.

        It is given the terms filtered by the feedback and the output that they are to
        explain, so that its residual is that of the free run.
        """
        for root in self.roots:
            validity = _ask(partition, root.stage.design)
            if count_models(validity, len(root.stage.design.signals.scheduling)) > 1:
                stage = divide_by(root.stage, validity)
                yield self.constrain(self.make_divided(root, stage, partition=name))

    def make_divided(
        self,
        root: ClosedForm,
        stage: GrownStage,
        *,
        gates: bool = False,
        partition: str = "",
    ) -> ClosedForm:
        """A candidate of several regions; with `gates` these have moved."""
        name = f"{len(stage.leaves)} regions, {root.name}"
        name += ", gates moved" * gates + f", {partition}" * bool(partition)
        structure = dataclasses.replace(
            root.structure, models=len(stage.leaves), gates=gates, partition=partition
        )
        return self.make_candidate("shared feedback", name, stage, structure)

    def levels(self, signals: RunSignals) -> list[tuple[float, ...] | None]:
        """The levels of scheduling variables with few values, scaled as they are."""
        out = []
        scales = zip(signals.offset, signals.span, strict=True)
        entries = zip(signals.scheduling.entries, scales, strict=True)
        for (signal, _, filter_), (offset, span) in entries:
            own = self.profile.levels[signal] if filter_ is None else None
            out.append(own and tuple(float((v - offset) / span) for v in own))
        return out

    def equation_error(self, order: int) -> ClosedForm:
        """Least squares one step ahead (ARX), run freely."""
        signals = self.signals(Memory(1, tuple(range(order + 1)), ()), 1)
        free = self._equation_error(signals, order, None)
        if self.pairs is None:
            return free
        rows = rises(_bare(signals, np.ones(1)), self.pairs)
        signed = self._equation_error(signals, order, rows)
        return dataclasses.replace(
            signed,
            unconstrained=free.free_run,
            turned=self.pairs.count(rows @ free.coefficients() < -LEAST_VIOLATION),
        )

    def _equation_error(
        self,
        signals: RunSignals,
        order: int,
        signs: Float[np.ndarray, "pairs columns"] | None,
    ) -> ClosedForm:
        dims, losses, left = len(signals.scheduling), [], []
        # What is fitted one step ahead may run away: inf then, and held to the range.
        with np.errstate(all="ignore"):
            for g in range(len(self.groups)):
                a, theta = equation_error(signals, order, without=g, signs=signs)
                bare = _bare(signals, a)
                left.append(tame(_group_places(signals, bare.runs(theta), g)))
                losses.append(bare.loss(g, left[-1]))
            a, theta = equation_error(signals, order, signs=signs)
            bare = _bare(signals, a)
        leaf = Box((), np.zeros(dims), np.ones(dims))
        stage = GrownStage(bare, (leaf,), np.array(losses), len(theta), 0.0)
        own = ClosedStructure(order)
        return ClosedForm("ARX", f"order {order}", stage, self.data, own, theta, left)


def _with_ridge(stage: GrownStage) -> GrownStage:
    """The same with the ridge that serves it best."""
    return choose_size(stage.design, stage.leaves, (stage.ridge,), search=True)


def _ask(partition: Partitioner, design: BlockDesign) -> AbstractValidity:
    """The validity that a partition from elsewhere makes of a single region."""
    # Operating points at rest may lie outside of the records.
    x = np.clip(np.concatenate(design.scheduling_values(), axis=1), 0.0, 1.0)
    columns = np.concatenate(design.blocks[0].columns, axis=1)
    output = np.concatenate(design.target)
    return ask_partition(partition, x, columns, output, np.ones(len(output)))


def _rank(every: list[Root]) -> list[Root]:
    return sorted(every, key=lambda one: one[2].stage.score)


def _distinct(ranked: list[Root], kind: Callable[[Root], Any]) -> list[Root]:
    """The best of every kind, best first."""
    seen: dict[Any, Root] = {}
    for one in ranked:
        seen.setdefault(kind(one), one)
    return list(seen.values())


def _choose_to_grow(coarse: list[Root], fine: list[Root]) -> list[ClosedForm]:
    """The best of every scale, of both orders in turn."""
    both = (_distinct(ranked, lambda one: one[0]) for ranked in (coarse, fine))
    turns = [one for pair in zip(*both, strict=True) for one in pair]
    return [one[2] for one in _distinct(turns, lambda one: one[:2])]


def _choose_to_move(stages: list[GrownStage], best: int) -> list[GrownStage]:
    """The best, the one with the most regions that is nearly as good, for halvings may
    gain little before their gates have moved, and the one with the fewest: what the
    last halvings gain they often owe to having been chosen by the groups that judge."""
    scores, least = np.array([one.score for one in stages]), stages[best].score
    most = int(np.flatnonzero(scores <= NEARLY_BEST_FACTOR * least).max())
    fewest = int(np.flatnonzero(scores <= FEWEST_FACTOR * least).min())
    return [stages[n] for n in dict.fromkeys((best, most, fewest)) if n]


def _feedbacks(linear: Iterable[ClosedForm]) -> dict[int, Float[np.ndarray, " _"]]:
    """A(q) of linear models by their orders, from zero on."""
    every = (one.stage.design.a for one in linear)
    return {0: np.ones(1)} | dict(enumerate(every, 1))


def describe_memory(memory: Memory, a: Float[np.ndarray, " _"]) -> str:
    """Memory and order in words."""
    return f"order {len(a) - 1}, {memory}"


def _bare(signals: RunSignals, a: Float[np.ndarray, " _"]) -> BlockDesign:
    """One region without products of its columns."""
    bare = BlockDesign.of(signals, a)
    terms = np.arange(len(signals.factor))
    return dataclasses.replace(bare, blocks=(Block((), terms, ()),))


def _group_places(
    signals: RunSignals, runs: list[np.ndarray], group: int
) -> np.ndarray:
    """The places of a group's samples."""
    parts = zip(signals.stretches, runs, strict=True)
    return np.concatenate([run[one.counted[group]] for one, run in parts])
