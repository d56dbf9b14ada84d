"""Grids and random points of a sweep: paths into the settings tree."""

import json

import numpy as np
import pytest

from jaxnarx.errors import SpecError
from jaxnarx.settings import Identification
from jaxnarx.settings.tree import replace_at
from jaxnarx.sweep.cases import grid_cases, random_cases, setting_label


def test_a_grid_is_the_product_with_the_last_path_fastest():
    cases = grid_cases({"refine.ridge": [0.0, 1e-3], "select.max_terms": [4, 6, 8]})
    assert [tuple(c.values()) for c in cases] == [
        (r, t) for r in (0.0, 1e-3) for t in (4, 6, 8)
    ]
    assert list(cases[0]) == ["refine.ridge", "select.max_terms"]
    assert grid_cases({}) == [{}]
    (of_array,) = grid_cases({"grow.k_sigma": np.array([0.5])})
    assert type(of_array["grow.k_sigma"]) is float


def test_random_cases_follow_their_ranges_and_their_seed():
    ranges = {
        "refine.ridge": ("log", 1e-6, 1e-2),
        "grow.k_sigma": ("uniform", 0.2, 0.5),
        "select.max_terms": ("integer", 3, 5),
        "refine.train": ["joint", "partition"],
    }
    cases = random_cases(1, 400, ranges)
    assert cases == random_cases(1, 400, ranges)
    assert cases != random_cases(2, 400, ranges)
    column = {path: [c[path] for c in cases] for path in ranges}
    ridge = np.log10(column["refine.ridge"])
    assert ridge.min() >= -6 and ridge.max() <= -2
    # The mean of 400 uniform numbers over 4 decades strays by 0.06.
    assert abs(ridge.mean() + 4) < 0.25
    assert set(column["select.max_terms"]) == {3, 4, 5}
    assert set(column["refine.train"]) == {"joint", "partition"}
    assert all(0.2 <= k <= 0.5 for k in column["grow.k_sigma"])


def test_labels_are_plain_scalars():
    method = replace_at(
        Identification(), {"pool.input_lags": {"a": (1, 2)}, "refine": "none"}
    )
    paths = ("pool.input_lags", "pool.output_lags", "select", "refine", "grow.k_sigma")
    labels = {path: setting_label(method, path) for path in paths}
    assert labels == {
        "pool.input_lags": "a [1, 2]",
        "pool.output_lags": "1 2",
        "select": "forward",
        "refine": "none",
        "grow.k_sigma": None,
    }
    assert json.loads(json.dumps(labels)) == labels


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: grid_cases({"refine.rigde": [1.0]}), "rigde"),
        (lambda: grid_cases({"refine.ridge": 1.0}), "refine.ridge"),
        (
            lambda: random_cases(0, 2, {"refine.ridge": ("log", 0.0, 1.0)}),
            "refine.ridge",
        ),
        (
            lambda: random_cases(0, 2, {"grow.ridge": ("uniform", 1.0, 0.0)}),
            "grow.ridge",
        ),
        (lambda: random_cases(0, 0, {}), "count"),
    ],
)
def test_wrong_ranges_are_named(make, field):
    with pytest.raises(SpecError) as error:
        make()
    assert error.value.field == field
