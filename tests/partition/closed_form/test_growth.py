"""Growth finds the regions a system was made of, whatever the order of its records."""

import dataclasses
from functools import cache

import nested_problems as problems
import numpy as np
import pytest

from jaxnarx.data import Dataset
from jaxnarx.partition.closed_form.design_matrix import BlockDesign, gates_on_path
from jaxnarx.partition.closed_form.gauss_newton import (
    movable_gates,
    move_feedback_and_gates,
)
from jaxnarx.partition.closed_form.growth import (
    Box,
    GrownStage,
    choose_size,
    constants,
    grow_regions,
)
from jaxnarx.partition.closed_form.signals import RunSignals, make_signals
from jaxnarx.regressors import Variables, polynomial_pool

FEEDBACK = np.array([1.0, -0.7])
LENGTHS = 200, 180, 190, 170
LABELS = 0, 1, 2, 1
SCHEDULING = Variables.of([(0, 1, None), (1, 1, None)])
LEVELS = [None, (0.0, 1.0)]


def jump(a, b, border=0.5):
    """Two straight lines on both sides of a border."""
    return np.where(a > border, 2 + a, -1 - 0.3 * a)


def early_jump(a, b):
    """A border that two halvings reach."""
    return jump(a, b, 0.25)


def switched(a, b):
    """What b tells is the direction of a."""
    return np.where(b > 0.5, a, 0.5 - a)


def bent(a, b):
    """Nothing that any halving makes exactly."""
    return np.sin(9 * a) + 0.5 * b * a


@cache
def data_of(kind) -> Dataset:
    """Records with `a` from 0 to 1 and a binary `b`."""
    rng = np.random.default_rng(20)
    us, ys = [], []
    for n in LENGTHS:
        a = problems.levels(rng, n, 4)
        a[10:14], a[20:24] = 0.0, 1.0  # the range is known
        b = (problems.levels(rng, n, 9) > 0.5) * 1.0
        y = np.zeros(n)
        for t in range(1, n):
            y[t] = 0.7 * y[t - 1] + kind(a[t - 1], b[t - 1])
        us.append(np.stack([a, b], axis=1))
        ys.append((y + 0.01 * rng.normal(size=n))[:, None])
    return problems.dataset(us, ys)


def signals_from(data: Dataset, labels) -> RunSignals:
    pool = polynomial_pool(data.channels, input_lags=(1,), output_lags=(), degree=1)
    return make_signals(
        data, pool, SCHEDULING, labels, np.eye(3, dtype=bool), history=1, every=1
    )


def root(signals: RunSignals) -> GrownStage:
    """One region."""
    begun = BlockDesign.of(signals, FEEDBACK)
    return choose_size(begun.extend(begun.block(())), (problems.whole(2),))


@cache
def stages(kind, most: int = 3) -> tuple[GrownStage, ...]:
    data = data_of(kind)
    start = root(signals_from(data, problems.labels(LABELS, data)))
    return tuple(grow_regions(start, max_models=most, levels=LEVELS))


def gates(stage: GrownStage) -> list[list[tuple[int, float, int]]]:
    """Of every leaf."""
    return [
        [
            (g.dim, round(float(g.border), 9), g.side)
            for g, _ in gates_on_path(leaf.region)
        ]
        for leaf in stage.leaves
    ]


def test_a_jump_is_found():
    one, two, *_ = stages(jump)
    assert gates(two) == [[(0, 0.5, -1)], [(0, 0.5, 1)]]
    # A smooth gate follows a jump but in part, until it may turn.
    assert two.score < 0.7 * one.score
    before = move_feedback_and_gates(two.design, two.ridge, steps=0)[1]
    moved, after = move_feedback_and_gates(two.design, two.ridge, steps=30, gates=True)
    (place,) = movable_gates(moved)
    assert after < 0.3 * before
    assert place[1].steepness > 20 and abs(place[1].border - 0.5) < 0.05


def test_a_border_at_a_quarter_takes_two_halvings():
    _, two, three = stages(early_jump)
    assert gates(two) == [[(0, 0.5, -1)], [(0, 0.5, 1)]]
    assert [(0, 0.5, -1), (0, 0.25, 1)] in gates(three)
    assert three.score < 0.75 * two.score


def test_a_binary_input_divides_between_its_levels():
    one, two, *_ = stages(switched)
    assert gates(two) == [[(1, 0.5, -1)], [(1, 0.5, 1)]]
    assert one.score > 0.5 and two.score < 0.05, "what each level does is linear"


def test_a_region_at_one_level_is_not_divided_between_levels():
    leaf = problems.whole(2)
    gate = leaf.gate(1, (0.0, 1.0))
    assert gate is not None and gate.hard and gate.border == 0.5
    upper, lower = leaf.halve(gate)
    assert upper.gate(1, (0.0, 1.0)) is None and lower.gate(1, (0.0, 1.0)) is None
    # A constant has nothing to divide.
    assert leaf.gate(1, (0.0,)) is None
    # Elsewhere they are halved as before, and their boxes share the border.
    assert upper.gate(0, None) == leaf.gate(0, None)
    assert upper.low.tolist() == [0.0, 0.5] and lower.high.tolist() == [1.0, 0.5]


