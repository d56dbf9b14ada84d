"""Errors on groups left out, against least squares and runs in NumPy."""

import dataclasses

import common
import jax
import numpy as np
import pytest
from search_problems import LENGTHS, explosive, plant

from jaxnarx.data import groups, thin_records
from jaxnarx.identification import cross_validate as module
from jaxnarx.identification.cross_validate import HOPELESS_FACTORS, CrossValidation
from jaxnarx.models._assemble import OUTPUT_MARGIN
from jaxnarx.partition import ClosedSearch, profile_data
from jaxnarx.settings import (
    ForwardOLS,
    Global,
    Identification,
    Lolimot,
    Polynomial,
    SimulationError,
)

METHOD = Identification(
    pool=Polynomial(outputs="y", input_lags=(1,), output_lags=(1,), degree=1),
    select=ForwardOLS(max_terms=3),
    grow=Global(),
    refine=None,
)
"""y(t) = c + b u(t-1) - a y(t-1), by least squares one step ahead."""
SPREAD = 2.5


def judge(*args, **more) -> CrossValidation:
    """The outcome of a method that ends with one network."""
    (one,) = module.cross_validate(*args, **more)
    return one


def trained(*args):
    (network,) = module.fit_method(*args)
    return network


@pytest.fixture(scope="module")
def data():
    return plant()


@pytest.fixture(scope="module")
def found(data) -> CrossValidation:
    return judge(METHOD, data, groups(data), SPREAD)


def rows_of(record):
    u, y = record.u[:, 0], record.y[:, 0]
    return np.stack([np.ones(len(u) - 1), u[:-1], y[:-1]], axis=1), y[1:]


def slow(data, without: int):
    """Mean squared errors of a free run and one step ahead, held to the range of all
    records."""
    kept = [r for n, r in enumerate(data) if n != without]
    parts = [rows_of(r) for r in kept]
    rows = np.concatenate([p[0] for p in parts])
    theta = np.linalg.lstsq(rows, np.concatenate([p[1] for p in parts]))[0]
    u, y = (np.concatenate([getattr(r, k)[:, 0] for r in data]) for k in "uy")
    wider = 0.02 * (y.max() - y.min())

    def held(values):
        return np.clip(values, y.min() - wider, y.max() + wider)

    record = data.records[without]
    inside, run = np.clip(record.u[:, 0], u.min(), u.max()), [record.y[0, 0]]
    for value in inside[:-1]:
        run.append(float(theta @ [1.0, value, run[-1]]))
    ahead = rows_of(record)[0]
    ahead[:, 1] = inside[:-1]
    measured = record.y[1:, 0]
    errors = measured - held(np.array(run[1:])), measured - held(ahead @ theta)
    return [np.mean(e**2) / SPREAD**2 for e in errors]


def test_every_group_is_judged_by_a_model_of_the_others(data, found):
    assert found.complete and found.network is not None and found.diverged == 0
    assert found.counts.tolist() == [n - 1 for n in LENGTHS]
    expected = np.array([slow(data, g) for g in range(len(LENGTHS))])
    np.testing.assert_allclose(found.losses, expected[:, 0], rtol=1e-6)
    ahead = np.sqrt(np.average(expected[:, 1], weights=found.counts))
    np.testing.assert_allclose(found.one_step, ahead, rtol=1e-6)


@pytest.mark.parametrize("blocks", [False, True])
def test_all_candidates_of_a_search_are_judged_by_the_same_samples(blocks):
    data = plant(lengths=(450,)) if blocks else plant()
    seen, own = profile_data(data, "y"), groups(data, gap=9)
    closed = ClosedSearch(data, seen, own)
    for candidate in (closed.constant(), next(closed.linear())):
        counts = candidate.stage.design.equations.judged
        ours = judge(METHOD, data, own, 1.0, begin=seen.begin).counts
        np.testing.assert_array_equal(ours, counts)
        labelled = sum(int(np.sum(label >= 0)) for label in own.labels)
        assert counts.sum() == labelled - len(data) * seen.begin


def test_the_model_is_that_of_all_records_and_held(data, found):
    assert found.network is not None and found.network.hold is not None
    parts = [rows_of(r) for r in data]
    rows, right = (np.concatenate(p) for p in zip(*parts, strict=True))
    theta = np.linalg.lstsq(rows, right)[0]
    (told,) = found.network.equations()
    named = dict(told["terms"])
    own = [named["1"], named["u[t-1]"], named["y[t-1]"]]
    np.testing.assert_allclose(own, theta, rtol=1e-7)


