"""Dead time and memory of records whose truth is known, whatever moved the input."""

import numpy as np
import pytest
from linear_records import (
    BLURRED,
    FIRST_ORDER,
    INPUTS,
    SYSTEMS,
    cases,
    memory,
    one_input,
    three_inputs,
)
from scipy.signal import lfilter

from jaxnarx.data import Dataset, check, suggest_lags

SEED = 20


def misses(data, truth) -> list[str]:
    """Pairs whose dead time is more than two samples or memory a factor of two off."""
    lags, wrong = suggest_lags(data), []
    for pair, (system, late) in truth.items():
        dead, settled = lags.dead_time[pair], lags.settling[pair]
        known = memory(system, late)
        if dead is None or settled is None:
            wrong.append(f"{pair}: no response seen")
        elif abs(dead - late) > 2:
            wrong.append(f"{pair}: dead time {dead}, not {late}")
        elif not known / 2 - 1 <= settled <= 2 * known + 1:
            wrong.append(f"{pair}: memory {settled}, not {known}")
        elif max(lags.input_lags) < min(settled, 64):
            wrong.append(f"{pair}: lags {lags.input_lags} for {settled}")
        elif settled > 64 and not lags.filters:
            wrong.append(f"{pair}: no filters for {settled}")
    silent = lags.dead_time.keys() - truth.keys()
    wrong += [f"{p} answers" for p in silent if lags.dead_time[p] is not None]
    return wrong


@pytest.mark.parametrize("noise", [0.05, 0.2])
@pytest.mark.parametrize("kind", INPUTS)
def test_dead_time_and_memory_of_one_input(kind, noise):
    """Each input with each system, outputs off by 100 units and noisy.

    Under a random walk or a smoothed input and noise of 20 %, systems of second order
    with different dead times are equally likely: there the systems are lags, and the
    noise is 10 %.
    """
    hard = noise > 0.1 and kind in BLURRED
    noise = 0.1 if hard else noise
    wrong = {}
    for k, system, late in cases():
        if k == kind and (system in FIRST_ORDER or not hard):
            data = one_input(SEED, kind, system, late, noise)
            wrong[system, late] = misses(data, {("u", "y"): (system, late)})
    assert not {k: w for k, w in wrong.items() if w}


@pytest.mark.parametrize("common", [0.0, 0.4])
@pytest.mark.parametrize(
    "kinds",
    [
        ("white", "white", "white"),
        ("aprbs", "aprbs", "aprbs"),
        ("walk", "walk", "walk"),
        ("aprbs", "steps", "walk"),
        ("periodic", "oversampled", "prbs"),
    ],
)
def test_several_inputs_share_the_outputs(kinds, common):
    data, truth = three_inputs(SEED, kinds, common=common, noise=0.05)
    assert not misses(data, truth)


@pytest.mark.parametrize("kind", INPUTS)
def test_open_loop_is_not_taken_for_closed(kind):
    data = one_input(SEED, kind, "first", 3, 0.1)
    assert not check(data).of("closed loop")


@pytest.mark.parametrize("kind", INPUTS)
def test_independent_records_show_no_response(kind):
    for other in ("white", "aprbs", "oversampled"):
        a, b = one_input(1, kind, "first", 0, 0.1), one_input(2, other, "first", 0, 0.1)
        data = Dataset.from_arrays(
            a.records[0].u, b.records[0].y, inputs=["u"], outputs=["y"], sample_time=1
        )
        assert suggest_lags(data).dead_time == {("u", "y"): None}


def test_one_sine_is_seen():
    """Dead time and memory cannot be told apart; that there is an answer can."""
    t = np.arange(4000)
    y = 3 * np.sin(0.05 * t - 0.8) + np.random.default_rng(3).normal(size=4000)
    data = Dataset.from_arrays(
        np.sin(0.05 * t), y, inputs=["u"], outputs=["y"], sample_time=1
    )
    assert suggest_lags(data).dead_time["u", "y"] is not None


def test_a_memory_beyond_the_pieces_is_found():
    """A lag of 3,000 samples in 300,000 rows: seen at averages of eight."""
    rng = np.random.default_rng(4)
    u = np.repeat(rng.uniform(-1, 1, size=150), 2000)
    a = np.exp(-1 / 3000)
    late = np.concatenate([np.zeros(40), u])[: len(u)]
    y = np.asarray(lfilter([1 - a], [1, -a], late))
    y = y + 0.1 * y.std() * rng.normal(size=len(u))
    data = Dataset.from_arrays(u, y, inputs=["u"], outputs=["y"], sample_time=0.001)
    lags = suggest_lags(data)
    settled = lags.settling["u", "y"]
    assert settled is not None and 4500 < settled < 18000
    assert lags.filters[0] < 3.0 < lags.filters[-1]
    assert "remembers u" in check(data).of("memory")[0].message


def test_offset_and_unit_do_not_matter():
    data = one_input(SEED, "steps", "first", 12, 0.05)
    r = data.records[0]
    moved = Dataset.from_arrays(
        1e6 + r.u, 1e-6 * r.y - 4, inputs=["u"], outputs=["y"], sample_time=0.1
    )
    assert suggest_lags(moved).dead_time == suggest_lags(data).dead_time


def test_without_a_response_the_usual_memory_is_suggested():
    rng = np.random.default_rng(6)
    data = Dataset.from_arrays(
        rng.normal(size=900),
        rng.normal(size=900),
        inputs=["u"],
        outputs=["y"],
        sample_time=1,
    )
    assert suggest_lags(data).input_lags == (0, 1, 2, 4, 8, 16)


def test_every_system_has_the_memory_it_is_said_to_have():
    """Of a first-order lag it is three time constants, less a sample."""
    assert memory("first", 0) == round(3 * 10) - 1
    assert set(FIRST_ORDER) < set(SYSTEMS)
