"""Rows and models of candidates as they are tried; what costs time is faked."""

import dataclasses

import numpy as np
import pytest
from search_problems import plant

import jaxnarx as jnx
from jaxnarx.data import groups
from jaxnarx.errors import DataError
from jaxnarx.evaluation import cost, longest_time_constants
from jaxnarx.identification import candidates as module
from jaxnarx.identification.candidates import CandidateSearch
from jaxnarx.identification.cross_validate import CrossValidation
from jaxnarx.identification.leaderboard import Candidate
from jaxnarx.identification.narx_candidates import propose_narx
from jaxnarx.models import hold_to_range
from jaxnarx.partition import (
    ClosedForm,
    ClosedSearch,
    ClosedStructure,
    DataProfile,
    profile_data,
)
from jaxnarx.settings import Identification, Physics, Preset

TINY = Preset("for tests", max_models=2, grown=1, fed_back=3, states=0, longest=10_000)


@pytest.fixture(scope="module")
def data():
    return plant()


@pytest.fixture(scope="module")
def seen(data) -> DataProfile:
    return profile_data(data, "y")


@pytest.fixture(scope="module")
def few(data, seen) -> list[ClosedForm]:
    """The mean and two ARX models."""
    search = ClosedSearch(data, seen, groups(data))
    return [search.constant(), search.equation_error(1), search.equation_error(2)]


@pytest.fixture
def judged(monkeypatch, few) -> dict:
    """Results of the judge by the names of what it is asked, in turn; `asked` are the
    best losses it was told."""
    said: dict = {"asked": [], "results": []}

    class Fake(ClosedSearch):
        spread = 1.5  # pyright: ignore

        def __init__(self, *_, root=False, **known):
            said.setdefault("roots", []).append(root)

        def candidates(self, **limits):  # pyright: ignore
            said["limits"] = limits
            yield from few

    def judge(method, data, groups, spread, best, rows, *, begin, watch):
        assert rows == TINY.longest
        said["asked"].append((spread, None if best is None else best.copy()))
        result = said["results"].pop(0)
        if isinstance(result, Exception):
            raise result
        return [result]

    monkeypatch.setattr(module, "judge_nested", lambda rows, *_: list(rows))
    monkeypatch.setattr(module, "FED_PATIENCE", 3)
    monkeypatch.setattr(module, "ClosedSearch", Fake)
    monkeypatch.setattr(module, "cross_validate", judge)
    return said


def made(losses, network=None, **more) -> CrossValidation:
    losses = np.array(losses, float)
    counts = np.where(np.isfinite(losses), [100.0, 150.0, 120.0, 80.0], 0.0)
    return CrossValidation(
        losses, counts, 0.1, more.pop("diverged", 0), network, **more
    )


def names(data, seen) -> list[tuple[str, str]]:
    return [(family, name) for family, (name,), _ in propose_narx(data, seen)]


def tried(data, seen, preset=TINY, **more):
    found = CandidateSearch(data, seen, groups(data), preset, **more)
    return found, list(found)


def test_rows_tell_what_was_found(data, seen, few, judged):
    network = few[1].network()
    judged["results"] = [made([0.04, 0.09, 0.01, 0.25], network)] * 3
    _, every = tried(data, seen)
    assert len(every) == 6 and judged["limits"]["max_models"] == 2
    for one, (row, own) in zip(few, every[:3], strict=True):
        assert (row.output, row.family, row.name) == ("y", one.family, one.name)
        assert row.free_run == one.free_run and row.one_step == one.one_step()
        np.testing.assert_allclose(np.array(row.groups, float), one.groups())
        assert row.status == "ok" and row.seconds >= 0 and row.number == 0
        assert own is not None and own.hold is not None
        price = cost(own)
        assert row.parameters == price.parameters
        assert row.operations == price.operations
    row, own = every[3]
    assert own is network and row.status == "ok" and row.one_step == 0.1
    assert (row.family, row.name) == names(data, seen)[0]
    weights = [100, 150, 120, 80]
    pooled = np.average([0.04, 0.09, 0.01, 0.25], weights=weights) ** 0.5
    assert row.free_run == pytest.approx(pooled)
    assert row.groups == pytest.approx((0.2, 0.3, 0.1, 0.5))


