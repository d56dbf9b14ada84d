"""Records that repeat each other's inputs, against covariances summed one by one."""

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest

from jaxnarx.data import Dataset, read_split
from jaxnarx.data.repeated_cycles import STILL_VARIANCE, cycles


def staircase(rng: np.random.Generator, rows: int, inputs: int = 2, hold: int = 20):
    """Independent random steps, each held for 10 to 30 samples."""
    u = np.zeros((rows, inputs))
    for i in range(inputs):
        t = 0
        while t < rows:
            length = int(rng.uniform(0.5, 1.5) * hold)
            u[t : t + length, i] = rng.uniform()
            t += length
    return u


def dataset(*us: np.ndarray) -> Dataset:
    return Dataset.from_arrays(
        list(us),
        [np.arange(len(u), dtype=float)[:, None] for u in us],
        inputs=[f"u{i}" for i in range(us[0].shape[1])],
        outputs=["y"],
        sample_time=0.1,
        names=[f"r{n}" for n in range(len(us))],
    )


def tied(*us: np.ndarray) -> list[tuple[int, ...]]:
    return [c.records for c in cycles(dataset(*us)) if len(c.records) > 1]


def likeness(a: np.ndarray, b: np.ndarray, lag: int) -> float:
    """The formula of the module's docstring over the overlap, sample by sample."""
    pairs = [(a[t], b[t - lag]) for t in range(len(a)) if 0 <= t - lag < len(b)]
    x, y = (np.array(side) for side in zip(*pairs, strict=True))
    still = STILL_VARIANCE * len(x)
    top, bottom = still * min(len(a), len(b)) / max(len(a), len(b)), still
    for i in range(a.shape[1]):
        p, q = x[:, i] - x[:, i].mean(), y[:, i] - y[:, i].mean()
        top += 2 * sum(p * q)
        bottom += sum(p**2) + sum(q**2)
        bottom += len(x) * (x[:, i].mean() - y[:, i].mean()) ** 2
    return top / bottom


def test_likeness_is_the_formula_at_every_shift():
    from jaxnarx.data.repeated_cycles import _courses, compare_courses

    rng = np.random.default_rng(0)
    us = [staircase(rng, n) + 0.3 * k for k, n in enumerate((90, 70))]
    us.append(us[0][6:80] + 0.2 * rng.standard_normal((74, 2)))
    pooled = np.concatenate(us)
    scaled = [(u - pooled.mean(axis=0)) / pooled.std(axis=0) for u in us]
    courses, every = _courses(dataset(*us))
    assert every == 1
    for i, j in ((0, 1), (1, 0), (0, 2), (2, 1)):
        reach = min(len(us[i]), len(us[j])) // 10
        lags = range(-reach, reach + 1)
        plain = {lag: likeness(scaled[i], scaled[j], lag) for lag in lags}
        best = max(plain, key=lambda lag: plain[lag])
        value, _, lag = compare_courses(courses[i], courses[j])
        np.testing.assert_allclose(value, plain[best], rtol=1e-10)
        assert lag == best
    assert compare_courses(courses[0], courses[2])[2] == 6


def test_the_chance_is_the_scatter_of_independent_records():
    """Two hundred pairs of random steps: mean square likeness without a shift."""
    from jaxnarx.data.repeated_cycles import _courses, compare_courses

    rng = np.random.default_rng(1)
    values, told = [], []
    for _ in range(200):
        us = [staircase(rng, 400) for _ in range(2)]
        pooled = np.concatenate(us)
        a, b = ((u - pooled.mean(axis=0)) / pooled.std(axis=0) for u in us)
        values.append(likeness(a, b, 0))
        told.append(compare_courses(*_courses(dataset(*us))[0])[1])
    # 200 draws tell a root mean square to some 5 %.
    np.testing.assert_allclose(np.mean(told), np.sqrt(np.mean(np.square(values))), 0.2)


def test_a_cycle_driven_again_is_found_with_its_shift():
    rng = np.random.default_rng(2)
    first, other = staircase(rng, 600), staircase(rng, 580)
    again = first[17:560] + 0.1 * rng.standard_normal((543, 2))
    early = np.concatenate([np.tile(first[:1], (9, 1)), first])
    found = cycles(dataset(first, other, again, early))
    assert [c.records for c in found] == [(0, 2, 3), (1,)]
    # The longest, which has nine samples more at its beginning, counts the samples.
    assert found[0].begins == (9, 26, 0)


def test_a_run_that_was_broken_off_repeats_the_beginning():
    u = staircase(np.random.default_rng(3), 800)
    assert tied(u, u[:250]) == [(0, 1)]
    # One that is cut from the middle is another matter than a small shift.
    assert tied(u, u[400:650]) == []


@pytest.mark.parametrize("inputs", [1, 2, 4])
@pytest.mark.parametrize("rows", [400, 3000])
def test_independent_random_steps_are_not_tied(inputs, rows):
    for seed in range(10):
        rng = np.random.default_rng([seed, rows])
        us = [staircase(rng, rows - 10 * n, inputs) for n in range(8)]
        assert not tied(*us)


