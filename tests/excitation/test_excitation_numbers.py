"""Placement, spectra and coverage: what tells how good an excitation is."""

import json

import jax
import numpy as np
import pytest

from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.excitation import (
    assess,
    bandwidth,
    coverage,
    discrepancy,
    latin_hypercube,
    sobol,
    spectrum,
)

LOW, HIGH = np.array([10.0, -1.0, 0.0]), np.array([20.0, 1.0, 1e-3])


@pytest.fixture
def rng():
    return np.random.default_rng(5)


# placement ------------------------------------------------------------------------


@pytest.mark.parametrize("improve", [False, True])
def test_a_latin_hypercube_has_a_point_in_every_stratum(key, improve):
    points = np.asarray(latin_hypercube(key, 23, LOW, HIGH, improve=improve))
    stratum = np.floor((points - LOW) / (HIGH - LOW) * 23)
    expected = np.repeat(np.arange(23)[:, None], 3, axis=1)
    np.testing.assert_array_equal(np.sort(stratum, axis=0), expected)
    if improve:
        plain = latin_hypercube(key, 23, LOW, HIGH)
        assert discrepancy(points, LOW, HIGH) < discrepancy(plain, LOW, HIGH)


def test_sobol_points_are_the_published_ones_and_nested():
    first = [[0, 0], [0.5, 0.5], [0.75, 0.25], [0.25, 0.75], [0.375, 0.375]]
    np.testing.assert_array_equal(sobol(5, np.zeros(2), np.ones(2)), first)
    many = np.asarray(sobol(16, LOW, HIGH))
    np.testing.assert_array_equal(sobol(11, LOW, HIGH), many[:11])
    # A power of two is a Latin hypercube too.
    stratum = np.floor((many - LOW) / (HIGH - LOW) * 16 + 1e-9)
    assert all(len(set(column)) == 16 for column in stratum.T)


def test_scrambling_takes_its_chance_from_the_key(key):
    points, again = (np.asarray(sobol(9, LOW, HIGH, key=key)) for _ in range(2))
    np.testing.assert_array_equal(points, again)
    assert np.all((points > LOW) & (points < HIGH))
    assert not np.array_equal(points, sobol(9, LOW, HIGH, key=jax.random.key(1)))
    assert not np.array_equal(points, sobol(9, LOW, HIGH))


def hickernell(x):
    """Squared centred discrepancy, term by term."""
    n, dims = x.shape
    z = np.abs(x - 0.5)
    first = (13 / 12) ** dims
    second = sum(np.prod(1 + 0.5 * a - 0.5 * a**2) for a in z)
    third = sum(
        np.prod(1 + 0.5 * a + 0.5 * b - 0.5 * np.abs(p - q))
        for a, p in zip(z, x, strict=True)
        for b, q in zip(z, x, strict=True)
    )
    return first - 2 / n * second + third / n**2


def test_discrepancy_is_hickernells(rng):
    x = rng.random((17, 3))
    points = LOW + x * (HIGH - LOW)
    expected = np.sqrt(hickernell(x))
    # The scaling back rounds by some ulp.
    np.testing.assert_allclose(discrepancy(points, LOW, HIGH), expected, rtol=1e-10)
    mirrored = LOW + (1 - x) * (HIGH - LOW)
    np.testing.assert_allclose(discrepancy(mirrored, LOW, HIGH), expected, rtol=1e-10)
    # One point in the middle of one input: 13/12 - 2 + 1, from the definition.
    middle = discrepancy(np.array([[15.0]]), LOW[:1], HIGH[:1])
    np.testing.assert_allclose(middle, np.sqrt(1 / 12), rtol=1e-12)


def test_many_points_are_thinned(rng):
    # The discrepancy of random points falls as 1 / sqrt(n): thinning stops the fall.
    x = rng.random((40_000, 2))
    found = discrepancy(x, np.zeros(2), np.ones(2))
    kept = x[np.unique(np.linspace(0, len(x) - 1, 2048).astype(int))]
    assert found == discrepancy(kept, np.zeros(2), np.ones(2))


