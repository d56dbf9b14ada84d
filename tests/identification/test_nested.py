"""Nested errors, against the same fold by fold."""

import dataclasses
import functools

import numpy as np
import pytest
from search_problems import plant

import jaxnarx as jnx
from jaxnarx.data import Groups, groups
from jaxnarx.errors import DataError
from jaxnarx.identification import nested
from jaxnarx.identification.cross_validate import cross_validate
from jaxnarx.identification.leaderboard import Candidate
from jaxnarx.identification.narx_candidates import propose_narx
from jaxnarx.identification.nested import (
    Remade,
    Retraining,
    errors_of_fold,
    judge_nested,
    remake_mean,
    repeat_closed_form,
)
from jaxnarx.models import hold_to_range
from jaxnarx.partition import ClosedSearch, ClosedStructure, profile_data

ROW = Candidate("y", 3, "OE", "order 1", free_run=0.1, groups=(0.1,) * 4)
SPREAD = 2.0


@pytest.fixture(scope="module")
def data():
    return plant()


@pytest.fixture(scope="module")
def seen(data):
    return profile_data(data, "y")


def judge_one(row, remake, *rest):
    """The nested errors of one candidate."""
    return judge_nested([row], [remake], *rest)[0]


def remake(fold):
    """A model of first order."""
    search = ClosedSearch(fold.train, fold.profile, fold.groups)
    return fold.run(hold_to_range(next(search.linear()).network()))


def test_every_group_is_run_by_a_model_that_knows_nothing_of_it(data, seen):
    found, told = groups(data), []
    row = judge_one(ROW, remake, data, found, seen, SPREAD, told.append)
    assert told == [1, 2, 3, 4]
    losses, counts = [], []
    for g in range(4):
        train = data[[n for n in range(4) if n != g]]
        own = profile_data(train, "y")
        network = hold_to_range(
            next(ClosedSearch(train, own, groups(train)).linear()).network()
        )
        run = jnx.simulate(network, data[[g]]).value
        at = np.arange(len(data.records[g])) >= seen.begin
        at &= run.scored[0][:, 0]
        error = (run.outputs[0][:, 0] - data.records[g].y[:, 0])[at] / SPREAD
        losses.append(np.mean(error**2))
        counts.append(at.sum())
    np.testing.assert_allclose(np.array(row.nested_groups) ** 2, losses, rtol=1e-9)
    assert row.nested == pytest.approx(np.average(losses, weights=counts) ** 0.5)
    assert row.promised == row.nested and row.promised_groups == row.nested_groups
    assert dataclasses.replace(row, nested=None, nested_groups=()) == ROW
    assert ROW.promised == ROW.free_run and ROW.promised_groups == ROW.groups


def test_a_group_without_which_nothing_can_be_made_has_no_error(data, seen):
    def fail(fold):
        if fold.train.names[0] != data.names[0]:
            raise DataError("nothing to be made")
        return remake(fold)

    row = judge_one(ROW, fail, data, groups(data), seen, SPREAD)
    assert row.nested_groups[0] is None and None not in row.nested_groups[1:]
    weights = [len(r) - seen.begin for r in data.records[1:]]
    losses = np.array(row.nested_groups[1:], float) ** 2
    assert row.nested == pytest.approx(np.average(losses, weights=weights) ** 0.5, 0.01)

    def never(fold):
        raise np.linalg.LinAlgError

    assert judge_one(ROW, never, data, groups(data), seen, SPREAD) == ROW


def test_one_that_diverges_without_a_group_is_vetoed(data, seen):
    def explode(fold):
        network = next(
            ClosedSearch(fold.train, fold.profile, fold.groups).linear()
        ).network()
        (model,) = network.models
        wild = dataclasses.replace(
            model.local, coefficient=1e3 * model.local.coefficient
        )
        wild = dataclasses.replace(model, local=wild)
        return fold.run(dataclasses.replace(network, models=(wild,)))

    row = judge_one(ROW, explode, data, groups(data), seen, SPREAD)
    assert row.status == "diverged" and not row.eligible and row.diverged >= 1
    assert data.names[0] in row.detail


