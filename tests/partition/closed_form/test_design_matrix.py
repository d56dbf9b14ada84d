"""Columns of nested regions, against recursions by loops and models made anew."""

import nested_problems as problems
import numpy as np
import pytest
from nested_problems import FEEDBACK, coefficients, leaves, nested, signals

from jaxnarx.partition.closed_form.design_matrix import (
    RANGE_MARGIN,
    BlockDesign,
    Gate,
    weight,
)

RIDGE = 1e-3
EXACT = 1e-9


@pytest.fixture(scope="module")
def found() -> BlockDesign:
    return nested()


def slow_weight(region, x):
    """Product of 1 / (1 + exp(-s (x - b))), or one minus it."""
    out = 1.0
    for gate in region:
        upper = 1 / (1 + np.exp(-gate.steepness * (x[gate.dim] - gate.border)))
        out *= upper if gate.side > 0 else 1 - upper
    return out


def slow_columns(design: BlockDesign, one) -> np.ndarray:
    """All columns of a stretch, sample by sample."""
    a, rows = design.a, []
    for block in design.blocks:
        for row in design.signals.factor[block.terms]:
            past, out = [0.0] * (len(a) - 1), []
            for t in range(len(one.y)):
                p = np.prod([one.z[i, t] for i in row])
                raw = slow_weight(block.region, one.x[:, t]) * p
                past = [raw - a[1:] @ past, *past[:-1]]
                out.append(past[0])
            rows.append(out)
    return np.array(rows)


@pytest.fixture(scope="module")
def explicit(found):
    """Columns and targets by group, without anything of the package."""
    columns = [slow_columns(found, one) for one in found.signals.stretches]
    groups = len(found.equations)
    parts = []
    for g in range(groups):
        own = list(zip(columns, found.signals.stretches, strict=True))
        c = np.concatenate([c[:, one.counted[g]] for c, one in own], axis=1)
        start = np.concatenate(
            [one.start_response(found.a)[one.counted[g]] for _, one in own]
        )
        y = np.concatenate([one.y[one.counted[g]] for _, one in own])
        parts.append((c, start, y))
    return parts


def test_columns_are_those_of_the_recursion(found, explicit):
    for rows, (expected, _, _) in zip(found.rows(), explicit, strict=True):
        np.testing.assert_allclose(rows, expected, atol=EXACT * np.abs(expected).max())


