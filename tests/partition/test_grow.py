"""The verb `grow` beyond LOLIMOT: given partitions, criteria, terms of their own."""

import dataclasses
from typing import Any

import jax
import numpy as np
import oracles
import pytest
from problems import ROWS, data, fitted, growth, pool, records

import jaxnarx as jnx
from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.models import Boxes, Compact, Gaussians, LogSigmoids
from jaxnarx.partition import grow
from jaxnarx.settings import ForwardOLS, Grid, Lolimot, SigmoidTree, StepwiseF
from jaxnarx.simulation import simulate

SCHEDULE = ("u1[t]", "u2[t]")


def error(network, records: Dataset) -> float:
    """NRMSE of the free run."""
    y = records.records[0].y
    return float(
        np.sqrt(np.mean((simulate(network, records).value[0] - y) ** 2)) / y.std()
    )


# partitions that are given --------------------------------------------------------


def phi_of(network, records: Dataset) -> np.ndarray:
    model = network.models[0]
    z = (records.records[0].u.T - np.asarray(model.offset)[:, None]) / np.asarray(
        model.span
    )[:, None]
    return np.asarray(_validity(model.validity, z, model.active))


_validity = jax.jit(lambda validity, z, active: validity(z, active))


def sse_of(network) -> float:
    """Squared errors of the free run, scaled."""
    error = simulate(network, data()).value[0] - data().records[0].y
    return float(np.sum(error**2) / float(network.gain[-1]) ** 2)


def test_every_local_model_of_a_grid_is_its_own_weighted_least_squares():
    solution = fitted("tiny", "grid")
    assert solution.status_name == "ok" and solution.stats["poor"] == [[]]
    u, y = data().records[0].u, data().records[0].y[:, 0]
    p = np.column_stack([np.ones(ROWS), u])
    phi = phi_of(solution.value, data())
    equations = solution.value.equations()
    assert len(equations) == 6
    for m, entry in enumerate(equations):
        expected = oracles.weighted_least_squares(p, y, phi[m])
        found = [c for _, c in entry["terms"]]
        # Normal equations: the condition squared, below 1e6 for scaled columns.
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-8)


def test_a_grid_stands_where_it_is_told_in_physical_units():
    equal = fitted("tiny", "grid").value
    third = 20 / 3
    by_hand = Grid(SCHEDULE, borders=[[10 + third, 30 - third], [0.0]])
    told = grow(pool(), data(), by_hand).value
    centres = [
        [a, b] for a in (10 + third / 2, 20.0, 30 - third / 2) for b in (-0.5, 0.5)
    ]
    widths = [[third / 3, 1 / 3]] * 6
    gaussians = grow(pool(), data(), Grid(SCHEDULE, centres=centres, widths=widths))
    for other in (told, gaussians.value):
        assert error(other, data()) == pytest.approx(error(equal, data()), rel=1e-9)
    regions = [e["region"] for e in gaussians.value.equations()]
    for region, (a, b) in zip(regions, centres, strict=True):
        assert region["u1[t]"]["centre"] == pytest.approx(a)
        assert region["u2[t]"]["centre"] == pytest.approx(b, abs=1e-12)


def test_centres_alone_have_widths_by_the_nearest_other():
    centres = [[12.0, 0.0], [16.0, 0.0], [28.0, 0.0]]
    network = grow(pool(), data(), Grid(SCHEDULE, centres=centres, k_sigma=0.5)).value
    validity = network.models[0].validity
    assert isinstance(validity, Gaussians)
    # Distances of 4, 4 and 12 of a range of 20.
    expected = 0.5 * np.array([[0.2, 0.2], [0.2, 0.2], [0.6, 0.6]])
    np.testing.assert_allclose(np.exp(validity.log_width), expected, rtol=1e-12)


def test_log_sigmoids_take_borders_or_centres_and_a_steepness_per_unit():
    one = {"validity": "log-sigmoids", "steepness": 0.4}
    first = grow(pool(), data(), Grid("u1[t]", borders=[[16.0, 22.0]], **one)).value
    middles = [[13.0], [19.0], [25.0]]
    second = grow(pool(), data(), Grid("u1[t]", centres=middles, **one)).value
    for network in (first, second):
        validity = network.models[0].validity
        assert isinstance(validity, LogSigmoids)
        np.testing.assert_allclose(validity.border, [0.3, 0.6], rtol=1e-9)
        np.testing.assert_allclose(np.exp(validity.log_steepness), 8.0, rtol=1e-9)
    assert error(first, data()) == pytest.approx(error(second, data()), rel=1e-9)


def test_a_region_without_samples_keeps_the_global_model():
    u = np.column_stack([np.linspace(0, 1, 60) ** 3, np.linspace(-1, 1, 60)])
    y = u @ [1.0, 2.0] + 3
    few = records("tiny", u, y)
    # The data run along a curve: corners of the grid are empty.
    method = Grid(SCHEDULE, models=(3, 3), validity="boxes")
    solution = grow(pool(), few, method)
    assert solution.status_name == "unidentifiable"
    assert "have fewer samples than parameters" in solution.detail
    assert 0 < len(solution.stats["poor"][0]) < 9
    assert error(solution.value, few) < 1e-9
    for entry in solution.value.equations():
        terms = dict(entry["terms"])
        assert np.all(np.isfinite(list(terms.values())))


