"""What hidden channels start from: found from the samples of the window, and no more.

Records without noise are those of the model itself, so that the starts are known.
"""

import dataclasses
from functools import cache

import common
import jax
import numpy as np
import pytest
from hidden_problems import CHANNELS, GAIN, WINDOW, X1, X2, Truth, network, truth

from jaxnarx.data.batch import stack_records
from jaxnarx.errors import DataError
from jaxnarx.models.observer import FIRST_POINTS, PRIOR_WEIGHT, scales, spread_out
from jaxnarx.simulation import (
    begin_hidden,
    make_drive,
    make_masks,
    observe_hidden,
    predict,
    simulate,
)

HIDDEN = GAIN[[X1, X2]]
BEFORE = 1 + WINDOW
PRIOR_ERROR = 3e-4
"""Of outputs of the size of ten. The prior pulls a hidden value at the begin by its
weight times the distance from the middle, two sigma at most, over what the window tells
of it, about one: 2e-3. Of that .7^12, or .014, is left at the end of the window, which
counts four times in y, 1.1e-4, and up to twice that where less than the window is
measured."""


def wrong(run, given: Truth) -> float:
    """Largest error of the samples that are scored."""
    parts = zip(run.outputs, given.computed, run.scored, strict=True)
    return max(np.abs(y - c[:, :2])[s].max(initial=0.0) for y, c, s in parts)


def changed(given: Truth, record: int, rows, value: float) -> Truth:
    """With other outputs in these rows of a record; NaN is missing."""
    each = [np.hstack([r.u, r.y]) for r in given.data]
    each[record][rows, 2:] += value
    return Truth(common.from_rows(each), given.computed)


def starts(net, given: Truth) -> np.ndarray:
    """Hidden values from which the runs of all records begin, (record, hidden)."""
    batch = stack_records(given.data)
    start = make_masks(net, batch, net.window).start
    drive = begin_hidden(net, make_drive(net, batch), jax.device_put(start))
    return np.asarray(drive.measured)[np.arange(len(start)), start - 1, 2:] * HIDDEN


@cache
def free(kind: str = "scheduled"):
    return simulate(network(kind), truth(kind).data).value


# the start ------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["plain", "scheduled"])
def test_the_free_run_from_an_estimated_start_is_the_truth(kind):
    given, run = truth(kind), free(kind)
    assert wrong(run, given) < PRIOR_ERROR
    for n, (record, scored) in enumerate(zip(given.data, run.scored, strict=True)):
        # The window is not predicted: it repeats the measurement.
        expected = np.arange(len(record)) >= BEFORE
        np.testing.assert_array_equal(scored, np.stack([expected] * 2, axis=1))
        np.testing.assert_array_equal(run.outputs[n][:BEFORE], record.y[:BEFORE])
        hidden = run.hidden[n][BEFORE:] - given.computed[n][BEFORE:, 2:]
        assert np.abs(hidden).max() < PRIOR_ERROR
    found = starts(network(kind), given)
    # What is told of x1 before sample 1 is one y; of x2 a w.
    np.testing.assert_allclose(found, [c[0, 2:] for c in given.computed], atol=1e-2)


def test_starts_outside_of_a_program_are_those_inside_and_fit_any_records():
    net, given = network("scheduled"), truth("scheduled")
    batch = stack_records(given.data)
    start, drive = make_masks(net, batch, net.window).start, make_drive(net, batch)
    inside = jax.jit(lambda start: begin_hidden(net, drive, start).measured)(start)
    outside = begin_hidden(net, drive, jax.device_put(start)).measured
    np.testing.assert_allclose(outside, inside, rtol=1e-6, atol=1e-9)
    few = Truth(given.data[:1], given.computed[:1])
    assert common.compilations(lambda: starts(net, few)) == 0


@pytest.mark.parametrize("k", [1, 5])
def test_predictions_from_measured_samples_are_the_truth(k):
    run = predict(network(), truth().data, k).value
    assert wrong(run, truth()) < PRIOR_ERROR
    for record, scored in zip(truth().data, run.scored, strict=True):
        expected = np.arange(len(record)) >= BEFORE + k - 1
        np.testing.assert_array_equal(scored[:, 0], expected)


def test_what_lies_behind_the_window_does_not_move_the_start():
    net, given = network(), truth()
    plain, noisy = (starts(net, g) for g in (given, changed(given, 0, BEFORE, 30.0)))
    np.testing.assert_array_equal(noisy, plain)
    other = starts(net, changed(given, 0, WINDOW, 1.0))
    assert np.all(other[0] != plain[0])
    np.testing.assert_array_equal(other[1], plain[1])


def test_records_and_padding_beside_it_do_not_move_a_start():
    net, given = network(), truth()
    longer = truth(lengths=(60, 45, 100))
    assert (
        stack_records(longer.data).signals.shape[1]
        > stack_records(given.data).signals.shape[1]
    )
    # Programs of other sizes round otherwise, and 15 steps of a search multiply that.
    found = starts(net, longer)[:2]
    np.testing.assert_allclose(found, starts(net, given), atol=1e-9)
    for n in range(2):
        one = Truth(given.data[n : n + 1], given.computed[n : n + 1])
        np.testing.assert_allclose(starts(net, one)[0], found[n], atol=1e-9)


