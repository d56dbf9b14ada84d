"""Covariances and bands, against closed forms, dense algebra and random draws."""

import dataclasses
from functools import cache, partial
from typing import Any

import common
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.signal
import scipy.stats
from common import A, B, Y

from jaxnarx.confidence._bands import bands, root
from jaxnarx.confidence._uncertainty import (
    pseudo_inverse,
    rest_of_filter,
    uncertainty,
)
from jaxnarx.confidence.noise import estimate_noise
from jaxnarx.errors import SpecError
from jaxnarx.models import Network
from jaxnarx.refinement import freeze
from jaxnarx.refinement._refine import make_task
from jaxnarx.refinement.labels import label
from jaxnarx.refinement.layout import make_layout
from jaxnarx.simulation import run, simulate

SPARE: dict[str, Any] = {"spare_models": 1, "spare_slots": 1}
COUPLED = "coupled, by own output"
EPS = float(np.finfo(float).eps)


@cache
def data():
    return common.dataset()


@cache
def coupled() -> Network:
    return common.named(COUPLED, **SPARE)


@cache
def sure(noise: str = "white", start: str = "measured"):
    return uncertainty(coupled(), data(), noise=noise, start=start)


# closed forms ---------------------------------------------------------------------


def without_feedback() -> Network:
    """y(t) = 2 + 3 a(t) - 4 b(t-1), in physical units by the gains."""
    terms = [((0, 0), 0.2), ((0, 1), 0.6), ((0, 2), -0.2)]
    return common.network([common.Part([terms])], variables=((A, 0), (B, 1)), **SPARE)


def regressors(rows) -> np.ndarray:
    """1, a(t), b(t-1) of one record, physical units, without the first sample."""
    return np.column_stack([np.ones(len(rows) - 1), rows[1:, A], rows[:-1, B]])


def records():
    return [common.rows_of(data(), n) for n in range(len(data()))]


def test_without_feedback_it_is_linear_regression():
    found = uncertainty(without_feedback(), data()).raise_for_status()
    x = np.concatenate([regressors(r) for r in records()])
    y = np.concatenate([r[1:, Y] for r in records()])
    residual = y - x @ [2.0, 3.0, -4.0]
    variance = residual @ residual / (len(y) - 3)
    expected = variance * np.linalg.inv(x.T @ x)
    value = found.value
    assert value.names == tuple(f"y: model 1: {t}" for t in ("1", "a[t]", "b[t-1]"))
    np.testing.assert_allclose(value.estimate, [2.0, 3.0, -4.0], rtol=1e-12)
    # Inverses of well conditioned matrices (condition below a hundred).
    np.testing.assert_allclose(value.covariance, expected, rtol=1e-10)
    np.testing.assert_allclose(value.noise, np.sqrt(variance), rtol=1e-12)
    np.testing.assert_allclose(value.freedom, len(y) - 3)
    # The band of the run is that of the regression line.
    band = bands(without_feedback(), value, data()).value
    for n, rows in enumerate(records()):
        line = np.einsum("tp,pq,tq->t", x_n := regressors(rows), expected, x_n)
        np.testing.assert_allclose(band.deviation[n][1:, 0] ** 2, line, rtol=1e-10)


POLE, GAIN, OFFSET = 0.6, 2.5, 1.0


def first_order(**spare) -> Network:
    """y(t) = 0.6 y(t-1) + 2.5 a(t) + 1 in physical units, run freely."""
    terms = [((0, 0), OFFSET / 10), ((0, 1), GAIN / 5), ((0, 2), POLE)]
    return common.network([common.Part([terms])], variables=((A, 0), (Y, 1)), **spare)


def output_error(rows):
    """Run of the first-order model from its measured sample, S and H by the sums."""
    y, s, h = [rows[0, Y]], [np.zeros(3)], [1.0]
    for a in rows[1:, A]:
        s.append(np.array([1.0, a, y[-1]]) + POLE * s[-1])
        y.append(OFFSET + GAIN * a + POLE * y[-1])
        h.append(POLE * h[-1])
    return np.array(y[1:]), np.array(s[1:]), np.array(h[1:])