@pytest.mark.parametrize("own", [(0.0, 0.05, 1.0), (0.0, 0.95, 1.0), (0.2, 0.21)])
def test_a_gate_between_levels_tells_them_apart_however_close(own):
    """At the levels themselves weights are zero or one."""
    leaf = Box((), np.zeros(1), np.ones(1))
    waiting, seen = [leaf], []
    while waiting:
        one = waiting.pop()
        gate = one.gate(0, own)
        if gate is None:
            seen.append([v for v in own if one.low[0] <= v <= one.high[0]])
            continue
        at = gate(np.array([own]))
        inside = [n for n, v in enumerate(own) if one.low[0] <= v <= one.high[0]]
        assert np.all(np.minimum(at, 1 - at)[inside] < 1e-9)
        waiting += one.halve(gate)
    assert sorted(seen) == [[v] for v in own], "a leaf for every level"


def refitted(stage: GrownStage, ridge: float, size: int) -> np.ndarray:
    return stage.design.curve(ridge, [size], constants(stage.design))[0, :, 0]


def test_a_stage_tells_the_losses_of_its_size_and_ridge():
    for stage in stages(bent):
        losses = refitted(stage, stage.ridge, stage.size)
        np.testing.assert_allclose(stage.losses, losses, rtol=1e-12)
        count = sum(LENGTHS) - len(LENGTHS)
        expected = np.sqrt(losses.sum() / count)
        np.testing.assert_allclose(stage.score, expected, rtol=1e-12)
        least = stage.losses.sum() * (1 - 1e-12)  # sums of another order
        for size in (1, 2, 4):
            assert refitted(stage, stage.ridge, size).sum() >= least


def test_the_model_of_all_groups_has_the_constant_first():
    stage = stages(bent)[-1]
    at, theta = stage.choose_columns()
    assert at[0] == 0 and len(at) == len(theta) == len(set(at.tolist())) == stage.size


def test_growth_ends_at_its_limit_or_when_nothing_is_left_to_divide():
    assert len(stages(bent)) == 3 and len(stages(bent)[-1].leaves) == 3
    start = stages(bent)[0]
    # Two constants: no halving.
    assert grow_regions(start, max_models=9, levels=[(0.0,), (1.0,)]) == [start]
    made = grow_regions(start, max_models=9, levels=[(0.0, 1.0), (0.0, 1.0)])
    assert 1 < len(made[-1].leaves) <= 4
    assert grow_regions(start, max_models=1, levels=LEVELS) == [start]


def test_growth_ends_after_stages_without_gain():
    """Noise alone: no region helps."""
    data = data_of(jump)
    rng = np.random.default_rng(2)
    noise = [dataclasses.replace(r, y=rng.normal(size=r.y.shape)) for r in data]
    noise = dataclasses.replace(data, records=tuple(noise))
    start = root(signals_from(noise, problems.labels(LABELS, noise)))
    made = grow_regions(start, max_models=20, levels=LEVELS, patience=2)
    best = int(np.argmin([stage.score for stage in made]))
    assert len(made) == best + 3 < 15


def same(found, expected, groups):
    """Structures alike, and losses to rounding; `groups` are numbers of the groups."""
    assert [gates(stage) for stage in found] == [gates(stage) for stage in expected]
    for a, b in zip(found, expected, strict=True):
        assert (a.size, a.ridge) == (b.size, b.ridge)
        np.testing.assert_allclose(a.losses[groups], b.losses, rtol=1e-8)


@pytest.mark.parametrize("kind", [jump, bent])
def test_order_of_records_does_not_matter(kind):
    data = data_of(kind)
    order = [2, 0, 3, 1]
    turned = dataclasses.replace(data, records=tuple(data.records[n] for n in order))
    labels = problems.labels([(LABELS[n] + 1) % 3 for n in order], turned)
    found = grow_regions(
        root(signals_from(turned, labels)), max_models=3, levels=LEVELS
    )
    same(found, stages(kind), np.array([1, 2, 0]))


def test_a_long_record_without_outputs_changes_nothing():
    """Others are padded to its length."""
    data = data_of(bent)
    long = data_of(jump).records[0]
    u = np.concatenate([long.u] * 3)
    nothing = dataclasses.replace(
        long,
        name="long",
        u=u,
        y=np.zeros((len(u), 1)),
        valid=np.tile([True, True, False], (len(u), 1)),
    )
    more = dataclasses.replace(data, records=(*data.records, nothing))
    labels = problems.labels((*LABELS, 0), more)
    found = grow_regions(root(signals_from(more, labels)), max_models=3, levels=LEVELS)
    same(found, stages(bent), np.arange(3))
