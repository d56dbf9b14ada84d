"""Fused identification against the verbs one by one, and lanes against each other."""

import dataclasses
import json
import pickle

import equinox as eqx
import jax
import numpy as np
import pytest
from identify_problems import CASES, METHOD, engine, fleet_of, parts, replaced

from jaxnarx.data import Dataset, Fleet
from jaxnarx.evaluation import report
from jaxnarx.identification import identify
from jaxnarx.models import Gaussians
from jaxnarx.settings.tree import replace_at
from jaxnarx.simulation import simulate
from jaxnarx.sweep.identify import identify_each, network_of, program
from jaxnarx.sweep.identify.engine_data import stack_lanes
from jaxnarx.sweep.identify.rows import score_names
from jaxnarx.sweep.identify.work import IdentificationWork

LANES = 2
NAMES = {"train": "train", "validate": "validation", "test": "test"}


@pytest.fixture(scope="module")
def engines() -> dict[str, Dataset]:
    # Records of different lengths: what is padded must have no effect.
    return {
        "one": engine(1),
        "two": engine(2, lengths=(80, 70, 60)),
        "three": engine(3, lengths=(90, 60, 70)),
    }


@pytest.fixture(scope="module")
def rows(engines) -> list[dict]:
    return identify_each(fleet_of(engines), METHOD, CASES, chunk=LANES)


def plain(data: Dataset, case: dict):
    """The same by the verbs, and both reports."""
    train, validation, test = parts(data)
    fit = identify(train, replace_at(METHOD, case), validation=validation)
    records = {"train": train, "validate": validation, "test": test}
    grown = fit.stats["grown"].value
    terms, refined = fit.stats["selection"].value, fit.stats["refined"]
    return terms, refined, report(grown, records), report(fit.value, records)


@pytest.mark.parametrize(
    ("name", "case"), [("one", 0), pytest.param("two", 1, marks=pytest.mark.slow)]
)
def test_a_row_is_what_the_verbs_find_one_by_one(engines, rows, name, case):
    (row,) = [r for r in rows if r["engine"] == name and r["case"] == case]
    terms, refined, before, after = plain(engines[name], CASES[case])
    assert row["term_index"] == terms.terms(0)
    assert row["term_names"] == [terms.pool.name(t) for t in terms.terms(0)]
    model = refined.value.models[0]
    # The rows are the same but for zeros of weight zero, so sums round differently; the
    # normal equations (condition 1e4 to 1e6) and a few steps pass that on.
    validity = model.validity
    assert isinstance(validity, Gaussians)
    for name, theirs in (
        ("coefficient", model.local.coefficient),
        ("centre", validity.centre),
        ("width", np.exp(validity.log_width)),
    ):
        np.testing.assert_allclose(row[name], np.ravel(theirs), rtol=1e-7, atol=1e-9)
    for told, when in ((before, "_start"), (after, "")):
        for part, ours in NAMES.items():
            for mode in ("one step", "free run"):
                nrmse = told.pooled_row("y", part=part, mode=mode).nrmse
                key = f"{ours}_{mode.replace(' ', '_')}{when}"
                assert row[key] == pytest.approx(nrmse, rel=1e-7), key
    losses = [h["loss"] for h in refined.stats["history"]]
    full = 3 + 1  # steps of METHOD
    # The first turn of a stage takes stock; only a staged case has two.
    ours = row["loss_history"][full + 1 :]
    if "refine.train" not in CASES[case]:
        ours = row["loss_history"][1:full] + ours
    np.testing.assert_allclose(ours[: len(losses)], losses, rtol=1e-7)


def test_refinement_is_never_worse_by_the_records_that_judge(rows):
    for row in rows:
        assert row["status"] in ("ok", "no_improvement")
        # To rounding: the guard sums squares, the score takes roots of means.
        start = row["validation_free_run_start"]
        assert row["validation_free_run"] <= start * (1 + 1e-12)
    gains = [r["validation_free_run"] / r["validation_free_run_start"] for r in rows]
    assert min(gains) < 0.99, "no case was refined at all"


