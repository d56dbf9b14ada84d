"""Candidates from the mean to regions, on a small plant."""

import dataclasses

import nested_problems as problems
import numpy as np
import pytest

import jaxnarx as jnx
from jaxnarx.data import groups
from jaxnarx.partition import ClosedForm, ClosedSearch, profile_data
from jaxnarx.partition.closed_form.denominator import is_stable
from jaxnarx.partition.closed_form.equation_error import equation_error
from jaxnarx.partition.closed_form.search import _choose_to_move

FAMILIES = ("constant", "ARX", "OE", "filtered inputs", "OE with filtered inputs")
FAMILIES += ("polynomial", "shared feedback")


def search_of(data, output: str = "y") -> ClosedSearch:
    seen = profile_data(data, output)
    return ClosedSearch(data, seen, groups(data, gap=seen.memory))


@pytest.fixture(scope="module")
def data():
    return problems.plant()


@pytest.fixture(scope="module")
def search(data) -> ClosedSearch:
    return search_of(data)


@pytest.fixture(scope="module")
def found(search) -> list[ClosedForm]:
    return list(search.candidates(3))


def of(found: list[ClosedForm], family: str) -> list[ClosedForm]:
    return [one for one in found if one.family == family]


def test_candidates_come_from_cheap_to_rich(found):
    order = [FAMILIES.index(one.family) for one in found]
    assert order == sorted(order) and set(order) == set(range(len(FAMILIES)))
    counts = [len(of(found, family)) for family in FAMILIES]
    assert counts[:5] == [1, 3, 4, 1, 1]


def test_no_two_candidates_have_one_name(found):
    names = [(one.family, one.name) for one in found]
    assert len(names) == len(set(names))


def test_errors_are_those_of_the_groups(found):
    for one in found:
        count = one.stage.design.equations.samples
        np.testing.assert_allclose(one.losses() * count, one.stage.losses)
        np.testing.assert_allclose(one.groups() ** 2, one.losses())
        total = np.sqrt(np.average(one.losses(), weights=count))
        np.testing.assert_allclose(one.free_run, total)
        assert one.count_diverged() == 0 and np.isfinite(one.one_step())


def test_the_mean_of_the_others_errs_by_about_one(found):
    one = found[0]
    measured = one.stage.design.measured
    for g, y in enumerate(measured):
        rest = np.concatenate([other for n, other in enumerate(measured) if n != g])
        expected = np.mean((y - rest.mean()) ** 2)
        np.testing.assert_allclose(one.losses()[g], expected, rtol=1e-9)
    assert one.free_run == pytest.approx(1, abs=0.08)
    assert one.one_step() == pytest.approx(1, abs=0.08)


def test_nonlinearity_is_found(found):
    """The gain bends where no line can follow, and a straight line takes most."""
    best = {
        family: min(one.free_run for one in of(found, family)) for family in FAMILIES
    }
    assert best["OE"] < 0.25 * best["constant"]
    assert best["shared feedback"] < 0.4 * best["OE"]


def test_feedback_is_stable_and_of_the_order_that_is_told(found):
    for one in found:
        assert is_stable(one.stage.design.a)
    orders = [len(one.stage.design.a) - 1 for one in of(found, "OE")]
    assert orders == [1, 2, 3, 4]
    # The plant has its pole at 0.8.
    (pole,) = np.roots(of(found, "OE")[0].stage.design.a)
    assert pole == pytest.approx(0.8, abs=0.03)


def test_networks_are_those_of_the_candidates(data, found):
    """Free runs from the measured start, once what it leaves is over."""
    for one in (found[0], found[2], of(found, "polynomial")[0], found[-1]):
        run = jnx.simulate(one.network(), data).value
        made = one.stage.design.signals
        gain = made.gain[2]
        runs = one.stage.design.runs(one.coefficients())
        pairs = zip(runs, made.stretches, run.outputs, strict=True)
        for own, _, y in pairs:
            own = (own * made.spread + made.middle) * gain
            tail = slice(-80, None)
            # Starts differ by what the network needs to look back.
            np.testing.assert_allclose(y[tail, 0], own[tail], atol=1e-4)


def slow_arx(one: ClosedForm, order: int, without=None):
    """A(q) and coefficients by dense least squares on measured outputs."""
    made = one.stage.design.signals
    rows, right = [], []
    for stretch in made.stretches:
        past = [*stretch.before[:order][::-1], *stretch.y]
        for g, at in enumerate(stretch.counted):
            for t in at if g != without else ():
                lags = [-past[order + t - i] for i in range(1, order + 1)]
                terms = np.prod(stretch.z[made.factor, t], axis=1)
                rows.append([*lags, *terms])
                right.append(stretch.y[t])
    theta = np.linalg.lstsq(np.array(rows), np.array(right))[0]
    left = np.array(right) - np.array(rows) @ theta
    return np.array([1.0, *theta[:order]]), theta[order:], left


