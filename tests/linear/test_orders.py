"""Order search: every structure as plain least squares has it, and the true one."""

import itertools

import jax
import numpy as np
import pytest
import scipy.signal
from linear_problems import dataset, record, records

from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.excitation import aprbs
from jaxnarx.linear import fit_linear, search_orders
from jaxnarx.settings.linear import ARX
from jaxnarx.solution import RESULTS

RANGE = range(1, 4)
LONGEST = 5
"""Lags of the output to 3, of inputs to 3 + 2."""


def naive(us, ys, structures):
    """A regression for every (na, nbs, nks), on the samples the largest can use."""
    out = []
    for na, nb, nk in structures:
        rows, target = [], []
        for u, y in zip(us, ys, strict=True):
            for t in range(LONGEST, len(y)):
                past = [y[t - k] for k in range(1, na + 1)]
                for i, (n, d) in enumerate(zip(nb, nk, strict=True)):
                    past += [u[t - d - k, i] for k in range(n)]
                rows.append([*past, 1.0])
                target.append(y[t])
        _, (sse,), _, _ = np.linalg.lstsq(np.array(rows), np.array(target), rcond=None)
        total = len(target) * np.var(target)
        out.append(100 * sse / total)
    return np.array(out)


def two_inputs(samples=(200, 150)):
    rng = np.random.default_rng(5)
    us, ys = [], []
    for n in samples:
        u = rng.normal(size=(n, 2))
        y = scipy.signal.lfilter([0, 1, 0.5], [1, -0.6, 0.2], u[:, 0])
        y += scipy.signal.lfilter([0, 0, 0.7], [1, -0.6, 0.2], u[:, 1])
        us.append(u)
        ys.append(np.asarray(y) + 100 + 0.3 * rng.normal(size=n))
    data = Dataset.from_arrays(
        us, ys, inputs=["a", "b"], outputs=["y"], sample_time=0.1
    )
    return us, ys, data


def structures_of(found):
    return [
        (int(found.na[n]), tuple(found.nb[n]), tuple(found.nk[n]))
        for n in range(len(found))
    ]


def test_every_structure_equals_its_own_regression():
    us, ys, _ = two_inputs()
    us = [u[:, :1] for u in us]
    data = Dataset.from_arrays(us, ys, inputs=["a"], outputs=["y"], sample_time=0.1)
    found = search_orders(data, na=RANGE, nb=RANGE, nk=RANGE).value
    structures = structures_of(found)
    every = itertools.product(RANGE, [(n,) for n in RANGE], [(n,) for n in RANGE])
    assert sorted(structures) == sorted(every)
    expected = naive(us, ys, structures)
    np.testing.assert_allclose(found.unexplained, expected, rtol=1e-8)
    # Criteria from the same sums of squares.
    n = found.parameters + 1
    fit = found.samples * np.log(found.unexplained)
    np.testing.assert_allclose(np.ptp(found.aic - fit - 2 * n), 0, atol=1e-8)
    log = np.log(found.samples)
    np.testing.assert_allclose(np.ptp(found.mdl - fit - log * n), 0, atol=1e-8)
    assert found.samples == 350 - 2 * LONGEST


@pytest.mark.parametrize("together", [True, False])
def test_several_inputs_equal_their_own_regressions(together):
    us, ys, data = two_inputs()
    found = search_orders(
        data, na=(1, 3), nb=(1, 3), nk=(1, 3), together=together
    ).value
    assert len(found) == (8 if together else 32)
    expected = naive(us, ys, structures_of(found))
    np.testing.assert_allclose(found.unexplained, expected, rtol=1e-8)


def test_true_orders_of_two_inputs_are_found():
    _, _, data = two_inputs((3000,))
    found = search_orders(data, na=RANGE, nb=RANGE, nk=RANGE).value
    best = found.orders(found.best_place("mdl"))
    # Noise on the output raises n_a; the delays stay.
    assert best[2] == (1, 2)
    method = found.best()
    assert method.nk == {"a": 1, "b": 2}
    fit = fit_linear(data, method)
    share = 100 * fit.stats["loss"] / np.sum((data.records[0].y - 100) ** 2)
    # The fit uses the few samples that the largest structure cannot.
    assert share == pytest.approx(found.unexplained[found.best_place()], rel=0.01)


def test_without_noise_the_smallest_true_structure_wins():
    u, y = record("ARX", 3, 600, noise=0.0)
    found = search_orders(dataset(u, y), na=RANGE, nb=RANGE, nk=RANGE)
    assert found.value.best() == ARX(2, 2, 2)
    assert found.value.best("aic") == ARX(2, 2, 2)


def test_scale_and_offset_change_nothing():
    data = records("ARX", (1, 2), 500)
    moved = dataset([1e3 * r.u + 7 for r in data], [r.y / 60 - 5 for r in data])
    first = search_orders(data, na=RANGE, nb=RANGE, nk=RANGE).value
    second = search_orders(moved, na=RANGE, nb=RANGE, nk=RANGE).value
    np.testing.assert_allclose(first.unexplained, second.unexplained, rtol=1e-8)
    assert first.best() == second.best() == ARX(2, 2, 2)


