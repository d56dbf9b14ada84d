"""Which local model carries the error of the free run."""

import numpy as np
import pytest
from common import BRIEF, HALVES, from_rows, network

from jaxnarx.evaluation import RegionError, region_sentence, report
from jaxnarx.evaluation._region_errors import region_text


@pytest.fixture(scope="module")
def found():
    """y is 0.1 where a is negative and 2 above, where a quarter of the samples are."""
    rng = np.random.default_rng(4)
    u = rng.uniform(-1, 1, (9000, 2))
    u[:, 0] = np.where(np.arange(9000) % 4 == 0, abs(u[:, 0]), -abs(u[:, 0]))
    y = np.stack([np.where(u[:, 0] > 0, 2.0, 0.1), rng.normal(size=9000)], axis=1)
    return report(network([HALVES]), from_rows([np.hstack([u, y])]), **BRIEF)


def test_the_region_that_errs_comes_first(found):
    first, second = found.regions
    assert (first.model, second.model) == (2, 1)
    # thinned to 3000 of 9000 samples, whose share is even
    assert first.samples == pytest.approx(0.25, abs=0.01)
    assert first.rmse == pytest.approx(2.0) and second.rmse == pytest.approx(0.1)
    square = 0.25 * 4.0
    assert first.error == pytest.approx(square / (square + 0.75 * 0.01), abs=1e-3)
    assert first.error + second.error == pytest.approx(1.0)
    told = region_sentence(found.regions, "y", "data")
    assert told.startswith("Region 2 (a[t] near 0.5") and "with 25% of the sam" in told


def test_an_even_error_points_nowhere():
    even = (
        RegionError("y", 1, "everywhere", 0.5, 0.6, 1.0),
        RegionError("y", 2, "everywhere", 0.5, 0.4, 0.9),
    )
    assert "spread over the regions" in region_sentence(even, "y", "test")
    assert region_sentence(even, "w", "test") == ""


@pytest.mark.parametrize(
    ("region", "text"),
    [
        ({}, "everywhere"),
        ({"a[t]": {"above": 2.0}}, "a[t] above 2"),
        (
            {"a[t]": {"above": 2.0, "below": 3.5}, "b": {"below": 1.0}},
            "a[t] 2 to 3.5, b below 1",
        ),
        ({"a[t]": {"centre": 2.0, "width": 0.5}}, "a[t] near 2 ± 0.5"),
    ],
)
def test_regions_in_words(region, text):
    assert region_text(region) == text