@pytest.mark.parametrize("start", ["exact", "measured"])
def test_a_first_order_output_error_model(start):
    value = uncertainty(first_order(**SPARE), data(), start=start).value
    parts = [output_error(r) for r in records()]
    residual = np.concatenate(
        [y - r[1:, Y] for (y, _, _), r in zip(parts, records(), strict=True)]
    )
    s = np.concatenate([s for _, s, _ in parts])
    variance = residual @ residual / (len(residual) - 3)
    inverse = np.linalg.inv(s.T @ s)
    meat = s.T @ s + (start == "measured") * sum(
        np.outer(s.T @ h, s.T @ h) for _, s, h in parts
    )
    expected = variance * inverse @ meat @ inverse
    np.testing.assert_allclose(value.covariance, expected, rtol=1e-9)
    band = bands(first_order(**SPARE), value, data()).value
    for n, (y, s, h) in enumerate(parts):
        plain = np.einsum("tp,pq,tq->t", s, expected, s)
        plain += (start == "measured") * variance * h**2
        np.testing.assert_allclose(band.run[n][1:, 0], y, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(band.deviation[n][1:, 0] ** 2, plain, rtol=1e-9)
        before = np.sqrt(variance) if start == "measured" else 0.0
        np.testing.assert_allclose(band.deviation[n][0, 0], before, rtol=1e-12)


def test_padding_changes_nothing():
    padded, plain = (uncertainty(first_order(**s), data()).value for s in (SPARE, {}))
    assert padded.names == plain.names
    np.testing.assert_allclose(padded.covariance, plain.covariance, rtol=1e-12)


# dense algebra --------------------------------------------------------------------


@cache
def dense():
    """Weighted residual derivatives of every record by parameters and start."""
    net = coupled()
    task, _ = make_task(net, data())
    layout = make_layout(net, None, (0.5, 2.0))
    anchor = task.anchors(None)
    real = label(net, layout).real
    measured, start = task.drive.measured, task.masks.start
    lags = start[:, None] - 1 - np.arange(2)[None]
    at = (np.arange(len(start))[:, None], lags)

    @jax.jit
    def outputs(p, h):
        moved = measured.at[at].add(jnp.swapaxes(h, 1, 2))
        drive = eqx.tree_at(lambda d: d.measured, task.drive, moved)
        return run(layout.place(p), drive, anchor)

    p, h = layout.gather(net), jnp.zeros((len(start), 2, 2))
    by_p, by_h = jax.jacfwd(outputs, (0, 1))(p, h)
    by_p = np.asarray(by_p / layout.slope(p)[None, None, None])[..., real]
    # A record's start moves that record alone.
    own = np.stack([np.asarray(by_h)[n, :, :, n] for n in range(len(start))])
    y = np.asarray(run(net, task.drive, anchor))
    return np.asarray(task.weight), y - np.asarray(measured), by_p, own


def correlation(shape: np.ndarray, length: int) -> np.ndarray:
    """Covariances of an autoregression of unit innovations, from its long response."""
    impulse = np.zeros(4000)
    impulse[0] = 1.0
    response = np.asarray(scipy.signal.lfilter([1.0], [1.0, *-shape], impulse))
    lags = [response[k:] @ response[: len(response) - k] for k in range(length)]
    return scipy.linalg.toeplitz(lags)


@pytest.mark.slow
@pytest.mark.parametrize("noise", ["white", "coloured"])
def test_the_sandwich_is_that_of_the_dense_matrices(noise):
    weight, residual, j, h = dense()
    scored = weight > 0
    found = estimate_noise(residual, scored, coloured=noise == "coloured", depth=2)
    if noise == "coloured":
        assert found.shape.shape[1] >= 1
    j = np.where(scored[..., None], j, 0.0)
    bread = np.einsum("rto,rtop,rtoq->pq", weight, j, j)
    size = np.sqrt(np.diagonal(bread))
    inverse = np.linalg.pinv(
        bread / np.outer(size, size), rcond=1e-11, hermitian=True
    ) / np.outer(size, size)
    value = sure(noise).value
    found = found.less(scored.sum(axis=(0, 1)) - value.freedom)
    meat = np.zeros_like(bread)
    pulled = weight[..., None] * j
    for o, variance in enumerate(found.innovation):
        r = variance * correlation(found.shape[o], j.shape[1])
        meat += np.einsum("rtp,ts,rsq->pq", pulled[:, :, o], r, pulled[:, :, o])
    begin = np.asarray(
        scipy.linalg.block_diag(*[scipy.linalg.toeplitz(c) for c in found.covariance])
    )
    by_start = np.einsum("rtop,rtoid->rpid", pulled, h)
    by_start = by_start.reshape(*by_start.shape[:2], -1)
    meat += np.einsum("rph,hi,rqi->pq", by_start, begin, by_start)
    slope = value.labels.slope[value.labels.real]
    expected = inverse @ meat @ inverse * np.outer(slope, slope)
    # The pseudo-inverse at a condition of 1e2 of J, 1e4 of J'J.
    scale = np.sqrt(np.outer(np.diagonal(expected), np.diagonal(expected)))
    np.testing.assert_allclose(value.covariance / scale, expected / scale, atol=1e-8)


def test_two_gaussians_in_one_variable_have_three_parameters():
    # Weights depend on differences of exponents: 2d + 1 a pair of models, beside 2d
    # parameters a model. Output y: 3 models, 2 dimensions; w: 2 models, 1 dimension.
    solution = sure()
    assert solution.status_name == "unidentifiable"
    parameters = len(solution.value.names)
    assert solution.stats["rank"] == parameters - (12 - 10) - (4 - 3)
    group = solution.stats["group"]
    assert all("centre" in name or "width" in name for name in group)
    kinds = ("centre", "width")
    assert {f"w: {k} of model {m} in b[t]" for k in kinds for m in (1, 2)} < {*group}
    assert np.all(np.isfinite(solution.value.covariance))
    assert "-" in solution.value.table


def test_rest_of_filter_and_pseudo_inverse():
    shape = np.array([1.2, -0.5, 0.1])
    state, total = np.array([0.3, -1.0, 2.0]), 0.0
    past = state.copy()
    for _ in range(400):
        now = shape @ past
        total += now**2
        past = np.array([now, *past[:-1]])
    np.testing.assert_allclose(state @ rest_of_filter(shape) @ state, total, rtol=1e-10)
    gram = np.diag([4.0, 0.0, 1e-8])
    inverse, lost, _ = pseudo_inverse(gram, 0.0, EPS)
    np.testing.assert_allclose(inverse, np.diag([0.25, 0.0, 1e8]))
    np.testing.assert_allclose(lost, [0.0, 1.0, 0.0])
    inverse, _, _ = pseudo_inverse(gram, 1.0, EPS)
    np.testing.assert_allclose(inverse, np.diag([0.125, 0.0, 0.5e8]))
    inverse, lost, _ = pseudo_inverse(np.full((2, 2), np.inf), 0.0, EPS)
    np.testing.assert_array_equal(inverse, 0.0)
    np.testing.assert_array_equal(lost, 1.0)


# colour ---------------------------------------------------------------------------


@pytest.mark.parametrize("pole", [0.0, 0.8])
def test_a_mean_under_first_order_noise(pole):
    # Variance of a mean of n samples: s^2/n (1 + pole)/(1 - pole) for large n.
    n = 4000
    rng = np.random.default_rng(3)
    e = np.asarray(scipy.signal.lfilter([1.0], [1.0, -pole], rng.normal(size=n)))
    rows = np.zeros((n, 4))
    rows[:, :2] = rng.normal(size=(n, 2))
    rows[:, Y], rows[:, Y + 1] = e, rng.normal(size=n)
    net = common.network([common.Part([[((0,), 0.0)]])], variables=((A, 0),))
    rough = common.from_rows([rows])
    white, coloured = (
        uncertainty(net, rough, noise=k).value.covariance[0, 0]
        for k in ("white", "coloured")
    )
    np.testing.assert_allclose(white, np.sum(e**2) / (n - 1) / n, rtol=1e-12)
    # The pole is known to sqrt((1 - pole^2)/n), the factor to 2/(1 - pole^2) times
    # that: 5 % at 0.8; four of these. White: AIC may keep a small spurious order.
    np.testing.assert_allclose(coloured / white, (1 + pole) / (1 - pole), rtol=0.2)


# bands ----------------------------------------------------------------------------


@pytest.mark.slow
def test_the_band_is_the_spread_of_random_draws():
    net, draws = coupled(), 600
    # So small a covariance that the run is linear in it.
    value = sure().value
    small = dataclasses.replace(
        value, covariance=1e-8 * value.covariance, start=1e-8 * value.start
    )
    f = root(small)
    rng = np.random.default_rng(0)
    deltas = rng.normal(size=(draws, f.shape[1])) @ f.T
    task, _ = make_task(net, data())
    layout = make_layout(net, None, (0.5, 2.0))
    p = layout.physical(layout.gather(net))
    anchor, start = task.anchors(None), task.masks.start
    unbounded = eqx.tree_at(
        lambda a: (a.low, a.high),
        layout,
        (jnp.full_like(p, -jnp.inf), jnp.full_like(p, jnp.inf)),
    )
    at = (np.arange(len(start))[:, None], start[:, None] - 1 - np.arange(2)[None])

    @jax.jit
    @partial(jax.vmap)
    def outputs(delta):
        h = jnp.swapaxes(delta[len(p) :].reshape(2, 2), 0, 1)
        moved = task.drive.measured.at[at].add(jnp.broadcast_to(h, (len(start), 2, 2)))
        drive = eqx.tree_at(lambda d: d.measured, task.drive, moved)
        return run(unbounded.place(p + delta[: len(p)]), drive, anchor)

    y = np.asarray(outputs(jnp.asarray(deltas)))
    gain = np.asarray(net.gain)[list(net.signals)]
    found = bands(net, small, data()).value
    for n, record in enumerate(data()):
        s = int(start[n])
        spread = y[:, n, s : len(record)].std(axis=0) * gain
        # A standard deviation of 600 draws is known to 1/sqrt(1200) = 3 %; five of
        # these over some hundred correlated samples.
        ratio = found.deviation[n][s:] / spread
        np.testing.assert_allclose(ratio, 1.0, rtol=0.15)


def test_widths_are_quantiles_and_noise_adds():
    value = sure().value
    found = bands(coupled(), value, data(), level=0.9).value
    wide = scipy.stats.t.ppf(0.95, value.freedom)
    for n in range(len(data())):
        y, s = found.run[n], found.deviation[n]
        np.testing.assert_allclose(found.upper[n] - y, s * wide, rtol=1e-9)
        np.testing.assert_allclose(y - found.lower[n], s * wide, rtol=1e-9)
        noisy = np.sqrt(s[2:] ** 2 + value.noise**2) * wide
        np.testing.assert_allclose(found.measured_upper[n][2:] - y[2:], noisy)
        np.testing.assert_allclose(y[2:] - found.measured_lower[n][2:], noisy)
        np.testing.assert_allclose(
            found.measured_upper[n][:2] - y[:2], [value.noise * wide] * 2
        )


def test_no_noise_no_band():
    net = coupled()
    exact = simulate(net, data()).value
    rows = [
        np.concatenate([r[:, :2], exact[n]], axis=1) for n, r in enumerate(records())
    ]
    clean = common.from_rows(rows)
    value = uncertainty(net, clean).value
    found = bands(net, value, clean).value
    for s, y in zip(found.deviation, found.run.outputs, strict=True):
        assert np.all(s <= 1e-10 * np.abs(y).max())


@pytest.mark.slow
def test_what_is_frozen_contributes_nothing():
    net = coupled()
    tree = freeze(net, coefficients=False, partition=False)
    tree = eqx.tree_at(lambda n: n.models[1].local.coefficient, tree, True)
    part = uncertainty(net, data(), trainable=tree, start="exact").value
    assert {name.split(":")[0] for name in part.names} == {"w"}
    full = sure(start="exact").value
    narrow, wide = (bands(net, v, data()).value for v in (part, full))
    for n in range(len(data())):
        # y does not depend on w, and the samples before the first are exact.
        np.testing.assert_array_equal(narrow.deviation[n][:, 0], 0.0)
        share = narrow.deviation[n][:, 1] / part.noise[1]
        assert np.all(share <= wide.deviation[n][:, 1] / full.noise[1] * (1 + 1e-9))


def test_a_doubled_input_leaves_two_parameters_undetermined():
    rows = records()
    for r in rows:
        # b(t-1) is a(t): what the model sees twice.
        r[:-1, B] = r[1:, A] / 4
    twice = common.from_rows(rows)
    net = without_feedback()
    solution = uncertainty(net, twice)
    assert solution.status_name == "unidentifiable" and not solution.is_okay
    assert solution.stats["group"] == ["y: model 1: a[t]", "y: model 1: b[t-1]"]
    assert "a[t]" in solution.detail and solution.stats["rank"] == 2
    assert np.all(np.isfinite(solution.value.covariance))
    # The run is as sure as that of the regression on one of them.
    x = np.concatenate([regressors(r)[:, :2] for r in rows])
    y = np.concatenate([r[1:, Y] for r in rows])
    residual = y - x @ [2.0, 2.0]
    c = residual @ residual / (len(y) - 2) * np.linalg.inv(x.T @ x)
    found = bands(net, solution.value, twice).value
    for n, r in enumerate(rows):
        plain = np.einsum("tp,pq,tq->t", x_n := regressors(r)[:, :2], c, x_n)
        np.testing.assert_allclose(found.deviation[n][1:, 0] ** 2, plain, rtol=1e-9)


# trouble --------------------------------------------------------------------------


def test_limited_samples_have_no_width_and_all_is_finite():
    net = common.named(COUPLED, bound=0.25, **SPARE)
    solution = uncertainty(net, data())
    assert solution.status_name == "diverged"
    assert solution.stats["channel"] in net.output_names
    found = bands(net, solution.value, data())
    assert found.status_name == "diverged"
    limit = 0.25 * common.GAIN[Y:]
    for n, held in enumerate(found.value.run.limited):
        assert held.any()
        np.testing.assert_array_equal(found.value.deviation[n][held], 0.0)
        assert np.all(np.abs(found.value.upper[n][2:]) <= limit * (1 + 1e-12))
        every = (found.value.measured_lower[n], found.value.measured_upper[n])
        assert np.all(np.isfinite(every))


def test_an_overflow_gives_the_whole_range():
    # An unstable model that happens to stand at its equilibrium: the run stays, its
    # derivative grows by 10^40 a sample.
    terms = [((0, 0), 0.0), ((0, 1), 0.0), ((0, 2), 1e40)]
    net = common.network([common.Part([terms])], variables=((A, 0), (Y, 1)), **SPARE)
    rows = records()
    for r in rows:
        r[:, Y] = 0.0
    solution = uncertainty(net, common.from_rows(rows))
    assert solution.status_name == "diverged"
    value = dataclasses.replace(solution.value, start=np.full((1, 1), 1.0))
    found = bands(net, value, common.from_rows(rows)).value
    np.testing.assert_array_equal(found.upper[0][-1], 500.0)
    np.testing.assert_array_equal(found.lower[0][-1], -500.0)
    assert np.all(np.isfinite(found.measured_upper[0]))


def test_too_few_samples():
    rows = [r[:3] for r in records()[:1]]
    solution = uncertainty(without_feedback(), common.from_rows(rows))
    assert solution.status_name == "too_short"
    assert solution.channel == "y"
    assert np.all(np.isfinite(solution.value.covariance))


def test_wrong_requests():
    net = first_order(**SPARE)
    for wrong in ({"noise": "pink"}, {"start": "guess"}, {"ridge": -1.0}):
        options: dict[str, Any] = wrong
        with pytest.raises(SpecError) as caught:
            uncertainty(net, data(), **options)
        assert caught.value.field == next(iter(wrong))
    value = uncertainty(net, data()).value
    with pytest.raises(SpecError, match="between 0 and 1"):
        bands(net, value, data(), level=95)
    with pytest.raises(SpecError, match="another structure"):
        bands(coupled(), value, data())