def test_slow_courses_are_alike_by_chance_and_not_tied_for_that():
    """Random walks of one input often have a likeness above the least one."""
    walks = [
        np.cumsum(np.random.default_rng(seed).standard_normal((500, 1)), axis=0)
        for seed in range(30)
    ]
    assert len(tied(*walks)) <= 1


def test_the_same_steps_at_another_level_are_no_repeat():
    rng = np.random.default_rng(4)
    load = staircase(rng, 500, 1)
    speed = [np.full((500, 1), level) for level in (1000.0, 1000.0, 3000.0)]
    us = [np.concatenate([s, load], axis=1) for s in speed]
    assert tied(*us) == [(0, 1)]


def test_one_setpoint_makes_no_repeat():
    rng = np.random.default_rng(5)
    speed = [1000.0, 1000.0, 3000.0, 3000.0]
    us = [np.c_[np.full(500, s), staircase(rng, 500, 1)] for s in speed]
    assert not tied(*us)


def test_records_at_rest_repeat_each_other_at_one_point_alone():
    us = [np.full((200, 1), level) for level in (1.0, 2.0, 1.0, 3.0)]
    assert tied(*us) == [(0, 2)]
    # Resting at the point where a longer one begins is no repeat of it.
    long = np.concatenate([us[0], 1 + staircase(np.random.default_rng(6), 800, 1)])
    assert not tied(us[0], long)


def test_units_missing_samples_and_binary_inputs_do_not_matter():
    rng = np.random.default_rng(7)
    first, other = staircase(rng, 600), staircase(rng, 600)
    switch = (rng.uniform(size=(3, 600, 1)) > 0.5).astype(float)
    us = [np.c_[u, s] for u, s in zip((first, other, first), switch, strict=True)]
    units = np.array([1e-6, 1e9, 1.0])
    assert tied(*us) == [(0, 2)] == tied(*(u * units + 5 * units for u in us))
    data = dataset(*us)
    valid = np.ones((600, 4), bool)
    valid[100:200, 0] = False
    u = us[2].copy()
    u[100:200, 0] = u[99, 0]
    broken = dataclasses.replace(data.records[2], u=u, valid=valid)
    data = dataclasses.replace(data, records=(*data.records[:2], broken))
    assert [c.records for c in cycles(data)] == [(0, 2), (1,)]


def test_switches_count_where_there_is_nothing_else():
    rng = np.random.default_rng(8)
    us = [np.round(staircase(rng, 600, 1)) for _ in range(3)]
    assert tied(*us, us[1]) == [(1, 3)]


def test_without_moving_inputs_every_record_is_alone():
    constant = [np.ones((50, 1))] * 4
    assert not tied(*constant)
    data = Dataset.from_arrays(
        None, [np.zeros((5, 1))] * 3, inputs=[], outputs=["y"], sample_time=1
    )
    assert [c.records for c in cycles(data)] == [(0,), (1,), (2,)]


@pytest.mark.parametrize("rows", [(1, 1, 1), (1, 2, 3), (2, 5000, 3), (7, 7, 9)])
def test_tiny_records_are_nothing_to_fail_on(rows):
    rng = np.random.default_rng(9)
    assert not tied(*(rng.uniform(size=(n, 2)) for n in rows))


def test_long_records_are_compared_by_means():
    rng = np.random.default_rng(10)
    us = [staircase(rng, 20_000, hold=200) for _ in range(3)]
    found = cycles(dataset(*us, us[1][503:]))
    assert [c.records for c in found] == [(0,), (1, 3), (2,)]
    # Means over five samples tell the shift to about as many.
    assert abs(found[1].begins[1] - 503) <= 5


def measured() -> Dataset:
    folder = Path(os.environ.get("JAXNARX_DATA", "../shared/data"))
    if not (folder / "gengine1").is_dir():
        pytest.skip("the measured records of gengine1 are not here")
    here = Path(__file__).parents[2] / "experiments" / "gengine1" / "gengine1.toml"
    train = read_split(here, root=folder).train
    assert train is not None
    return train


def test_measured_records_are_independent_until_one_is_driven_again():
    """No two of the twenty training records repeat each other's inputs: over all
    shifts the largest likeness is 0.43. Each with a start 40 s later, 40 s shorter and
    noise on its inputs is tied to itself alone, but for the two that hardly move.
    """
    data = measured()
    assert all(len(c.records) == 1 for c in cycles(data))
    rng = np.random.default_rng(11)
    spread = np.concatenate([r.u for r in data]).std(axis=0)
    again = [
        r.u[400:-400] + 0.1 * spread * rng.standard_normal((len(r) - 800, 5))
        for r in data
    ]
    found = [c.records for c in cycles(dataset(*(r.u for r in data), *again))]
    pairs = [(n, n + len(data)) for n in range(len(data))]
    assert {r for r in found if len(r) > 1} <= set(pairs)
    assert len(set(pairs) & set(found)) >= 18
