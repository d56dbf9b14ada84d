"""The APRBS keeps its promises on hold times, levels and keys."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnarx.errors import SpecError
from jaxnarx.excitation import aprbs, hold_times, steps

HOLD = (20, 120)
AMPLITUDE = (0.38, 0.41)


@pytest.fixture(scope="module")
def signal():
    key = jax.random.key(20120501)
    return np.asarray(aprbs(key, 8000, hold=HOLD, amplitude=AMPLITUDE))


def runs(signal: np.ndarray) -> np.ndarray:
    """Lengths of the stretches of equal value."""
    borders = np.flatnonzero(np.diff(signal)) + 1
    return np.diff(np.concatenate([[0], borders, [signal.size]]))


def test_hold_times_lie_in_their_range(signal):
    holds = runs(signal)
    assert holds.sum() == 8000
    assert holds[:-1].min() >= HOLD[0] and holds.max() <= HOLD[1]


def test_hold_times_cover_their_range(key):
    holds = runs(np.asarray(aprbs(key, 3000, hold=(2, 4), amplitude=(-1.0, 1.0))))
    assert set(holds[:-1]) == {2, 3, 4}


def test_levels_lie_in_and_cover_their_range(signal):
    low, high = AMPLITUDE
    assert low <= signal.min() and signal.max() <= high
    levels = np.unique(signal)
    # Over a hundred uniform levels: a gap of a tenth of the range has odds of 1e-3.
    assert levels.size > 60
    gaps = np.diff(np.concatenate([[low], levels, [high]]))
    assert gaps.max() < 0.1 * (high - low)


def test_the_key_decides(key, signal):
    again = aprbs(key, 8000, hold=HOLD, amplitude=AMPLITUDE)
    other = aprbs(jax.random.key(1), 8000, hold=HOLD, amplitude=AMPLITUDE)
    np.testing.assert_array_equal(signal, again)
    assert not np.array_equal(signal, other)


def test_limits(key):
    np.testing.assert_array_equal(aprbs(key, 5, hold=(9, 9), amplitude=(2.0, 2.0)), 2.0)
    assert np.all(
        runs(np.asarray(aprbs(key, 60, hold=(6, 6), amplitude=(0.0, 1.0)))) == 6
    )
    assert aprbs(key, 1, hold=(1, 1), amplitude=(0.0, 1.0)).shape == (1,)


def test_steps_hold_each_level():
    np.testing.assert_array_equal(steps([1.0, 3.0], hold=2), [1.0, 1.0, 3.0, 3.0])


@pytest.mark.parametrize("seed", range(3))
def test_uniform_numbers_stay_as_recorded_results_have_them(seed):
    key, length, (shortest, longest) = jax.random.key(seed), 2000, HOLD
    time_key, level_key = jax.random.split(key)
    most = -(-length // shortest)
    holds = np.asarray(jax.random.randint(time_key, (most,), shortest, longest + 1))
    levels = np.asarray(jax.random.uniform(level_key, (most,), float, *AMPLITUDE))
    expected = np.repeat(levels, holds)[:length]
    found = aprbs(key, length, hold=HOLD, amplitude=AMPLITUDE)
    np.testing.assert_array_equal(found, expected)


def probabilities(distribution: str, shortest: int, longest: int) -> np.ndarray:
    """Of the hold times, from the definitions in `hold_times`."""
    holds = np.arange(shortest, longest + 1)
    if distribution == "geometric":
        # 0.05 ** (1 / n) is the chance not to switch at a sample.
        weight = 0.05 ** ((holds - shortest) / len(holds))
    else:
        weight = {"uniform": np.ones(len(holds)), "log-uniform": np.log1p(1 / holds)}[
            distribution
        ]
    return weight / weight.sum()


@pytest.mark.parametrize("distribution", ["uniform", "geometric", "log-uniform"])
@pytest.mark.parametrize("hold", [(1, 9), (5, 5), (3, 12)])
def test_hold_times_have_their_distribution(key, distribution, hold):
    count = 20_000
    found = np.asarray(hold_times(key, count, hold=hold, distribution=distribution))
    share = np.bincount(found, minlength=hold[1] + 1)[hold[0] :] / count
    expected = probabilities(distribution, *hold)
    # Five standard deviations of a binomial share; at most ten shares are compared.
    assert share.shape == expected.shape
    np.testing.assert_array_less(
        np.abs(share - expected), 5 * np.sqrt(expected / count) + 1e-15
    )


@pytest.mark.parametrize("distribution", ["geometric", "log-uniform"])
def test_every_hold_distribution_makes_a_sequence(key, distribution):
    found = np.asarray(
        aprbs(
            key,
            3000,
            hold=HOLD,
            amplitude=AMPLITUDE,
            hold_distribution=distribution,
        )
    )
    holds = runs(found)
    assert holds[:-1].min() >= HOLD[0] and holds.max() <= HOLD[1]
    uniform = runs(np.asarray(aprbs(key, 3000, hold=HOLD, amplitude=AMPLITUDE)))
    assert np.mean(holds) < np.mean(uniform), "both favour short holds"


@pytest.mark.parametrize("seed", range(3))
def test_latin_levels_visit_every_stratum_once(seed):
    low, high = AMPLITUDE
    found = np.asarray(
        aprbs(
            jax.random.key(seed),
            3000,
            hold=HOLD,
            amplitude=AMPLITUDE,
            level_distribution="latin",
        )
    )
    levels = found[np.concatenate([[0], np.cumsum(runs(found))[:-1]])]
    stratum = np.floor((levels - low) / (high - low) * len(levels))
    np.testing.assert_array_equal(np.sort(stratum), np.arange(len(levels)))


def test_arcsine_levels_visit_the_ends_most(key):
    count = 20_000
    request = {"hold": (1, 1), "level_distribution": "arcsine"}
    found = np.asarray(aprbs(key, count, amplitude=(2.0, 12.0), **request))
    # P(x < low + 0.1 width) = (2 / pi) arcsin(sqrt(0.1)), and the same above.
    expected = 2 / np.pi * np.arcsin(np.sqrt(0.1))
    tolerance = 5 * np.sqrt(expected / count)
    assert abs(np.mean(found < 3.0) - expected) < tolerance
    assert abs(np.mean(found > 11.0) - expected) < tolerance
    assert found.min() >= 2 and found.max() <= 12


def test_given_levels_come_in_rounds(key):
    levels = [3.0, -1.0, 10.0, 4.0]
    found = np.asarray(aprbs(key, 22, hold=(1, 1), levels=levels))
    for start in range(0, 20, 4):
        np.testing.assert_array_equal(np.sort(found[start : start + 4]), sorted(levels))
    assert set(found[20:]) <= set(levels) and found[20] != found[21]


@pytest.mark.slow
def test_a_sequence_can_be_made_inside_a_program(key):
    request = {"hold": (5, 9), "amplitude": (0.0, 1.0), "level_distribution": "latin"}
    keys = jax.random.split(key, 3)
    together = jax.jit(jax.vmap(lambda k: aprbs(k, 100, **request)))(keys)
    alone = jnp.stack([aprbs(k, 100, **request) for k in keys])
    np.testing.assert_allclose(together, alone, rtol=1e-15)


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"hold": (0, 5)}, "hold"),
        ({"hold": (6, 5)}, "hold"),
        ({"amplitude": (1.0, 0.0)}, "amplitude"),
        ({"amplitude": (0.0, np.inf)}, "amplitude"),
        ({"amplitude": (np.nan, 1.0)}, "amplitude"),
        ({"amplitude": None}, "amplitude"),
        ({"levels": [1.0]}, "amplitude"),
        ({"amplitude": None, "levels": []}, "levels"),
        ({"amplitude": None, "levels": [1.0, np.nan]}, "levels"),
        ({"length": 0}, "length"),
    ],
)
def test_wrong_requests_are_refused(key, wrong, field):
    request = {"length": 10, "hold": (1, 5), "amplitude": (0.0, 1.0)} | wrong
    with pytest.raises(SpecError) as caught:
        aprbs(key, **request)
    assert caught.value.field == field


def test_unknown_distributions_are_refused_without_a_type_check(key):
    from jaxnarx.checks import choice

    with pytest.raises(SpecError, match="Did you mean 'uniform'") as caught:
        choice("uniforn", ("uniform", "latin"), "level_distribution")
    assert caught.value.field == "level_distribution"


def test_steps_need_a_hold_and_finite_levels():
    for levels, hold, field in [([1.0], 0, "hold"), ([], 2, "levels")]:
        with pytest.raises(SpecError) as caught:
            steps(levels, hold=hold)
        assert caught.value.field == field