@pytest.mark.parametrize(
    ("low", "high"),
    [([0.0], [0.0]), ([1.0], [0.0]), ([0.0], [np.inf]), ([], [])],
)
def test_boxes_without_room_are_refused(low, high):
    with pytest.raises(SpecError) as caught:
        sobol(4, np.array(low), np.array(high))
    assert caught.value.field == "low"


def test_points_that_are_not_finite_are_refused():
    for points in (np.full((3, 1), np.nan), np.zeros((0, 1))):
        with pytest.raises(DataError):
            discrepancy(points, np.zeros(1), np.ones(1))
        with pytest.raises(DataError):
            coverage(points, np.zeros(1), np.ones(1))


# spectra --------------------------------------------------------------------------

SAMPLE_TIME = 0.01


def waves(length, *frequencies):
    t = np.arange(length)[:, None] * SAMPLE_TIME
    return np.sin(2 * np.pi * t * np.array(frequencies)[None])


def test_the_spectrum_sums_to_the_variance_at_the_right_frequency():
    # Whole periods in segments of 256: 6.25 Hz is line 16, 25 Hz line 64.
    x = 3.0 + 4.0 * waves(4096, 6.25, 25.0)
    found = spectrum(x, SAMPLE_TIME, segment=256)
    step = found.frequency[1]
    assert found.frequency[-1] == 50.0 and step == 1 / 2.56
    # A Hann window spreads a line over three without loss.
    np.testing.assert_allclose(found.power.sum(axis=0) * step, 8.0, rtol=1e-10)
    np.testing.assert_array_equal(np.argmax(found.power, axis=0), [16, 64])
    # 95 % is within the three lines.
    assert np.all(np.abs(bandwidth(found) - [6.25, 25.0]) <= 1.5 * step)


def test_white_noise_has_a_flat_spectrum(rng):
    x = 2.0 * rng.normal(size=(60_000, 1))
    found = spectrum(x, SAMPLE_TIME, segment=64)
    # Variance 4 over 50 Hz. 1874 half-overlapping segments: one part in 37 deviation,
    # a fifth less for the overlap; six of them.
    np.testing.assert_allclose(found.power[2:-2], 4 / 50, rtol=0.15)
    np.testing.assert_allclose(bandwidth(found, 0.3), 15.0, rtol=0.03)


def test_records_are_pooled_by_their_length(rng):
    long, short = rng.normal(size=(600, 2)), 5 + rng.normal(size=(40, 2))
    both = spectrum([long, short], SAMPLE_TIME, segment=128)
    swapped = spectrum([short, long], SAMPLE_TIME, segment=128)
    np.testing.assert_allclose(both.power, swapped.power, rtol=1e-12)
    alone = [spectrum(r, SAMPLE_TIME, segment=128).power for r in (long, short)]
    expected = (600 * alone[0] + 40 * alone[1]) / 640
    np.testing.assert_allclose(both.power, expected, rtol=1e-12)
    scaled = spectrum([10 * long, 10 * short], SAMPLE_TIME, segment=128)
    np.testing.assert_allclose(scaled.power, 100 * both.power, rtol=1e-10)


@pytest.mark.parametrize("length", [1, 2, 30, 3000])
def test_a_constant_has_no_power(length):
    found = spectrum(np.full((length, 1), 7.0), SAMPLE_TIME)
    np.testing.assert_array_equal(found.power, 0.0)
    np.testing.assert_array_equal(bandwidth(found), 0.0)
    assert len(found.frequency) == min(length, 256 if length == 3000 else 64) // 2 + 1


def test_impossible_spectra_are_refused():
    x = waves(64, 5.0)
    for wrong, field in [
        ({"sample_time": 0.0}, "sample_time"),
        ({"segment": 0}, "segment"),
        ({"signals": []}, "signals"),
        ({"signals": np.zeros((0, 1))}, "signals"),
    ]:
        with pytest.raises(SpecError) as caught:
            spectrum(**({"signals": x, "sample_time": 0.1} | wrong))
        assert caught.value.field == field
    with pytest.raises(SpecError):
        bandwidth(spectrum(x, 0.1), 1.0)
    x[7] = np.nan
    with pytest.raises(DataError) as refused:
        spectrum(x, 0.1)
    assert refused.value.row == 7