def test_a_row_is_a_network_again(engines, rows):
    work = IdentificationWork(fleet_of(engines), METHOD, CASES)
    for row in rows[::3]:
        network = network_of(work, row)
        test = engines[row["engine"]][2]
        run = simulate(network, test).value
        y, mask = test.records[0].y, run.scored[0]
        error = np.sqrt(np.mean((y - run[0])[mask] ** 2)) / np.std(y[mask])
        assert row["test_free_run"] == pytest.approx(error, rel=1e-9)
        assert row["model_count"] == network.models[0].active.size


def compare(found: list[dict], expected: list[dict], rtol: float) -> None:
    assert [r["status"] for r in found] == [r["status"] for r in expected]
    assert [r["term_index"] for r in found] == [r["term_index"] for r in expected]
    assert [r["model_count"] for r in found] == [r["model_count"] for r in expected]
    for name in score_names():
        np.testing.assert_allclose(
            [r[name] for r in found], [r[name] for r in expected], rtol=rtol
        )


def padded(fleet: Fleet) -> Fleet:
    """With longer padding, and records that are nothing else."""
    assert fleet.validation is not None
    _, records, time, _ = fleet.train.signals.shape
    return dataclasses.replace(
        fleet,
        train=fleet.train.widen(records + 1, time + 7),
        validation=fleet.validation.widen(records + 2, 77),
    )


@pytest.mark.slow
def test_padded_lanes_side_by_side_equal_bare_lanes_in_turn(engines, rows):
    # Both in one test, as every shape and every way compiles anew. Batched sums round
    # differently.
    fleet = padded(fleet_of(engines))
    side = identify_each(fleet, METHOD, CASES, batch="vmap", chunk=LANES)
    compare(side, rows, 1e-6)


@pytest.mark.slow
def test_padding_alone_has_no_effect(engines, rows):
    fleet = padded(fleet_of({"one": engines["one"]}))
    found = identify_each(fleet, METHOD, CASES, chunk=LANES)
    compare(found, [r for r in rows if r["engine"] == "one"], 1e-9)


@pytest.mark.slow
def test_lanes_one_by_one_equal_lanes_in_a_chunk(engines, rows):
    one_by_one = identify_each(fleet_of(engines), METHOD, CASES, chunk=1)
    compare(one_by_one, rows, 1e-12)


def test_one_compilation_serves_all_cases_and_members(engines, rows, monkeypatch):
    traced = []
    kernel = program.identify_lane

    def counted(*args):
        traced.append(1)
        return kernel(*args)

    monkeypatch.setattr(program, "identify_lane", counted)
    fleet = fleet_of(engines)
    cases = [
        {
            "select.max_terms": 2,
            "grow.max_models": 1,
            "grow.k_sigma": 0.2,
            "refine.ridge": 0.0,
            "refine.max_steps": 1,
        },
        {
            "refine.train": "partition",
            "select.rho": 1e-2,
            "pool.input_lags": {"a": (0,), "b": (0, 1)},
            "grow.scatter": 0.5,
            "grow.seed": 3,
        },
        {"refine": "none", "pool.output_lags": (1,)},
    ]
    found = identify_each(fleet, METHOD, cases, ["two", 0], chunk=LANES)
    assert not traced, "a program for other settings than those of the fixture"
    assert [r["engine"] for r in found] == ["two"] * 3 + ["one"] * 3
    small, moved, none = found[:3]
    assert small["term_count"] == 2 and small["model_count"] == 1
    assert not any("a[t-1]" in name for name in moved["term_names"])
    assert not any("t-2" in name for name in none["term_names"])
    assert none["steps_taken"] == 0
    assert none["test_free_run"] == none["test_free_run_start"]
    more = replace_at(
        METHOD, {"select.max_terms": 4, "grow.max_models": 1, "refine.max_steps": 1}
    )
    identify_each(fleet, more, [{}], ["one"], chunk=1)
    assert len(traced) == 1, "the counter does not see compilations"