def test_a_trained_network_with_a_wrong_gain_is_vetoed(data, seen, few, judged):
    """The plant rises with its input: one sign that is asked is right, one wrong."""
    result = made([0.04, 0.09, 0.01, 0.25], few[1].network())
    right, wrong = Physics(increases_with=["u"]), Physics(decreases_with=["u"])
    for physics, status in ((right, "ok"), (wrong, "against physics")):
        judged["results"] = [result] * 3
        row, own = tried(data, seen, physics=physics)[1][3]
        assert row.status == status and row.eligible == (own is not None)
        assert row.eligible == (status == "ok")
    assert "24 of 24 gains at rest have the wrong sign: y falls with u" in row.detail
    assert row.free_run is None and None not in row.groups


def test_a_trained_network_that_is_too_slow_is_vetoed(data, seen, few, judged):
    network = few[1].network()
    slow = longest_time_constants(network, data)["y"]
    assert slow > 0
    for share, status in ((1.1, "ok"), (0.9, "against physics")):
        judged["results"] = [made([0.04, 0.09, 0.01, 0.25], network)] * 3
        physics = Physics(longest_time_constant=share * slow)
        row, own = tried(data, seen, physics=physics)[1][3]
        assert row.status == status and row.eligible == (own is not None)
    told = f"a time constant is {slow:.3g} s: y is no slower than {share * slow:g} s"
    assert told in row.detail


def test_standard_error_is_that_of_the_mean_over_groups(data, seen, few, judged):
    """Of the mean square, brought to the root by its slope."""
    judged["results"] = [made([0.04, 0.09, 0.01, 0.25], few[0].network())] * 3
    row = tried(data, seen)[1][3][0]
    of_square = np.std([0.04, 0.09, 0.01, 0.25], ddof=1) / 2
    assert row.free_run is not None
    assert row.standard_error == pytest.approx(of_square / (2 * row.free_run))


def test_trouble_of_one_is_told_and_the_next_is_tried(data, seen, few, judged):
    gone = [np.nan] * 3
    judged["results"] = [
        DataError("no record can be run"),
        np.linalg.LinAlgError("singular"),
        made([0.3, *gone], diverged=2, detail="diverges"),
    ]
    _, every = tried(data, seen)
    first, second, third = (row for row, _ in every[3:])
    assert all(network is None for _, network in every[3:])
    assert (first.status, first.detail) == ("failed", "no record can be run")
    assert (second.status, second.detail) == ("failed", "singular")
    assert third.status == "diverged" and third.diverged == 2
    assert third.free_run is None and third.groups[1:] == (None,) * 3
    assert not any(row.eligible for row, _ in every[3:])


def test_one_given_up_is_skipped_and_not_remembered(data, seen, few, judged):
    low = made([1e-6] + [np.nan] * 3, detail="given up after 1 of 4 groups")
    good = made([1e-3] * 4, few[0].network())
    judged["results"] = [low, good, made([0.5] * 4, few[0].network())]
    _, every = tried(data, seen)
    row = every[3][0]
    assert row.status == "skipped" and row.detail == "given up after 1 of 4 groups"
    asked = [best for _, best in judged["asked"]]
    best = min((one.losses() for one in few), key=np.sum)
    np.testing.assert_array_equal(asked[0], best)
    np.testing.assert_array_equal(asked[1], best)
    np.testing.assert_array_equal(asked[2], [1e-3] * 4)
    assert {spread for spread, _ in judged["asked"]} == {1.5}


@pytest.mark.parametrize(
    ("share", "rule", "count"), [(1.4, "near", 4), (1.6, "near", 1), (1.6, "best", 2)]
)
def test_a_kind_that_comes_nowhere_near_is_given_up(
    data, seen, few, judged, monkeypatch, share, rule, count
):
    monkeypatch.setattr(module, "FED_PATIENCE", 1)
    best = min((one.losses() for one in few), key=np.sum)
    result = made(share**2 * best[:4], few[0].network())
    judged["results"] = [result] * 4
    patient = dataclasses.replace(TINY, fed_back=4, patience=2, rule=rule)
    assert len(tried(data, seen, patient)[1]) == 3 + count


def test_known_ones_are_not_tried_again_but_count(data, seen, few, judged):
    family, name = names(data, seen)[0]
    known = Candidate(
        "y", 4, family, name, free_run=0.03, groups=(0.03, None, 0.03, 0.03)
    )
    failed = Candidate(
        "y", 5, *names(data, seen)[1], status="failed", groups=(1e-9,) * 4
    )
    judged["results"] = [made([0.5] * 4, few[0].network())]
    found, every = tried(data, seen, known=[known, failed])
    assert [(row.family, row.name) for row, _ in every[3:]] == names(data, seen)[2:3]
    ((_, best),) = judged["asked"]
    np.testing.assert_allclose(best, [9e-4, np.nan, 9e-4, 9e-4])
    assert found.passed == 6