def test_long_records_train_by_stretches_and_are_held_to_all_that_is_known(data):
    some = thin_records(data, data.samples // 2)
    network = trained(METHOD, data, data.samples // 2)
    expected = trained(METHOD, some)
    (own,), (same,) = network.equations(), expected.equations()
    assert own["terms"] == same["terms"], "of the stretches alone"
    np.testing.assert_array_equal(network.low[0], min(r.u.min() for r in data))
    np.testing.assert_array_equal(network.high[1], max(r.y.max() for r in data))
    y = np.concatenate([r.y[:, 0] for r in data]) / float(network.gain[1])
    wider = OUTPUT_MARGIN * np.ptp(y)
    np.testing.assert_allclose(network.lower[0], y.min() - wider, rtol=1e-12)
    np.testing.assert_allclose(network.upper[0], y.max() + wider, rtol=1e-12)


def test_one_that_is_far_behind_is_given_up(data, found):
    many = judge(METHOD, data, groups(data), SPREAD, found.losses / 10)
    assert many.network is None and not many.complete
    assert many.detail == f"given up after 1 of {len(LENGTHS)} groups"
    assert many.losses[0] == found.losses[0] and np.isnan(many.losses[1:]).all()
    # Between the two limits the first group is no reason yet, two are.
    between = HOPELESS_FACTORS[0] * HOPELESS_FACTORS[1]
    two = judge(METHOD, data, groups(data), SPREAD, found.losses / between)
    assert two.detail == f"given up after 2 of {len(LENGTHS)} groups"


def test_one_that_is_not_far_behind_is_tried_on_every_group(data, found):
    close = judge(METHOD, data, groups(data), SPREAD, found.losses / 1.4**2)
    assert close.complete and close.network is not None
    np.testing.assert_array_equal(close.losses, found.losses)


def test_what_runs_away_is_given_up_at_once():
    data = explosive()
    wild = judge(METHOD, data, groups(data), float(np.std(data.records[0].y)))
    assert wild.diverged >= 1 and wild.detail == "diverges"
    assert wild.network is None and not wild.complete


def test_blocks_of_one_record():
    data = plant(1, (300,))
    own = groups(data, gap=5)
    assert not own.whole
    found = judge(METHOD, data, own, SPREAD)
    assert found.complete and np.all(found.losses < 0.05)
    (label,) = own.labels
    # A run begins with the record, so the first sample alone is not judged.
    sizes = [int(np.sum(label[1:] == g)) for g in range(len(own))]
    assert found.counts.tolist() == sizes


def test_a_group_too_short_to_be_run_is_passed_over():
    data = plant(1, (150, 160, 140, 1))
    found = judge(METHOD, data, groups(data), SPREAD)
    assert np.isfinite(found.losses).sum() == 3 and found.network is not None


REFINED = dataclasses.replace(
    METHOD,
    grow=Lolimot(scheduling=["u[t-1]"], max_models=2),
    refine=SimulationError(horizons=(10,), window_steps=2, max_steps=4),
)


@pytest.mark.slow
def test_programs_of_the_first_fold_serve_the_others_and_all_records():
    data = plant(1, (150, 170, 290, 90, 160))
    own = groups(data, folds=3)
    first, *others = own.folds(data, whole=True)
    jax.clear_caches()
    assert common.compilations(lambda: trained(REFINED, first.train)) > 0
    for fold in others:
        assert common.compilations(lambda fold=fold: trained(REFINED, fold.train)) == 0
    assert common.compilations(lambda: trained(REFINED, data)) == 0


def test_records_of_which_nothing_counts_change_no_model():
    data = plant(1, (150, 170, 290, 90, 160))
    own = groups(data, folds=3)
    for fold, kept in zip(own.folds(data), own.folds(data, whole=True), strict=True):
        assert len(fold.train) < len(kept.train) == len(data)
        pairs = [trained(REFINED, train) for train in (fold.train, kept.train)]
        for one, two in zip(*map(jax.tree.leaves, pairs), strict=True):
            # Sums over other paddings round differently, and steps carry that on.
            np.testing.assert_allclose(one, two, rtol=1e-6, atol=1e-9)