@pytest.mark.parametrize("order", [1, 3])
def test_arx_is_least_squares_one_step_ahead(found, order):
    one = of(found, "ARX")[order - 1]
    a, theta, left = slow_arx(one, order)
    # A ridge of 1e-9 on columns of unit length.
    np.testing.assert_allclose(one.stage.design.a, a, atol=1e-5)
    np.testing.assert_allclose(one.coefficients(), theta, atol=1e-5)
    np.testing.assert_allclose(one.one_step(), np.sqrt(np.mean(left**2)), rtol=1e-5)


def test_arx_is_judged_by_free_runs_of_groups_left_out(found):
    one = of(found, "ARX")[1]
    bare = one.stage.design
    for g, loss in enumerate(one.stage.losses):
        a, theta, _ = slow_arx(one, 2, without=g)
        own, _ = equation_error(bare.signals, 2, without=g)
        np.testing.assert_allclose(own, a, atol=1e-5)
        runs = []
        for stretch in bare.signals.stretches:
            past = [*stretch.before[:2][::-1]]
            for t in range(len(stretch.y)):
                terms = np.prod(stretch.z[bare.signals.factor, t], axis=1)
                past.append(theta @ terms - a[1] * past[-1] - a[2] * past[-2])
            runs.append(np.array(past[2:])[stretch.counted[g]])
        expected = bare.loss(g, np.concatenate(runs))
        np.testing.assert_allclose(loss, expected, rtol=1e-3)


def test_spread_is_the_output_s_standard_deviation(data, search, found):
    y = np.concatenate([r.y[:, 0] for r in data])
    # Of the samples that count: the first ones of each record do not.
    assert search.spread == pytest.approx(y.std(), rel=0.05)


def explosive(rng, u, y):
    """Grows by 8 % a sample from next to nothing, measured with noise that is more."""
    out = np.zeros(len(u))
    for t in range(1, len(u)):
        out[t] = 1.08 * out[t - 1] + 1e-3 * (u[t - 1, 0] + 1)
    return u, out + 0.003 * out.max() * rng.normal(size=len(u))


def test_what_runs_away_is_told_and_still_has_a_model():
    """Warnings would be errors here: numbers are beyond all numbers."""
    search = search_of(problems.plant(explosive))
    every = [search.equation_error(order) for order in (1, 2)]
    assert not is_stable(every[0].stage.design.a)
    assert every[0].count_diverged() > 0
    for one in every:
        assert np.all(np.isfinite(one.losses())) and np.isfinite(one.free_run)
        # It is fitted one step ahead, where it is as good as the noise lets it be.
        assert one.one_step() < 0.2
        run = jnx.simulate(one.network(), problems.plant(explosive)).value
        assert all(np.all(np.isfinite(y)) for y in run.outputs)
        assert bool(one.count_diverged()) == any(d[0] for d in run.diverged)


def test_numbers_beyond_all_numbers(data, found):
    """A root so far outside that a run overflows, on the way and at its end."""
    one = of(found, "ARX")[0]
    for root in (10.0, 1e6):
        bare = dataclasses.replace(one.stage.design, a=np.array([1.0, -root]))
        stage = dataclasses.replace(one.stage, design=bare)
        wild = dataclasses.replace(one, stage=stage)
        assert wild.count_diverged() == len(problems.LENGTHS)
        assert np.isfinite(wild.one_step())
        assert jnx.simulate(wild.network(), data).status_name == "diverged"


@pytest.mark.parametrize(
    ("scores", "expected"),
    [
        ([0.5, 0.4, 0.3, 0.32, 0.34], [2, 3]),
        ([0.5, 0.4, 0.3], [2]),
        ([0.5, 0.305, 0.302, 0.3, 0.4], [3, 1]),
        ([0.5, 0.6, 0.54, 0.7], [2]),  # the root has no gates
        ([0.5, 0.6], []),
    ],
)
def test_gates_move_in_the_best_and_in_the_largest_and_smallest_nearly_as_good(
    search, scores, expected
):
    stage = search.constant().stage
    count = stage.design.equations.judged.sum()
    stages = [
        dataclasses.replace(stage, losses=np.array([score**2 * count]))
        for score in scores
    ]
    np.testing.assert_allclose([one.score for one in stages], scores)
    best = int(np.argmin(scores))
    found = _choose_to_move(stages, best)
    assert [stages.index(one) for one in found] == expected


def test_a_candidate_is_made_again_by_its_structure(data, search, found):
    """Of the same records it is the same."""
    again = search_of(data)
    for one in found:
        repeated = again.repeat(one.family, one.structure, {})
        assert repeated.family == one.family
        assert repeated.free_run == pytest.approx(one.free_run, rel=1e-9), one.name
