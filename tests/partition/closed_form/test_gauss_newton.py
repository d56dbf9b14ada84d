"""Gauss-Newton on feedback and gates, against central differences of the run."""

import nested_problems as problems
import numpy as np
import pytest
from nested_problems import coefficients, nested

from jaxnarx.partition.closed_form.denominator import is_stable
from jaxnarx.partition.closed_form.design_matrix import (
    BlockDesign,
    Gate,
    gates_on_path,
    weight,
)
from jaxnarx.partition.closed_form.equation_error import equation_error
from jaxnarx.partition.closed_form.gauss_newton import (
    _step,
    derivatives,
    movable_gates,
    move_feedback_and_gates,
    shift_gates,
)
from jaxnarx.partition.closed_form.signals import RunSignals, make_signals
from jaxnarx.regressors import Variables, polynomial_pool

RIDGE = 1e-8


@pytest.fixture(scope="module")
def some() -> BlockDesign:
    """Nested regions, with some of their columns."""
    return nested().select_columns(np.arange(0, 53, 4))


def runs_at(design: BlockDesign, theta, parameters, places):
    """Free runs where samples count, by groups; a_1 ... a_n, borders, log steepness
    changed by these parameters."""
    order = len(design.a) - 1
    a = design.a.copy()
    a[1:] += parameters[:order]
    moved = design.move(a, shift_gates(places, parameters[order:]))
    rows = moved.rows()
    return [theta @ own + moved.start_response(g) for g, own in enumerate(rows)]


def test_derivatives_of_the_run_are_those_of_differences(some):
    theta, h, places = coefficients(some), 1e-5, movable_gates(some)
    assert len(places) == 3, "the gate between levels stays"
    own = derivatives(some, theta, places)
    count = 2 + 2 * len(places)
    assert all(rows.shape[0] == count for rows in own)
    for n, step in enumerate(h * np.eye(count)):
        ends = (runs_at(some, theta, sign * step, places) for sign in (1, -1))
        for up, down, rows in zip(*ends, own, strict=True):
            # The error of differences is of second order.
            expected = (up - down) / (2 * h)
            assert np.abs(expected).max() > 0.01
            np.testing.assert_allclose(rows[n], expected, atol=1e-6)


def test_a_step_is_that_of_least_squares_on_everything(some):
    theta = some.equations.exclude_group(None).solve(RIDGE)
    moves = derivatives(some, theta, [])
    jacobian = np.concatenate(
        [np.concatenate([c, m]) for c, m in zip(some.rows(), moves, strict=True)],
        axis=1,
    ).T
    left = [e - theta @ c for c, e in zip(some.rows(), some.target, strict=True)]
    size = np.linalg.norm(jacobian, axis=0)
    expected = np.linalg.lstsq(jacobian / size, np.concatenate(left))[0] / size
    # The package adds a ridge of 1e-9 to columns of unit length.
    np.testing.assert_allclose(_step(some, RIDGE, []), expected[-2:], rtol=1e-4)


def test_gates_move_with_all_that_stands_behind_them(some):
    """Regions keep their nesting, steps their limits, and leaves their sum."""
    places = movable_gates(some)
    gates = shift_gates(places, np.array([5.0, -0.05, -9.0, 0.3, 7.0, -7.0]))
    borders = [gates[place].border for place in places]
    old = [place[1].border for place in places]
    np.testing.assert_allclose(np.subtract(borders, old), [0.1, -0.05, -0.1])
    steep = [gates[p].steepness / p[1].steepness for p in places]
    np.testing.assert_allclose(np.log(steep), [0.3, 0.5, -0.5])
    moved = [leaf.move(gates) for leaf in problems.leaves()]
    for one in some.signals.stretches:
        total = sum(weight(leaf.region, one.x) for leaf in moved)
        np.testing.assert_allclose(total, 1.0, atol=1e-12)
    for leaf, before in zip(moved, problems.leaves(), strict=True):
        assert leaf.region != before.region
        assert [g.dim for g, _ in gates_on_path(leaf.region)] == [
            g.dim for g, _ in gates_on_path(before.region)
        ]
    again = [leaf.move({}) for leaf in problems.leaves()]
    for leaf, before in zip(again, problems.leaves(), strict=True):
        assert leaf.region == before.region
        np.testing.assert_allclose(leaf.low, before.low)
        np.testing.assert_allclose(leaf.high, before.high)


def mean_square(design: BlockDesign, ridge: float) -> float:
    """Of the free run with the best coefficients, from explicit columns."""
    theta = design.equations.exclude_group(None).solve(ridge)
    pairs = zip(design.rows(), design.target, strict=True)
    errors = np.concatenate([e - theta @ c for c, e in pairs])
    return float(np.mean(errors**2))


STARTS = (
    np.array([1.0, -1.2, 0.45]),
    np.array([1.0, -0.2]),
    np.array([1.0, 0.5, 0.5, 0.1]),
    np.array([1.0, -1.997, 0.9975]),
    np.array([1.0, -0.999]),
)