def test_without_information_hidden_channels_begin_in_the_middle_of_their_range():
    low = np.array([-5.0, -1.5, -10.0, -6.0, -2.0, -1.0])
    high = np.array([5.0, 1.5, 10.0, 6.0, 4.0, 2.0])
    ranges = {"low": jax.device_put(low), "high": jax.device_put(high)}
    net = dataclasses.replace(network("plain", told=False), **ranges)
    middle, sigma = (np.asarray(x) for x in scales(net))
    np.testing.assert_allclose(middle[2:] * HIDDEN, [1.0, 0.5])
    np.testing.assert_allclose(sigma[2:] * HIDDEN, [1.5, 0.75])
    found = starts(net, truth("plain"))
    np.testing.assert_allclose(found[:, 1], 0.5, atol=1e-9)
    assert np.all(np.abs(found[:, 0] - 1.0) > 0.1)


@pytest.mark.parametrize("n", [1, 2, 6])
def test_points_that_are_looked_at_first_fill_the_range(n):
    points = spread_out(n)
    assert points.shape == (FIRST_POINTS, n)
    np.testing.assert_array_equal(points[0], 0.0)
    assert np.abs(points).max() <= 2.0
    # Of 16 independent uniform numbers the mean strays by 0.29.
    assert np.all(np.abs(points.mean(axis=0)) < 2 * 0.29)
    assert np.all(np.ptp(points, axis=0) > 3.0)
    assert 0 < PRIOR_WEIGHT < 1


# records that are short, or not whole ---------------------------------------------


def test_missing_outputs_put_the_start_off_until_there_is_a_whole_window():
    given, gap = truth(), 7
    holed = changed(given, 0, gap, np.nan)
    net = network()
    masks = make_masks(net, stack_records(holed.data), WINDOW)
    # w looks one sample back: the first that counts in a window is gap + 2.
    np.testing.assert_array_equal(masks.start, [gap + 2, 1])
    np.testing.assert_array_equal(masks.first, [gap + 2 + WINDOW, BEFORE])
    run = simulate(net, holed.data).value
    assert np.argmax(run.scored[0][:, 0]) == gap + 2 + WINDOW
    assert wrong(run, given) < PRIOR_ERROR
    ahead = predict(net, holed.data, 5).value
    assert np.argmax(ahead.scored[0][:, 0]) == gap + 2 + WINDOW + 4
    assert wrong(ahead, given) < PRIOR_ERROR


def test_a_gap_behind_the_window_is_no_harm_to_the_run_but_stops_predictions():
    given, gap = truth(), 30
    holed = changed(given, 0, gap, np.nan)
    run = simulate(network(), holed.data).value
    assert wrong(run, given) < PRIOR_ERROR
    assert not run.scored[0][gap].any()
    assert run.scored[0][BEFORE:].sum() == 2 * (60 - BEFORE - 1)
    one = predict(network(), holed.data).value
    assert wrong(one, given) < PRIOR_ERROR
    lost = np.flatnonzero(~one.scored[0][BEFORE:, 0]) + BEFORE
    np.testing.assert_array_equal(lost, gap + np.arange(WINDOW + 2))


def test_a_record_without_a_whole_window_is_too_short_and_the_others_run():
    given = truth(lengths=(60, BEFORE))
    found = simulate(network(), given.data)
    assert found.status_name == "too_short"
    assert f"no {BEFORE} valid samples in a row" in found.detail
    np.testing.assert_array_equal(found.stats["record_status"] != 0, [False, True])
    assert not found.value.scored[1].any()
    np.testing.assert_array_equal(found.value.outputs[1], given.data.records[1].y)
    assert wrong(found.value, given) < PRIOR_ERROR
    ahead = predict(network(), truth(lengths=(60, BEFORE + 3)).data, 5)
    assert ahead.status_name == "too_short"


def test_no_record_with_a_window_is_an_error_with_the_number_that_is_needed():
    short = truth(lengths=(BEFORE, 5)).data
    for verb in (simulate, predict):
        with pytest.raises(DataError, match=f"needs {BEFORE} valid measured samples"):
            verb(network(), short)
    with pytest.raises(DataError, match="no record can be run"):
        simulate(network(window=200), truth().data)


def test_hidden_values_are_those_of_the_window_that_ends_there():
    net, given = network(), truth()
    drive = observe_hidden(net, make_drive(net, stack_records(given.data)))
    found = np.asarray(drive.measured)[..., 2:] * HIDDEN
    for n, every in enumerate(given.computed):
        np.testing.assert_array_equal(found[n, : WINDOW - 1], 0.0)
        late = found[n, WINDOW : len(every)] - every[WINDOW:, 2:]
        assert np.abs(late).max() < PRIOR_ERROR
    assert net.channels == CHANNELS
