"""Grids and random points of a sweep, and what cases and identifications refuse."""

import json

import numpy as np
import pytest

from jaxnarx.errors import SpecError
from jaxnarx.methods import Case, Identification
from jaxnarx.sweep.cases import grid_cases, random_cases
from jaxnarx.sweep.identify.settings import within


def test_a_grid_is_the_product_with_the_last_setting_fastest():
    cases = grid_cases(ridge=[0.0, 1e-3], terms=[4, 6, 8])
    assert [(c.ridge, c.terms) for c in cases] == [
        (r, t) for r in (0.0, 1e-3) for t in (4, 6, 8)
    ]
    assert cases[0].models is None
    assert grid_cases() == [Case()]
    (of_array,) = grid_cases(k_sigma=np.array([0.5]))
    assert type(of_array.k_sigma) is float


def test_random_cases_follow_their_ranges_and_their_seed():
    ranges = {
        "ridge": ("log", 1e-6, 1e-2),
        "k_sigma": ("uniform", 0.2, 0.5),
        "terms": ("integer", 3, 5),
        "train": ["joint", "partition"],
    }
    cases = random_cases(1, 400, **ranges)
    assert cases == random_cases(1, 400, **ranges)
    assert cases != random_cases(2, 400, **ranges)
    ridge = np.log10([c.ridge for c in cases])
    assert ridge.min() >= -6 and ridge.max() <= -2
    # The mean of 400 uniform numbers over 4 decades strays by 0.06.
    assert abs(ridge.mean() + 4) < 0.25
    assert {c.terms for c in cases} == {3, 4, 5}
    assert {c.train for c in cases} == {"joint", "partition"}
    assert all(0.2 <= c.k_sigma <= 0.5 for c in cases)


def test_labels_are_plain_and_tell_the_capacity():
    method = Identification(["a[t]"], max_terms=7, max_models=3, steps=4)
    case = within(Case(lags={"b": 2, "a": 1}), method)
    labels = case.labels()
    assert (labels["terms"], labels["models"], labels["steps"]) == (7, 3, 4)
    assert labels["lags"] == "a 1, b 2"
    assert json.loads(json.dumps(labels)) == labels
    assert hash(Case(lags={"b": 2, "a": 1})) == hash(Case(lags={"a": 1, "b": 2}))


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: grid_cases(rigde=[1.0]), "rigde"),
        (lambda: grid_cases(ridge=1.0), "ridge"),
        (lambda: random_cases(0, 2, ridge=("log", 0.0, 1.0)), "ridge"),
        (lambda: random_cases(0, 2, ridge=("uniform", 1.0, 0.0)), "ridge"),
        (lambda: random_cases(0, 0), "count"),
        (lambda: Case(terms=0), "terms"),
        (lambda: Case(ridge=float("nan")), "ridge"),
        (lambda: Case(k_sigma=0.0), "k_sigma"),
        (lambda: Case(rho=1.0), "rho"),
        (lambda: Case(seed=-1), "seed"),
        (lambda: Identification(), "scheduling"),
        (lambda: Identification(["a[t]"], horizons=(1,)), "horizons"),
        (lambda: Identification(["a[t]"], width_band=(1.5, 2.0)), "width_band"),
        (
            lambda: Identification(["a[t]"], partition="tree", validity="boxes"),
            "validity",
        ),
        (lambda: within(Case(terms=9), Identification(["a[t]"])), "terms"),
        (lambda: within(Case(steps=11), Identification(["a[t]"])), "steps"),
    ],
)
def test_wrong_settings_are_named(make, field):
    with pytest.raises(SpecError) as error:
        make()
    assert error.value.field == field


def test_an_identification_is_hashable_with_lags_by_name():
    one = Identification(["a[t]"], input_lags={"a": [0, 1]}, horizons=[5])
    two = Identification(["a[t]"], input_lags={"a": (0, 1)}, horizons=(5,))
    assert one == two and hash(one) == hash(two)
    assert one.lags == {"input_lags": {"a": (0, 1)}, "output_lags": (1, 2)}
