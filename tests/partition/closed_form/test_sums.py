"""Sums of candidates are made where groups left out gain, and only there."""

import dataclasses
import itertools

import common
import numpy as np
import pytest

from jaxnarx.partition.closed_form.sums import Summand, align_errors, best_sum

GROUPS = 4
AT = tuple(np.arange(200) + 1000 * g for g in range(GROUPS))


def part(name: str, errors: list[np.ndarray], at=AT) -> Summand:
    left = list(zip(at, errors, strict=True))
    return Summand(name, common.named("by inputs"), left, left[0])


def noise(seed: int, size: float) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [size * rng.normal(size=len(at)) for at in AT]


def plain_best(parts: list[Summand], most: int) -> tuple[float, tuple[str, ...]]:
    """The smallest error of a mean of `most` parts, one after the other."""
    errors = [np.concatenate([e for _, e in p.left]) for p in parts]
    taken = [int(np.argmin([np.sum(e**2) for e in errors]))]
    while len(taken) < most:
        tried = {
            m: np.mean([errors[n] for n in (*taken, m)], 0)
            for m in range(len(parts))
            if m not in taken
        }
        taken.append(min(tried, key=lambda m: np.sum(tried[m] ** 2)))
    mean = np.mean([errors[n] for n in taken], axis=0)
    return float(np.sqrt(np.mean(mean**2))), tuple(parts[n].name for n in taken)


def test_parts_that_err_in_different_ways_are_added_one_after_the_other():
    parts = [part(f"p{n}", noise(n, 1.0 + 0.05 * n)) for n in range(6)]
    found = best_sum(parts, 4)
    assert found is not None
    error, names = plain_best(parts, 4)
    np.testing.assert_allclose(found.free_run, error, rtol=1e-12)
    assert tuple(p.name for p in found.parts) == names
    # Independent errors: half the size, as far as their sizes are alike.
    assert found.free_run < 0.6
    np.testing.assert_allclose(found.losses().mean(), error**2, rtol=1e-12)


def test_the_name_tells_the_parts():
    """The second part is opposite to the first: they are nothing together."""
    first = noise(0, 1.0)
    parts = [part("a", first), part("b", [-e for e in first])]
    found = best_sum(parts, 4)
    assert found is not None and found.name == "mean of a; b"
    assert found.free_run < 1e-12 and found.one_step() == pytest.approx(0, abs=1e-12)


def test_one_step_is_told_where_all_parts_tell_theirs():
    first = noise(0, 1.0)
    parts = [part("a", first), part("b", [-e for e in first])]
    found = best_sum([parts[0], dataclasses.replace(parts[1], ahead=None)], 2)
    assert found is not None and found.one_step() is None


@pytest.mark.parametrize("most", [0, 1])
def test_of_one_there_is_no_sum(most):
    assert best_sum([part("a", noise(0, 1.0)), part("b", noise(1, 1.0))], most) is None


@pytest.mark.parametrize(("size", "gains"), [(1.6, True), (1.8, False)])
def test_what_gains_less_than_three_percent_is_no_sum(size, gains):
    """Independent errors of sizes 1 and s: the mean has sqrt(1 + s^2)/2."""
    parts = [part("a", noise(0, 1.0)), part("b", noise(1, size))]
    expected = np.sqrt(1 + size**2) / 2
    assert (expected < 0.97) == gains
    found = best_sum(parts, 2)
    assert (found is not None) == gains
    assert best_sum(parts[:1], 4) is None
    assert best_sum([], 4) is None


def test_only_places_that_all_have_are_compared():
    """Candidates with longer memories answer later; an empty group judges nothing."""
    late = [at[k:] for k, at in enumerate(AT)]
    one, two = noise(0, 1.0), noise(1, 1.0)
    short = [e[k:] for k, e in enumerate(two)]
    mixed = [np.random.default_rng(g).permutation(len(at)) for g, at in enumerate(late)]
    pairs = list(zip(late, short, mixed, strict=True))
    other = part("b", [e[m] for _, e, m in pairs], [at[m] for at, _, m in pairs])
    first, second = align_errors([part("a", one).left, other.left])
    for g, k in itertools.product(range(GROUPS), (0, 1)):
        expected = (one, two)[k][g][g:]
        np.testing.assert_array_equal((first, second)[k][g], expected)
    gone = part(
        "c", [two[0], *(np.zeros(0) for _ in AT[1:])], [AT[0]] + 3 * [AT[1][:0]]
    )
    found = best_sum([part("a", one), gone], 2)  # of one group, then
    assert found is not None and np.isnan(found.losses()[1:]).all()