def test_equations_are_those_of_the_columns(found, explicit):
    for g, (c, start, y) in enumerate(explicit):
        own = found.equations
        scale = np.sqrt(np.outer(np.diagonal(c @ c.T), np.diagonal(c @ c.T)))
        assert np.abs((own.gram[g] - c @ c.T) / scale).max() < EXACT
        error = y - start
        np.testing.assert_allclose(own.right[g], c @ error, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(own.square[g], error @ error, rtol=EXACT)
        assert own.samples[g] == len(y)
        np.testing.assert_allclose(found.start_response(g), start, atol=EXACT)


def test_weights_of_leaves_sum_to_one_and_within_regions_to_theirs(found):
    for one in found.signals.stretches:
        every = [weight(leaf.region, one.x) for leaf in leaves()]
        np.testing.assert_allclose(np.sum(every, axis=0), 1.0, atol=1e-12)
        for block in found.blocks:
            size = len(block.region)
            inside = [
                w
                for w, leaf in zip(every, leaves(), strict=True)
                if leaf.region[:size] == block.region
            ]
            expected = weight(block.region, one.x)
            np.testing.assert_allclose(np.sum(inside, axis=0), expected, atol=1e-12)


def test_sums_over_nested_regions_are_those_over_leaves(found):
    """The same run from every leaf's own coefficients, the sums on its way."""
    theta = coefficients(found)
    factor = found.signals.factor
    for one, run in zip(found.signals.stretches, found.runs(theta), strict=True):
        raw = np.zeros(len(one.y))
        for leaf in leaves():
            own, edge = np.zeros(len(factor)), 0
            for block in found.blocks:
                part = theta[edge : edge + len(block.terms)]
                edge += len(part)
                if leaf.region[: len(block.region)] == block.region:
                    own[block.terms] += part
            p = np.prod(one.z[factor], axis=1)
            raw += weight(leaf.region, one.x) * (own @ p)
        y = one.filter_columns(raw[None], found.a)[0] + one.start_response(found.a)
        np.testing.assert_allclose(run, y, atol=EXACT)


def test_runs_are_sums_of_columns_and_the_start(found):
    theta = coefficients(found)
    for g, rows in enumerate(found.rows()):
        pairs = zip(found.signals.stretches, found.runs(theta), strict=True)
        run = np.concatenate([run[one.counted[g]] for one, run in pairs])
        np.testing.assert_allclose(
            run, theta @ rows + found.start_response(g), atol=EXACT
        )


def test_a_gate_and_the_other_one_make_one():
    x = np.linspace(-3, 3, 50)[None]
    gate = Gate(0, 0.3, 8.0)
    np.testing.assert_allclose(gate(x) + gate.other(x), 1.0, atol=1e-15)
    assert gate.other.other == gate and gate(np.array([[0.3]]))[0] == 0.5
    # No overflow however far or steep.
    assert Gate(0, 0.0, 1e9)(np.array([[-1e9, 1e9]])).tolist() == pytest.approx([0, 1])


def held(run, parts):
    """Within the range of all groups and a margin."""
    rest = np.concatenate([y for _, _, y in parts])
    margin = RANGE_MARGIN * (rest.max() - rest.min())
    return np.clip(run, rest.min() - margin, rest.max() + margin)


def refitted(parts, without: int, ridge: float, chosen=None) -> float:
    """Sum of squares on a group, of ridge regression on the others' columns."""
    kept = [part for g, part in enumerate(parts) if g != without]
    c = np.concatenate([c for c, _, _ in kept], axis=1)
    error = np.concatenate([y - start for _, start, y in kept])
    at = np.arange(len(c)) if chosen is None else chosen(c, error)
    size = np.sqrt(np.mean(c[at] ** 2, axis=1))
    rows = (c[at] / size[:, None]).T
    rows = np.concatenate([rows, np.sqrt(ridge * len(error)) * np.eye(len(at))])
    right = np.concatenate([error, np.zeros(len(at))])
    theta = np.linalg.lstsq(rows, right)[0] / size
    own, start, y = parts[without]
    return float(np.sum((y - held(theta @ own[at] + start, parts)) ** 2))


def test_groups_left_out_are_judged_by_the_others(found, explicit):
    expected = [refitted(explicit, g, RIDGE) for g in range(len(explicit))]
    losses, points = found.held_out_losses(RIDGE)
    np.testing.assert_allclose(losses, expected, rtol=1e-7)
    assert not points.any()  # there are none


def slow_forward(c, error, ridge: float, size: int) -> np.ndarray:
    """Columns by trying each, the constant first."""
    order = [0]
    c = c / np.sqrt(np.mean(c**2, axis=1))[:, None]
    while len(order) < size:
        losses = []
        for j in range(len(c)):
            at = [*order, j]
            gram = c[at] @ c[at].T / len(error) + ridge * np.eye(len(at))
            right = c[at] @ error / len(error)
            new = j not in order
            losses.append(-right @ np.linalg.solve(gram, right) if new else np.inf)
        order.append(int(np.argmin(losses)))
    return np.array(order)


def test_a_curve_chooses_anew_without_each_group(found, explicit):
    sizes = (1, 3, 6)
    curve = found.curve(RIDGE, sizes, [0])[0]
    assert curve.shape == (3, 3)
    chosen = set()
    for g in range(3):
        for n, size in enumerate(sizes):

            def choose(c, error, size=size):
                at = slow_forward(c, error, RIDGE, size)
                chosen.add(tuple(at.tolist()))
                return at

            expected = refitted(explicit, g, RIDGE, choose)
            np.testing.assert_allclose(curve[g, n], expected, rtol=1e-6)
    # Else the columns of all groups together would do as well.
    assert len(chosen) > len(sizes)


def test_all_columns_of_a_curve_are_left_out(found):
    sizes = [found.equations.columns]
    np.testing.assert_allclose(
        found.curve(RIDGE, sizes, [0])[..., 0], found.held_out_losses(RIDGE), rtol=1e-6
    )


def test_runs_are_judged_within_the_range_of_all_groups(found):
    wild = np.full(len(found.target[0]), 1e6)
    rest = np.concatenate(found.measured)
    top = rest.max() + RANGE_MARGIN * (rest.max() - rest.min())
    expected = np.sum((found.measured[0] - top) ** 2)
    np.testing.assert_allclose(found.loss(0, wild), expected, rtol=1e-12)
    np.testing.assert_allclose(found.loss(0, np.inf * wild), expected, rtol=1e-12)


def test_a_part_of_the_columns(found):
    at = np.array([30, 3, 0, 7, 25])
    few = found.select_columns(at)
    order = np.sort(at)
    assert few.equations.columns == 5
    for own, every in zip(few.rows(), found.rows(), strict=True):
        np.testing.assert_array_equal(own, every[order])
    np.testing.assert_array_equal(few.equations.right, found.equations.right[:, order])
    theta = np.zeros(found.equations.columns)
    theta[order] = coefficients(found)[order]
    pairs = zip(few.runs(theta[order]), found.runs(theta), strict=True)
    for own, every in pairs:
        np.testing.assert_allclose(own, every, atol=EXACT)


def test_other_feedback_is_as_if_begun_with_it(found):
    moved = found.move(np.array([1.0, -0.7]))
    again = BlockDesign.of(signals(), np.array([1.0, -0.7]))
    for block in found.blocks:
        again = again.extend(again.block(block.region, block.terms))
    np.testing.assert_array_equal(moved.equations.gram, again.equations.gram)
    np.testing.assert_array_equal(moved.equations.right, again.equations.right)
    back = moved.move(FEEDBACK)
    np.testing.assert_allclose(back.equations.gram, found.equations.gram, rtol=1e-12)


def test_samples_that_do_not_count_change_nothing_but_the_sums():
    thin = BlockDesign.of(problems.signals(3), FEEDBACK)
    thin = thin.extend(thin.block(()))
    full = nested(1)
    one, _ = full.signals.stretches[1], full.signals.stretches
    # Group 1 is one record: every third of its samples.
    rows = full.rows()[1][:, -problems.LONGEST % 3 : len(one.y) : 3]
    np.testing.assert_allclose(thin.rows()[1], rows, atol=EXACT)