def test_one_candidate_at_least_whatever_the_time(data, seen, judged):
    _, every = tried(data, seen, late=lambda: True)
    assert [row.family for row, _ in every] == ["constant"]


def test_time_that_runs_out_ends_it_between_candidates(data, seen, few, judged):
    judged["results"] = [made([0.5] * 4, few[0].network())] * 3
    left = [5]

    def late():
        left[0] -= 1
        return left[0] < 0

    _, every = tried(data, seen, late=late)
    assert 3 < len(every) < 6


def test_without_feedback_nothing_is_trained_step_by_step(data, seen, judged):
    bare = dataclasses.replace(TINY, fed_back=0)
    assert len(tried(data, seen, bare)[1]) == 3 and not judged["asked"]


def test_linear_presets_have_no_regions_and_products(data, seen, judged):
    tried(data, seen, dataclasses.replace(TINY, linear=True, fed_back=0))
    assert judged["limits"]["max_models"] == judged["limits"]["degree"] == 1


def test_what_leaves_its_bounds_is_vetoed_with_its_model(
    data, seen, few, judged, monkeypatch
):
    monkeypatch.setattr(ClosedForm, "count_diverged", lambda one: 3)
    _, every = tried(data, seen, dataclasses.replace(TINY, fed_back=0))
    for (row, network), one in zip(every, few, strict=True):
        assert row.status == "diverged" and row.diverged == 3
        assert row.free_run is None and not row.eligible
        np.testing.assert_allclose(np.array(row.groups, float), one.groups())
        assert network is not None
    mean = every[0][1]
    assert mean is not None
    run = jnx.simulate(mean, data).value
    assert all(np.all(np.isfinite(y)) for y in run.outputs)


@pytest.mark.parametrize("roots", [0, 2])
def test_the_root_of_a_skewed_output_is_modelled_too(data, seen, judged, roots):
    skewed = dataclasses.replace(seen, skewness=3.5)
    preset = dataclasses.replace(TINY, fed_back=0, roots=roots)
    tried(data, skewed, preset)
    assert judged["roots"] == ([False, True] if roots else [False])
    assert judged["limits"]["grown_roots"] == (roots or TINY.grown)
    # Peaks below weigh more, not less, in a root above the least value.
    for other in (seen, dataclasses.replace(seen, skewness=-3.5)):
        judged["roots"].clear()
        tried(data, other, preset)
        assert judged["roots"] == [False]


def test_the_mean_of_the_best_of_every_kind_is_a_candidate(
    data, seen, few, judged, monkeypatch
):
    """A constant and ARX models are in none; its network is the sum of theirs."""
    search = ClosedSearch(data, seen, groups(data))
    orders = {len(f.stage.design.a) - 1: f for f in search.linear()}
    members = [*(orders[n] for n in (1, 2)), *few]
    first = min(members[:2], key=lambda one: one.free_run)
    theirs = hold_to_range(orders[3].network())
    errors = tuple((at, -1.001 * e) for at, e in first.held_out_errors())
    judged["results"] = [made(first.losses(), theirs, left=errors)]
    every = lambda self, **limits: iter(members)  # noqa: E731
    monkeypatch.setattr(module.ClosedSearch, "candidates", every)
    _, every = tried(data, seen, dataclasses.replace(TINY, sums=3, fed_back=1))
    row, both = every[-1]
    assert row.family == "sum" and both is not None
    assert (
        row.name
        == f"mean of OE, {first.name}; polynomial NARX, {names(data, seen)[0][1]}"
    )
    # Errors that are opposite are nothing together.
    assert row.free_run is not None and row.free_run < 1e-3
    assert row.one_step is None
    assert row.parameters == cost(both).parameters
    runs = [jnx.simulate(n, data).value.outputs[0] for n in (first.network(), theirs)]
    middle, run = np.mean(runs, axis=0), jnx.simulate(both, data).value.outputs[0]
    # Begun later, the first part has another start.
    assert np.abs(run - middle)[-20:].max() < 1e-3 * np.ptp(middle)