def test_masked_samples_are_in_no_window():
    us, ys, _ = two_inputs((200,))
    u, y = us[0][:, :1], ys[0].copy()
    y[100] = np.nan
    gap = Dataset.from_arrays(
        u, y, inputs=["a"], outputs=["y"], sample_time=0.1, missing="mask"
    )
    halves = Dataset.from_arrays(
        # After the gap the last lag of the output is needed, but not of the input.
        [u[:100], u[101 - 2 :]],
        [y[:100], np.concatenate([[0.0, 0.0], y[101:]])],
        inputs=["a"],
        outputs=["y"],
        sample_time=0.1,
    )
    one = (3,)
    a, b = (search_orders(d, na=one, nb=one, nk=one).value for d in (gap, halves))
    assert a.samples == b.samples == 200 - LONGEST - 4
    np.testing.assert_allclose(a.aic, b.aic, rtol=1e-10)


def test_a_free_series_has_orders_of_its_own_past():
    rng = np.random.default_rng(0)
    y = scipy.signal.lfilter([1], [1, -1.2, 0.8], rng.normal(size=2000))
    data = Dataset.from_arrays(None, y, inputs=[], outputs=["y"], sample_time=1.0)
    found = search_orders(data, na=range(1, 6)).value
    assert int(found.na[found.best_place()]) == 2
    with pytest.raises(SpecError, match="no input"):
        search_orders(data, na=(0,))


def test_the_frontier_falls_and_holds_the_best():
    found = search_orders(records("ARX", (1,), 500), na=RANGE, nb=RANGE, nk=RANGE).value
    rows = found.table
    sizes = [row["parameters"] for row in rows]
    assert sizes == sorted(set(found.parameters.tolist()))
    for row, size in zip(rows, sizes, strict=True):
        assert row["unexplained"] == found.unexplained[found.parameters == size].min()
    assert "<- " in str(found) and len(str(found).splitlines()) == 2 + len(rows)


def test_a_constant_input_is_not_identifiable():
    _, y = record("ARX", 1, 300)
    still = np.full(300, 0.4)
    found = search_orders(dataset(still, y), na=RANGE, nb=RANGE, nk=RANGE)
    assert found.status == RESULTS.unidentifiable
    assert "duty" in found.detail and not found.value.identifiable.any()
    assert not len(found.value.frontier)


def test_a_period_shorter_than_the_lags_marks_the_long_structures():
    """An input of period 4 has three independent lags beside the constant."""
    _, y = record("ARX", 1, 300)
    u = np.tile([0.38, 0.40, 0.39, 0.41], 75)
    found = search_orders(dataset(u, y), na=(1,), nb=range(1, 6), nk=(1,)).value
    np.testing.assert_array_equal(found.identifiable, found.nb[:, 0] <= 3)
    assert found.nb[found.best_place("unexplained"), 0] <= 3
    # A dependent column explains nothing more.
    np.testing.assert_allclose(found.unexplained[3:], found.unexplained[2], rtol=1e-9)


@pytest.mark.parametrize(
    ("grid", "error"),
    [
        ({"nk": (200,)}, DataError),
        ({"na": (0, -1)}, SpecError),
        ({"nb": ()}, SpecError),
        ({"nb": {"dutty": (1,)}}, SpecError),
        ({"na": range(1, 100), "nb": range(1, 100), "nk": range(1, 100)}, SpecError),
    ],
)
def test_impossible_grids_are_refused(grid, error):
    u, y = record("ARX", 1, 150)
    with pytest.raises(error):
        search_orders(dataset(u, y), **grid)


def test_an_unknown_criterion_is_refused():
    found = search_orders(records("ARX", (1,), 200), na=(1,), nb=(1,), nk=(1,)).value
    with pytest.raises(SpecError, match="mdl"):
        found.best("bic2")


@pytest.mark.slow
def test_the_orders_of_the_thesis_are_found_by_mdl():
    """(4.46): n_a = n_b = n_k = 6; duty 0.38 to 0.41, equation noise of 1 rpm."""
    b = [0] * 6 + [40.98, 15.69, 23.6, 18.99, 20.27, 65.12]
    a = [1, -0.4303, -0.3422, -0.2126, -0.1174, -0.0136, 0.143]
    hits = 0
    for seed in range(20):
        key = jax.random.key(seed)
        u = np.asarray(aprbs(key, 10_200, hold=(5, 40), amplitude=(0.38, 0.41)))
        e = np.random.default_rng(seed).normal(size=len(u))
        y = 1000 + np.asarray(scipy.signal.lfilter(b, a, u - 0.395))
        y += scipy.signal.lfilter([1], a, e)
        found = search_orders(dataset(u[200:], y[200:])).value
        hits += found.orders(found.best_place("mdl")) == (6, 6, 6)
    assert hits >= 18