# coverage -------------------------------------------------------------------------


def test_coverage_counts_cells(rng):
    x = LOW + (HIGH - LOW) * rng.random((90, 3)) ** 2
    found = coverage(x, LOW, HIGH, bins=5)
    cell = np.floor((x - LOW) / (HIGH - LOW) * 5).astype(int)
    for i in range(3):
        for j in range(3):
            visited = {(a, b) for a, b in cell[:, [i, j]]}
            assert found.pairs[i, j] == len(visited) / (5 if i == j else 25)
    # 4^3 = 64 cells are not more than the 90 points, 5^3 are.
    coarse = np.floor((x - LOW) / (HIGH - LOW) * 4).astype(int)
    assert found.whole_bins == 4
    assert found.whole == len({tuple(row) for row in coarse}) / 64
    np.testing.assert_allclose(
        found.range_used, (x.max(0) - x.min(0)) / (HIGH - LOW), rtol=1e-12
    )


def test_coverage_of_a_grid_and_of_a_line():
    side = np.arange(11) / 10
    grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    full = coverage(grid, np.zeros(2), np.ones(2))
    assert full.whole == 1 and full.whole_bins == 10 and full.outside == 0
    np.testing.assert_array_equal(full.pairs, 1.0)
    line = coverage(np.stack([side, side], -1), np.zeros(2), np.ones(2))
    assert line.pairs[0, 1] == 0.1 and line.pairs[0, 0] == 1.0
    assert full.discrepancy < line.discrepancy


def test_points_outside_visit_nothing():
    x = np.array([[0.5, 0.5], [1.5, 0.5], [0.5, -3.0], [0.9, 0.9]])
    found = coverage(x, np.zeros(2), np.ones(2))
    assert found.outside == 0.5 and found.pairs[0, 1] == 0.02
    np.testing.assert_allclose(found.range_used, [0.5, 0.9])
    nowhere = coverage(x + 10, np.zeros(2), np.ones(2))
    assert nowhere.outside == 1 and nowhere.whole == 0


@pytest.fixture
def data(rng):
    u = rng.random((500, 2)) * [10.0, 1.0]
    u[20:30, 0] = np.nan
    records = [u, np.concatenate([u[:100], [[50.0, np.nan]]])]
    return Dataset.from_arrays(
        records,
        [np.zeros((len(r), 1)) + np.arange(len(r))[:, None] for r in records],
        inputs=["fuel", "duty"],
        outputs=["torque"],
        units={"fuel": "mg"},
        sample_time=SAMPLE_TIME,
        missing="mask",
    )


def test_an_assessment_leaves_out_what_is_not_valid(data):
    found = assess(data)
    assert found.coverage.samples == 500 - 10 + 100 - 10
    assert found.high[0] < 10.0, "the 50 stands beside an invalid duty"
    valid = np.concatenate([r.u[r.valid[:, :2].all(1)] for r in data])
    expected = coverage(valid, valid.min(0), valid.max(0), names=["fuel", "duty"])
    assert found.coverage.to_dict() == expected.to_dict()
    assert json.loads(json.dumps(found.to_dict())) == found.to_dict()
    for part in ("fuel [mg]", "95% of the power", "duty x fuel", "whole space"):
        assert part in str(found)


def test_the_operating_space_may_be_given(data):
    found = assess(data, ranges={"fuel": (0.0, 40.0)}, bins=4)
    assert (found.low[0], found.high[0]) == (0.0, 40.0)
    assert found.coverage.pairs[0, 0] == 0.25 and found.coverage.pairs[1, 1] == 1
    with pytest.raises(SpecError, match="Did you mean 'fuel'"):
        assess(data, ranges={"fule": (0.0, 1.0)})


def test_without_inputs_there_is_no_excitation():
    data = Dataset.from_arrays(
        None, np.arange(9.0), inputs=[], outputs=["y"], sample_time=1.0
    )
    with pytest.raises(DataError, match="no inputs"):
        assess(data)