def test_a_part_that_was_judged_before_is_judged_again(data, seen, few, judged):
    """Its errors at all samples are not kept where a search is interrupted."""
    network = hold_to_range(few[1].network())
    one = made([0.04, 0.09, 0.01, 0.25], network)
    (family, name), preset = names(data, seen)[0], dataclasses.replace(TINY, sums=3)
    preset = dataclasses.replace(preset, fed_back=1)
    known = Candidate("y", 9, family, name, free_run=0.3, groups=(0.2, 0.3, 0.1, 0.5))
    judged["results"] = [one]
    _, every = tried(data, seen, preset, known=[known])
    assert len(judged["asked"]) == 1 and len(every) == len(few)


def test_candidates_of_other_packages_are_judged_behind_the_closed_forms(
    data, seen, few, judged
):
    network = few[1].network()
    judged["results"] = [made([0.04, 0.09, 0.01, 0.25], network)] * 5
    asked = []

    def theirs(records, output):
        asked.append((records, output))
        yield "first", Identification()
        yield "second", Identification(refine=None)

    _, every = tried(data, seen, added={"theirs": theirs})
    assert asked == [(data, "y")]
    found = [(row.family, row.name, row.status) for row, _ in every[3:5]]
    assert found == [("theirs", "first", "ok"), ("theirs", "second", "ok")]
    assert [(r.family, r.name) for r, _ in every[5:]] == names(data, seen)[:3]


def test_the_chosen_one_comes_once_more_with_its_nested_error(
    data, seen, few, judged, monkeypatch
):
    """One that is vetoed then makes room for the next."""
    best = min(few, key=lambda one: one.free_run)
    asked = []

    def judge(rows, remakes, records, *_):
        (row,), (remake,) = rows, remakes
        assert records is data and callable(remake)
        return [one(row)]

    def one(row):
        asked.append(row.name)
        if row.name == best.name:
            return dataclasses.replace(row, status="diverged", free_run=None)
        return dataclasses.replace(row, nested=0.5, nested_groups=(0.5,) * 4)

    monkeypatch.setattr(module, "judge_nested", judge)
    preset = dataclasses.replace(TINY, fed_back=0, rule="best")
    _, every = tried(data, seen, preset)
    assert len(every) == 5 and asked[0] == best.name and asked[1] != best.name
    (lost, none), (row, also_none) = every[3:]
    assert lost.status == "diverged" and none is also_none is None
    assert (
        row.promised == 0.5
        and row.free_run == dict((one.name, one.free_run) for one in few)[row.name]
    )
    # What is known is not judged again, nor anything where the time is up.
    asked.clear()
    tried(data, seen, preset, known=[lost, row])
    tried(data, seen, preset, late=lambda: True)
    assert not asked


def test_fewer_regions_are_made_again_beside_the_chosen_ones(
    data, seen, few, judged, monkeypatch
):
    """Of the same polynomial, those with moved gates first."""

    def divided(models, gates, share, **structure):
        stage = few[-1].stage
        stage = dataclasses.replace(stage, losses=share * stage.losses)
        name = f"{models} regions" + ", gates moved" * gates + str(structure or "")
        own = ClosedStructure(models=models, gates=gates, **structure)
        left = dict(given=few[-1].given, left_out=few[-1].left_out)
        return ClosedForm("shared feedback", name, stage, data, own, **left)

    sizes = [(2, False, 0.6), (4, False, 0.5), (8, False, 0.3), (8, True, 0.2)]
    sizes += [(4, True, 0.4), (6, False, 0.4), (7, True, 0.35)]
    every = [divided(*size) for size in sizes] + [divided(4, True, 0.4, order=2)]
    asked = []

    def judge(rows, remakes, *_):
        asked.append([row.name for row in rows])
        return [dataclasses.replace(row, nested=0.25) for row in rows]

    monkeypatch.setattr(module, "judge_nested", judge)
    monkeypatch.setattr(module.ClosedSearch, "candidates", lambda *_, **__: iter(every))
    preset = dataclasses.replace(TINY, fed_back=0, rule="best")
    _, found = tried(data, seen, preset)
    moved = [f"{models} regions, gates moved" for models in (8, 4, 7)]
    assert asked == [[*moved, "2 regions"]]
    assert [row.name for row, _ in found[-4:]] == asked[0]
    assert all(row.nested == 0.25 and network is None for row, network in found[-4:])
