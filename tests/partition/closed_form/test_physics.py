"""Signs of gains at rest as constraints of the closed form, on a small plant."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import minimize

from jaxnarx.data import Dataset, groups
from jaxnarx.errors import SpecError
from jaxnarx.evaluation import (
    count_wrong_signs,
    longest_time_constants,
    steady_states,
)
from jaxnarx.identification import Physics
from jaxnarx.models import make_pairs
from jaxnarx.partition import ClosedForm, ClosedSearch, profile_data
from jaxnarx.partition.closed_form.equation_error import equation_error
from jaxnarx.partition.closed_form.physics import (
    constrain,
    rest_columns,
    rises,
    solve_signed,
)
from jaxnarx.regressors import evaluate
from jaxnarx.settings import require_physics

KNOWN = Physics(increases_with=["a", "b"])
"""What the plant does; noise hides it for `b`."""
HALVES = ("a", slice(0, 100)), ("b", slice(100, 200))
"""Pairs in which an input moves."""


def plant(inputs: int = 2) -> Dataset:
    """First order; bent in `a`, and next to nothing of `b`; `c` stands still."""
    rng = np.random.default_rng(0)
    us, ys = [], []
    for n in (150, 160, 150, 150):
        held = rng.uniform(-1, 1, (n // 7 + 1, 2))
        u, y = np.repeat(held, 7, axis=0)[:n], np.zeros(n)
        for t in range(1, n):
            y[t] = 0.7 * y[t - 1] + np.tanh(2.5 * u[t - 1, 0]) + 0.05 * u[t - 1, 1]
        us.append(np.concatenate([u, np.ones((n, 1))], axis=1)[:, :inputs])
        ys.append((y + rng.normal(size=n))[:, None])
    names = ["a", "b", "c"][:inputs]
    return Dataset.from_arrays(us, ys, inputs=names, outputs=["y"], sample_time=0.1)


@pytest.fixture(scope="module")
def data() -> Dataset:
    return plant()


@pytest.fixture(scope="module")
def pairs(data):
    return make_pairs(data, KNOWN, output="y", points=100)


def search_of(data, pairs=None, root=False, longest=None) -> ClosedSearch:
    seen = profile_data(data, "y")
    own = data, seen, groups(data, gap=seen.memory)
    return ClosedSearch(*own, root=root, pairs=pairs, longest=longest)


@pytest.fixture(scope="module")
def free(data) -> list[ClosedForm]:
    return list(search_of(data).candidates(2, grown_roots=1))


@pytest.fixture(scope="module")
def signed(data, pairs) -> list[ClosedForm]:
    return list(search_of(data, pairs).candidates(2, grown_roots=1))


def slopes(form: ClosedForm, pairs) -> np.ndarray:
    """Rise at rest along every pair, in standard deviations of the output."""
    design = form.stage.design
    return rises(design, pairs) @ form.coefficients() / design.a.sum()


def test_signs_that_noise_has_turned_are_repaired(data, free, signed, pairs):
    # Without constraints several candidates fall with b, which the plant does not.
    wrong = [one for one in free if np.nanmin(slopes(one, pairs)) < -1e-3]
    assert len(wrong) >= 3
    for one in signed:
        assert np.nanmin(slopes(one, pairs)) >= -1e-6
    family = [one.family for one in free].index("polynomial")
    before, after = free[family].network(), signed[family].network()
    counted = [count_wrong_signs(n, data, {"y": KNOWN})["y"] for n in (before, after)]
    assert counted[0].wrong > 5 and counted[1] == (0, counted[0].known)


def test_the_price_is_told(free, signed, pairs):
    for before, after in zip(free, signed, strict=True):
        assert (before.family, before.name) == (after.family, after.name)
        assert after.unconstrained == pytest.approx(before.free_run, rel=1e-9)
        assert before.unconstrained is None and not before.turned
        wrong = {n: int((slopes(before, pairs)[k] < -1e-9).sum()) for n, k in HALVES}
        assert {n: count for n, (count, of) in after.turned.items()} == wrong
        assert after.free_run < 1.05 * before.free_run


def test_candidates_that_keep_the_signs_stay(free, signed, pairs):
    kept = [
        (before, after)
        for before, after in zip(free, signed, strict=True)
        if before.given is None and before.free_run == after.free_run
    ]
    assert kept
    for before, after in kept:
        np.testing.assert_array_equal(before.coefficients(), after.coefficients())


def test_columns_at_rest_are_those_of_the_network(free, pairs):
    """With filters, regions and feedback, where outputs are within their range."""
    for one in (free[-1], next(f for f in free if f.family == "filtered inputs")):
        design, signals = one.stage.design, one.stage.design.signals
        found = rest_columns(design, pairs.low) @ one.coefficients() / design.a.sum()
        o = len(signals.gain) - 1
        found = (found * signals.spread + signals.middle) * signals.gain[o]
        network = one.network()
        value = steady_states(network, pairs.low, np.zeros(1)).value[:, 0]
        low, high = float(network.low[o]), float(network.high[o])
        inside = (found > low) & (found < high)
        assert inside.sum() > len(pairs) / 2
        np.testing.assert_allclose(found[inside], value[inside], rtol=1e-3, atol=5e-3)


def test_the_solution_is_that_of_a_quadratic_program():
    rng = np.random.default_rng(1)
    columns = rng.normal(size=(60, 6)) * np.array([1, 10, 0.1, 1, 1, 100])
    gram, right = columns.T @ columns, columns.T @ rng.normal(size=60)
    rows = rng.normal(size=(9, 6))
    ridge = 1e-3
    found = solve_signed(gram, right, ridge, rows)
    system = gram + ridge * np.diag(np.diagonal(gram))
    size = np.sqrt(np.diagonal(gram))

    def loss(scaled):
        theta = scaled / size
        return theta @ system @ theta / 2 - right @ theta

    best = minimize(
        loss,
        np.zeros(6),
        method="SLSQP",
        constraints={"type": "ineq", "fun": lambda s: rows @ (s / size)},
        options={"ftol": 1e-14, "maxiter": 500},
    )
    assert best.success and np.min(rows @ np.linalg.solve(system, right)) < -1e-4
    assert np.min(rows @ found) > -1e-10
    np.testing.assert_allclose(found * size, best.x, atol=1e-5)


def test_a_row_twice_and_an_empty_one_change_nothing():
    rng = np.random.default_rng(2)
    columns = rng.normal(size=(30, 4))
    gram, right = columns.T @ columns, columns.T @ rng.normal(size=30)
    rows = rng.normal(size=(3, 4))
    more = np.concatenate([rows, rows[:1] * (1 + 1e-12), np.zeros((1, 4))])
    once, twice = (solve_signed(gram, right, 1e-6, own) for own in (rows, more))
    np.testing.assert_allclose(once, twice, atol=1e-8)


def test_losses_are_those_of_models_made_without_the_group(free, pairs):
    """A slow oracle: columns of the other groups, stacked, solved by SLSQP."""
    one = next(f for f in free if f.family == "polynomial")
    found = constrain(one, pairs)
    assert found.free_run != one.free_run
    stage, design = one.stage, one.stage.design
    rows = rises(design, pairs)
    columns = design.rows()
    for g in range(len(stage.losses)):
        at, start = stage.choose_columns(g)
        own = [n for n in range(len(columns)) if not design.signals.apart[g][n]]
        stacked = np.concatenate([columns[n][at] for n in own], axis=1)
        target = np.concatenate([design.target[n] for n in own])
        size = np.sqrt(np.mean(stacked**2, axis=1))
        scaled = stacked / size[:, None]
        gram = scaled @ scaled.T / len(target) + stage.ridge * np.eye(len(at))
        right = scaled @ target / len(target)
        signs = rows[:, at] / size
        best = minimize(
            lambda s, gram=gram, right=right: s @ gram @ s / 2 - right @ s,
            start * size,
            jac=lambda s, gram=gram, right=right: gram @ s - right,
            method="SLSQP",
            constraints={
                "type": "ineq",
                "fun": lambda s, signs=signs: signs @ s,
                "jac": lambda s, signs=signs: signs,
            },
            options={"ftol": 1e-14, "maxiter": 500},
        )
        assert best.success
        run = design.start_response(g) + (best.x / size) @ columns[g][at]
        loss = design.loss(g, run)
        assert found.stage.losses[g] == pytest.approx(loss, rel=1e-3)
        error = found.held_out_errors()[g][1]
        assert found.stage.losses[g] == pytest.approx(np.sum(error**2), rel=1e-9)


def test_a_root_of_the_output_keeps_the_signs(data, pairs):
    for one in search_of(data, pairs, root=True).candidates(1, degree=1):
        assert one.family.endswith(", root")
        assert np.nanmin(slopes(one, pairs)) >= -1e-6


def test_what_is_made_again_keeps_the_signs(data, pairs, signed):
    search = search_of(data[1:], pairs)
    for one in (signed[2], signed[-1]):
        found = search.repeat(one.family, one.structure, {})
        assert found.unconstrained is not None
        assert np.nanmin(slopes(found, pairs)) >= -1e-6


def test_pairs_lie_around_measured_samples(data):
    pairs = make_pairs(
        data, Physics(increases_with=["a"], decreases_with=["b"]), output="y", points=5
    )
    up, down = (pairs.high - pairs.low)[:5], (pairs.high - pairs.low)[5:]
    assert np.all(up[:, 0] > 0) and np.all(up[:, 1] == 0)
    assert np.all(down[:, 1] < 0) and np.all(down[:, 0] == 0)
    both = np.concatenate([pairs.low, pairs.high])
    every = np.concatenate([r.u for r in data])
    assert np.all(both >= every.min(axis=0)) and np.all(both <= every.max(axis=0))


def test_an_input_with_two_values_goes_from_one_to_the_other(data):
    records = tuple(
        dataclasses.replace(r, u=np.stack([r.u[:, 0], r.u[:, 1] > 0], axis=1) * 1.0)
        for r in data
    )
    switched = dataclasses.replace(data, records=records)
    pairs = make_pairs(switched, Physics(increases_with=["b"]), output="y", points=4)
    assert np.all(pairs.low[:, 1] == 0) and np.all(pairs.high[:, 1] == 1)


def test_physics_that_cannot_be_is_named():
    with pytest.raises(SpecError, match="contradict each other: a is in both"):
        Physics(increases_with=["a", "b"], decreases_with=["a"])
    with pytest.raises(SpecError, match="says nothing"):
        Physics()
    with pytest.raises(SpecError, match="no output 'x'") as caught:
        require_physics({"x": KNOWN}, ["a", "b"], ["y"])
    assert caught.value.field == "physics"
    with pytest.raises(SpecError, match="no input 'b'.*: a") as caught:
        require_physics({"y": KNOWN}, ["a"], ["y"])
    assert caught.value.field == "physics.y"


def test_an_input_that_stands_still_has_no_sign():
    with pytest.raises(SpecError, match="c does not move in the records") as caught:
        make_pairs(plant(3), Physics(increases_with=["c"]), output="y")
    assert caught.value.field == "physics.y"


def test_physics_reads_as_a_sentence():
    told = Physics(increases_with=["a", "b"], decreases_with=["c"])
    assert str(told) == "rises with a, b and falls with c"


def test_one_without_a_solution_is_left_out(data, pairs, monkeypatch):
    def fail(form, pairs):
        if form.family == "constant":
            return form
        raise np.linalg.LinAlgError("no end")

    monkeypatch.setattr("jaxnarx.partition.closed_form.search.constrain", fail)
    found = list(search_of(data, pairs).candidates(1, degree=1))
    assert [one.family for one in found] == ["constant"]


def test_no_candidate_is_slower_than_it_may_be(data, free):
    """The plant has a time constant of .28 s; without a bound several are slower."""
    longest = 0.2
    before = [longest_time_constants(one.network(), data)["y"] for one in free]
    assert sum(slow > 1.05 * longest for slow in before) >= 5
    found = list(search_of(data, longest=longest).candidates(2, grown_roots=1))
    assert {one.family for one in found} >= {"ARX", "OE", "polynomial"}
    orders = set()
    for one in found:
        assert longest_time_constants(one.network(), data)["y"] <= 1.01 * longest
        orders.add(len(one.stage.design.a) - 1)
    assert max(orders) >= 3
    # A repeated one keeps to it too.
    again = search_of(data, longest=longest).repeat("OE", found[4].structure, {})
    assert longest_time_constants(again.network(), data)["y"] <= 1.01 * longest


def test_the_other_coefficients_are_the_best_with_poles_that_moved(data):
    """A slow oracle: what the feedback leaves of the output, by all terms."""
    signals = search_of(data, longest=0.1).equation_error(1).stage.design.signals
    a, theta = equation_error(signals, 1)
    assert -a[1] == pytest.approx(np.exp(-data.sample_time / 0.1))
    rows, left = [], []
    for one in signals.stretches:
        at = np.concatenate(one.counted)
        rows.append(np.asarray(evaluate(signals.factor, one.z[:, at])))
        left.append(one.y[at] + a[1] * one.y[at - 1])
    best = np.linalg.lstsq(np.concatenate(rows, axis=1).T, np.concatenate(left))[0]
    np.testing.assert_allclose(theta, best, atol=1e-6)