@pytest.mark.parametrize("start", STARTS, ids=lambda a: f"{a[1:]}")
@pytest.mark.parametrize(("ridge", "gates"), [(RIDGE, False), (1e-2, True)])
def test_tuning_never_raises_the_loss(some, start, ridge, gates):
    begun = some.move(start)
    before = mean_square(begun, ridge)
    for steps in (0, 1, 8):
        after, told = move_feedback_and_gates(begun, ridge, steps=steps, gates=gates)
        np.testing.assert_allclose(told, mean_square(after, ridge), rtol=1e-6)
        assert told <= before * (1 + 1e-9)
        assert is_stable(after.a) and len(after.a) == len(start)
        before = told


def linear(u: np.ndarray, a, noise: float, seed: int) -> np.ndarray:
    """Measured output of A(q) y(t) = u(t-1) + 0.5 u(t-2); the run itself is
    undisturbed."""
    y = np.zeros(len(u))
    for t in range(2, len(u)):
        past = sum(-c * y[t - i] for i, c in enumerate(a[1:], 1) if t >= i)
        y[t] = past + u[t - 1] + 0.5 * u[t - 2]
    return 7 + y + noise * y.std() * np.random.default_rng(seed).normal(size=len(u))


def signals_from(us, ys) -> RunSignals:
    data = problems.dataset([u[:, None] for u in us], [y[:, None] for y in ys])
    pool = polynomial_pool(data.channels, input_lags=(1, 2), output_lags=(), degree=1)
    labels = [np.full(len(r), n % 2) for n, r in enumerate(data)]
    table = Variables.of([(0, 1, None)])
    return make_signals(
        data, pool, table, labels, np.eye(2, dtype=bool), history=4, every=1
    )


@pytest.mark.parametrize(
    ("poles", "start"),
    [
        ([0.9, 0.6], [0.5, 0.3]),
        ([0.8 + 0.3j, 0.8 - 0.3j], [0.7, 0.2]),
        ([0.9, 0.5 + 0.5j, 0.5 - 0.5j], [0.8, 0.4, 0.1]),
    ],
    ids=["real", "complex", "both"],
)
def test_feedback_of_a_system_is_recovered_from_noisy_outputs(poles, start):
    rng = np.random.default_rng(4)
    a = np.real(np.poly(poles))
    us = [problems.levels(rng, 300, 6) for _ in range(3)]
    clean = signals_from(us, [linear(u, a, 0.0, n) for n, u in enumerate(us)])
    noisy = signals_from(us, [linear(u, a, 0.05, n) for n, u in enumerate(us)])
    found = []
    for made, ridge in ((clean, 1e-12), (noisy, RIDGE)):
        begun = BlockDesign.of(made, np.poly(start))
        begun = begun.extend(begun.block(()))
        found.append(move_feedback_and_gates(begun, ridge, steps=60))
    np.testing.assert_allclose(found[0][0].a, a, atol=1e-4)
    got = np.sort_complex(np.roots(found[1][0].a))
    # 5 % noise on 900 samples; poles of the free run are not biased by it.
    np.testing.assert_allclose(got, np.sort_complex(np.array(poles) + 0j), atol=0.02)
    # What noise in the measured start leaves comes on top of that of the outputs.
    assert found[0][1] < 1e-6 and 0.9 < found[1][1] / 0.05**2 < 1.5


def test_least_squares_one_step_ahead_would_be_biased():
    """What the free run is for: the same data and terms, one step ahead."""
    rng, a = np.random.default_rng(4), np.poly([0.9, 0.6])
    us = [problems.levels(rng, 300, 6) for _ in range(3)]
    made = signals_from(us, [linear(u, a, 0.05, n) for n, u in enumerate(us)])
    found, _ = equation_error(made, 2)
    assert np.abs(np.sort(np.roots(found)) - [0.6, 0.9]).max() > 0.04


def test_without_feedback_and_gates_there_is_nothing_to_tune(some):
    begun = nested(1).move(np.ones(1))
    after, told = move_feedback_and_gates(begun, RIDGE, gates=True)
    assert after is begun
    np.testing.assert_allclose(told, mean_square(begun, RIDGE), rtol=1e-9)


def test_a_border_is_found():
    """Two slopes that meet at 0.6: the gate begins at a half."""
    rng = np.random.default_rng(8)
    us = [problems.levels(rng, 300, 3) for _ in range(2)]
    ys = [np.where(u > 0.6, 3 - u, u) for u in us]
    made = signals_from([np.roll(u, -1) for u in us], ys)
    gate = Gate(0, 0.5, 8.0)
    begun = BlockDesign.of(made, np.ones(1))
    begun = begun.extend(begun.block(())).extend(begun.block((gate,)))
    before = mean_square(begun, RIDGE)
    after, loss = move_feedback_and_gates(begun, RIDGE, steps=40, gates=True)
    (found,) = movable_gates(after)
    assert found[1].border == pytest.approx(0.6, abs=0.02)
    assert found[1].steepness > 3 * gate.steepness and loss < 0.2 * before