def test_of_two_groups_none_is_left_to_choose_by(data, seen):
    two = Groups(
        ("a", "b"), tuple(np.full(len(r), n % 2) for n, r in enumerate(data)), True
    )
    assert judge_one(ROW, remake, data, two, seen, SPREAD) is ROW


def test_the_promise_is_that_of_one_group_more(data, seen):
    """Errors that lack one group over errors that lack two, at most one."""
    row = dataclasses.replace(ROW, free_run=0.01)
    again = functools.partial(
        repeat_closed_form, "OE", ClosedStructure(order=1), {}, {"root": False}
    )
    judged = judge_one(row, again, data, groups(data), seen, SPREAD)
    errors, counts = [], []
    for g in range(4):
        train = data[[n for n in range(4) if n != g]]
        search = ClosedSearch(train, profile_data(train, "y"), groups(train))
        errors.append(next(search.linear()).free_run * search.spread / SPREAD)
        counts.append(len(data.records[g]) - seen.begin)
    inner = np.average(np.square(errors), weights=counts) ** 0.5
    factor = judged.data_factor
    assert factor == pytest.approx(0.01 / inner, rel=1e-3)
    promised = np.array([judged.promised, *judged.promised_groups], float)
    before = np.array([judged.nested, *judged.nested_groups], float)
    np.testing.assert_allclose(promised, factor * before)
    worse = dataclasses.replace(row, free_run=100.0)
    assert judge_one(worse, again, data, groups(data), seen, SPREAD).data_factor == 1


def test_a_mean_is_that_of_candidates_made_again(data, seen):
    def second(fold):
        places, errors = remake(fold).errors
        return Remade((places[5:], 3 * errors[5:]), 0)

    row = judge_one(
        ROW,
        functools.partial(remake_mean, [remake, second]),
        data,
        groups(data),
        seen,
        SPREAD,
    )
    one = judge_one(ROW, remake, data, groups(data), seen, SPREAD)
    assert one.nested is not None
    assert row.nested == pytest.approx(2 * one.nested, rel=0.05)
    known = [(np.arange(3), np.full(3, float(g))) for g in range(4)]
    kept = judge_one(
        ROW,
        functools.partial(errors_of_fold, known),
        data,
        groups(data),
        seen,
        SPREAD,
    )
    assert kept.nested_groups == pytest.approx((0, 1, 2, 3))


def test_what_is_made_again_knows_its_structure_alone(data, seen, monkeypatch):
    """A closed form, and a method with the rows of its fold."""
    again = functools.partial(
        repeat_closed_form, "OE", ClosedStructure(order=1), {}, {"root": False}
    )
    row = judge_one(ROW, again, data, groups(data), seen, SPREAD)
    one = judge_one(ROW, remake, data, groups(data), seen, SPREAD)
    assert one.data_factor is None
    assert dataclasses.replace(row, data_factor=None) == one
    method = next(m for _, _, m in propose_narx(data, seen))
    plain = dataclasses.replace(method, refine=None)
    anew, known = Retraining(plain, 10_000), groups(data)
    again = functools.partial(anew.run, 0)
    row = judge_one(ROW, again, data, known, seen, 1.0)
    # What it has trained serves its other candidates too.
    assert sorted(anew.networks) == list(range(len(known)))
    monkeypatch.setattr(nested, "fit_method", None)
    assert judge_one(ROW, again, data, known, seen, 1.0) == row
    left = cross_validate(plain, data, groups(data), 1.0, one_step=False)[0]
    # Its terms are chosen there too; inputs that lags begin at are those of all here.
    assert row.nested == pytest.approx(
        np.average(left.losses, weights=left.counts) ** 0.5, rel=0.05
    )