@pytest.mark.parametrize(
    ("settings", "field"),
    [
        ({}, "models"),
        ({"models": (2, 2), "centres": [[1.0, 2.0]]}, "models"),
        ({"models": (2,)}, "models"),
        ({"models": (2, 0)}, "models"),
        ({"borders": [[3.0, 2.0], [1.0]]}, "borders"),
        ({"centres": [[1.0, 2.0], [1.0, 2.0]]}, "centres"),
        ({"centres": [[1.0]]}, "centres"),
        ({"centres": [[1.0, 2.0]], "widths": [[0.0, 1.0]]}, "widths"),
        ({"centres": [[1.0, 2.0]], "widths": [[1.0, 1.0]] * 2}, "widths"),
        ({"centres": [[1.0, 2.0]], "validity": "boxes"}, "validity"),
        ({"models": (2, 2), "validity": "log-sigmoids"}, "validity"),
        ({"models": (2, 2), "steepness": 0.0}, "steepness"),
        ({"models": (2, 2), "ridge": -1.0}, "ridge"),
        ({"models": (2, 2), "ridge": 1.0, "local": ForwardOLS()}, "ridge"),
    ],
)
def test_impossible_grids_are_refused(settings, field):
    with pytest.raises(SpecError) as caught:
        Grid(SCHEDULE, **settings)
    assert caught.value.field == field


def test_a_border_outside_the_data_is_refused_by_name():
    with pytest.raises(SpecError, match=r"border of u1\[t\].*10 to 30.*45"):
        grow(pool(), data(), Grid(SCHEDULE, borders=[[45.0], [0.0]]))


def test_a_scheduling_variable_named_twice_is_refused():
    with pytest.raises(SpecError, match="named twice"):
        SigmoidTree(("u1[t]", "u1[t]"))


# growth ---------------------------------------------------------------------------

KINDS = {"gaussians": Gaussians, "compact": Compact, "boxes": Boxes}


@pytest.mark.parametrize("how", [*KINDS, "tree", "straight"])
def test_what_growth_reports_is_what_the_network_does(how):
    """Boxes speak through all curves; a gate of a tree is of one variable or turned."""
    solution = fitted("tiny", how)
    np.testing.assert_allclose(
        solution.stats["sse"][0][-1], sse_of(solution.value), rtol=1e-9
    )
    assert solution.stats["stopped"] == ["capacity"] and solution.status_name == "ok"
    if how in KINDS:
        assert isinstance(solution.value.models[0].validity, KINDS[how])
        return
    # One plane leaves 0.42 of the standard deviation of this surface.
    assert error(solution.value, data()) < 0.2
    (first, *_) = (e["region"] for e in solution.value.equations())
    # A combination of variables has spaces, one variable has none.
    assert first and all((" " in name) == (how == "tree") for name in first)


def test_the_thesis_splits_the_model_with_the_largest_local_nmse():
    # Box 1 after one split holds nearly all squared error and all variance; the rest
    # of the signal is small noise, all of it unexplained.
    rng = np.random.default_rng(1)
    u = np.column_stack([np.linspace(0, 1, 400), rng.uniform(size=400)])
    y = np.where(u[:, 0] < 0.5, 50 * np.sin(6 * u[:, 0]), 0.1 * rng.normal(size=400))
    two = records("tiny", u, y)
    found = {}
    for worst in ("squares", "nmse"):
        method = Lolimot(
            "u1[t]", max_models=3, criterion="none", worst=worst, validity="boxes"
        )
        network = grow(pool(), two, method).value
        regions = [e["region"]["u1[t]"] for e in network.equations()]
        found[worst] = sorted(r["above"] for r in regions)
    np.testing.assert_allclose(found["squares"], [0.0, 0.25, 0.5])
    np.testing.assert_allclose(found["nmse"], [0.0, 0.5, 0.75])


def test_the_validation_criterion_keeps_the_best_free_run():
    method = Lolimot(SCHEDULE, max_models=5, criterion="validation", patience=9)
    fresh = data(seed=1)
    solution = grow(pool(), data(), method, validation=fresh)
    scores = solution.stats["validation"][0]
    best = solution.stats["best"][0]
    assert best == np.argmin(scores)
    np.testing.assert_allclose(error(solution.value, fresh), scores[best], rtol=1e-9)
    with pytest.raises(SpecError, match="validation=") as caught:
        grow(pool(), data(), method)
    assert caught.value.field == "validation"


def test_bic_asks_more_of_a_model_than_aicc():
    stats = grow(pool(), data(), Lolimot(SCHEDULE, max_models=5)).stats
    sse, n = stats["sse"][0], stats["effective"][0]
    expected = ROWS * np.log(sse / ROWS) + n * np.log(ROWS)
    np.testing.assert_allclose(stats["bic"][0], expected, rtol=1e-12)