def test_what_is_not_trained_stays(engines):
    kinds = ("coefficients", "partition")
    cases = [{"refine": "none"}, *({"refine.train": kind} for kind in kinds)]
    fleet = fleet_of({"one": engines["one"], "two": engines["two"]})
    rows = identify_each(fleet, METHOD, cases, ["one"], chunk=LANES)
    none, coefficients, partition = rows
    assert coefficients["centre"] == none["centre"]
    assert coefficients["coefficient"] != none["coefficient"]
    assert partition["coefficient"] == none["coefficient"]
    assert partition["centre"] != none["centre"]


def test_a_bad_engine_is_flagged_alone(engines, rows):
    broken, (train, *_) = engine(4), engines["one"].records
    short = {"u": train.u[:4], "y": train.y[:4], "valid": train.valid[:4]}
    fleet = fleet_of(
        {
            "one": engines["one"],
            "nan": replaced(broken, 1, y=np.full_like(broken.records[1].y, np.nan)),
            "still": replaced(broken, 0, y=np.ones_like(broken.records[0].y)),
            "short": replaced(broken, 0, **short),
            "wild": engine(5, scale=6.0),
            "two": engines["two"],
        }
    )
    found = identify_each(fleet, METHOD, CASES, chunk=LANES)
    status = {r["engine"]: r["status"] for r in found[::2]}
    assert status["nan"] == "nonfinite_data"
    assert status["still"] == "unidentifiable"
    assert status["short"] == "too_short"
    assert status["wild"] == "start_diverged"
    assert all(list(r) == list(found[0]) for r in found)
    wild = [r for r in found if r["engine"] == "wild"]
    assert all(r["validation_free_run"] == float("inf") for r in wild)
    assert all(r["validation_free_run_diverged"] for r in wild)
    numbers = [v for r in found for v in r.values() if isinstance(v, float)]
    assert not np.any(np.isnan(numbers))
    for name in ("one", "two"):
        own = [r for r in found if r["engine"] == name]
        compare(own, [r for r in rows if r["engine"] == name], 1e-12)


def test_work_for_the_run_folder(engines, rows):
    work = IdentificationWork(fleet_of(engines), METHOD, CASES, lanes=LANES)
    again = pickle.loads(pickle.dumps(work))
    assert json.loads(json.dumps(again.describe())) == work.describe()
    assert again.members == work.members
    json.dumps(work.members, allow_nan=False)
    # Any chunk of indices in any order, the last call filled up.
    found = again.run([5, 0, 3])
    for index, row in zip([5, 0, 3], found, strict=True):
        assert again.members[index] | row == rows[index]
    other = IdentificationWork(fleet_of(engines), METHOD, CASES[:1], lanes=LANES)
    assert other.describe() != work.describe()


@pytest.mark.slow
@pytest.mark.parametrize("platform", ["cuda", "tpu"])
def test_the_program_is_lowered_for_devices_that_are_not_here(engines, platform):
    work = IdentificationWork(fleet_of(engines), METHOD, CASES, lanes=LANES)
    shape = next(iter(work.frames))
    members = stack_lanes([work.prepare_case(n, 0).member for n in range(LANES)])
    settings = stack_lanes([work.settings[0]] * LANES)
    given = work.frames[shape], members, settings
    arrays, fixed = eqx.partition(given, eqx.is_array)

    def lanes(arrays):
        return program.identify_lanes(*eqx.combine(arrays, fixed), at_once=1)

    numbers = lambda *args: eqx.filter(lanes(*args), eqx.is_array)  # noqa: E731
    made = jax.export.export(jax.jit(numbers), platforms=[platform])(arrays)
    assert "callback" not in made.mlir_module()