def test_a_strong_ridge_leaves_the_model_that_was_split():
    def fitted(ridge: float):
        method = Lolimot(SCHEDULE, max_models=5, criterion="none", ridge=ridge)
        return grow(pool(), data(), method).value.models[0].local.coefficient

    parent = grow(pool(), data(), Lolimot(SCHEDULE, max_models=1, ridge=1.0))
    # The first model has nothing to be pulled to: all three parameters count.
    assert parent.stats["effective"][0][0] == pytest.approx(3.0, rel=1e-9)
    whole = parent.value.models[0].local.coefficient[0]
    np.testing.assert_allclose(fitted(1e9) - whole[None], 0.0, atol=1e-6)
    assert np.abs(fitted(0.0) - whole[None]).max() > 0.1


def test_a_least_number_of_samples_stops_the_growth():
    method = Lolimot(SCHEDULE, max_models=5, criterion="none", least=50.0)
    solution = grow(pool(), data(), method)
    assert solution.stats["stopped"] == ["data"]
    assert solution.stats["least"] == [50.0]
    assert "fewer than 50 samples" in solution.detail
    assert phi_of(solution.value, data()).sum(axis=1).min() >= 50.0


def test_a_pruned_tree_has_the_smaller_criterion():
    method = dataclasses.replace(growth("tiny")["tree"], prune=True)
    # A ramp, and a plane beyond it: some gates of four are not needed.
    u = data().records[0].u
    y = np.maximum(u[:, 0], 20.0) + 0.05 * np.random.default_rng(5).normal(size=ROWS)
    ramp = records("tiny", u, y)
    solution = grow(pool(), ramp, method)
    count = solution.stats["pruned_to"][0]
    assert 2 <= count < solution.stats["models"][0][-1] == 5
    assert int(solution.value.models[0].active.sum()) == count
    # Noise is 0.05 of a standard deviation of 3.5.
    assert error(solution.value, ramp) < 0.03


def test_a_tree_of_one_leaf_is_the_plain_model():
    one = grow(pool(), data(), SigmoidTree(SCHEDULE, max_models=1)).value
    plain = fitted("tiny", "global").value
    assert error(one, data()) == pytest.approx(error(plain, data()), rel=1e-9)


# terms of their own ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "local"),
    [
        pytest.param(Lolimot, StepwiseF(max_terms=4), marks=pytest.mark.slow),
        (SigmoidTree, ForwardOLS(max_terms=4)),
        (Grid, StepwiseF(max_terms=4)),
    ],
)
def test_every_region_chooses_its_own_terms(make, local):
    settings: dict[str, Any] = {"max_models": 3}
    if make is Grid:
        settings = {"models": (3, 1)}
    solution = grow(pool(degree=3), data(), make(SCHEDULE, local=local, **settings))
    network = solution.value
    phi = phi_of(network, data())
    for m, entry in enumerate(network.equations()):
        chosen = jnx.select(pool(degree=3), data(), local, weights=[phi[m]]).value
        assert [n for n, _ in entry["terms"]] == sorted(
            chosen.names, key=pool(degree=3).names.index
        )
        assert 1 < len(entry["terms"]) <= 4
    assert error(network, data()) < 0.1


def test_too_many_candidates_for_local_choice_are_refused(monkeypatch):
    monkeypatch.setattr("jaxnarx.selection.custom_selector.MOST_BYTES", 1000)
    with pytest.raises(SpecError, match="choose among them first") as caught:
        grow(pool(degree=3), data(), Lolimot(SCHEDULE, local=ForwardOLS(max_terms=4)))
    assert caught.value.field == "local"


# bad input ------------------------------------------------------------------------


@pytest.mark.parametrize("how", ["gaussians", "tree"])
def test_collinear_scheduling_variables_are_no_harm(how):
    u = data().records[0].u
    twice = np.column_stack([u[:, 0], 3 * u[:, 0] + 1])
    both = records("tiny", twice, data().records[0].y)
    solution = grow(pool(), both, growth("tiny", criterion="aicc")[how])
    assert solution.is_okay
    assert error(solution.value, both) < 0.5


@pytest.mark.parametrize("how", ["gaussians", "tree"])
def test_far_outside_the_training_range_a_model_still_answers(how):
    far = records("tiny", np.array([[1e4, -1e4], [20.0, 0.0]]), np.zeros(2))
    run = simulate(fitted("tiny", how).value, far).value
    assert np.all(np.isfinite(run[0]))
    np.testing.assert_array_equal(run.extrapolated[0], [True, False])


@pytest.mark.parametrize("make", [Lolimot, SigmoidTree, Grid])
def test_a_constant_scheduling_variable_is_refused_by_name(make):
    u = data().records[0].u
    still = np.column_stack([u[:, 0], np.full(ROWS, 7.0)])
    flat = records("tiny", still, data().records[0].y)
    settings: dict[str, Any] = {"models": (2, 2)} if make is Grid else {}
    constant = r"u2\[t\] is constant \(7\).*choose"
    with pytest.raises(DataError, match=constant) as caught:
        grow(pool(), flat, make(SCHEDULE, **settings))
    assert caught.value.channel == "u2"
