"""Fits of every class: recovery, standard errors, derivatives, borders, bad input."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal
from linear_problems import (
    LEVEL,
    MEAN,
    NUMERATOR,
    SETTINGS,
    TRUE,
    C,
    D,
    F,
    dataset,
    record,
    records,
)

from jaxnarx.arrays import evaluate_at, has_stable_roots
from jaxnarx.errors import DataError, SpecError
from jaxnarx.linear import fit_linear, innovations
from jaxnarx.linear.prediction_error import PredictionErrorProblem
from jaxnarx.linear.recursion import Signals, residuals, states
from jaxnarx.linear.stability import radius, reflect_roots
from jaxnarx.linear.structure import make_structure
from jaxnarx.settings.linear import ARMAX, ARX, FIR, BoxJenkins, OutputError
from jaxnarx.solution import RESULTS

SAMPLES = 1000


@pytest.fixture(scope="module")
def fits():
    """Every class on two records of its own system."""
    out = {}
    for kind, method in SETTINGS.items():
        out[kind] = fit_linear(records(kind, (1, 2), SAMPLES), method)
    return out


@pytest.mark.parametrize("kind", SETTINGS)
def test_known_systems_are_recovered_within_their_standard_errors(fits, kind):
    found = fits[kind]
    assert found.status == RESULTS.ok
    model = found.value
    z = (np.asarray(model.parameters) - TRUE[kind]) / model.standard_errors
    # Chance exceeds 4.5 in one of 150,000 parameters.
    assert np.abs(z).max() < 4.5
    # A chi square of N degrees: five standard deviations of sqrt(2/N).
    assert abs(float(model.noise_variance) - 1) < 5 * np.sqrt(2 / (2 * SAMPLES))
    assert model.stable
    assert len(model.parameter_names) == len(z)


def test_armax_without_noise_terms_is_arx(fits):
    data = records("ARX", (1, 2), SAMPLES)
    found = fit_linear(data, ARMAX(2, 2, 0, 2))
    np.testing.assert_array_equal(found.value.parameters, fits["ARX"].value.parameters)


def test_arx_is_plain_least_squares_with_its_covariance(fits):
    """The textbook formulas in physical units, on rows made by hand."""
    rows, target = [], []
    for seed in (1, 2):
        u, y = record("ARX", seed, SAMPLES)
        for t in range(3, SAMPLES):
            rows.append([-y[t - 1], -y[t - 2], u[t - 2], u[t - 3], 1.0])
            target.append(y[t])
    x, y = np.array(rows), np.array(target)
    theta, (sse,), _, _ = np.linalg.lstsq(x, y, rcond=None)
    covariance = sse / (len(y) - 5) * np.linalg.inv(x.T @ x)
    model = fits["ARX"].value
    # The plain columns have a condition of 1e5: half the digits of the inverse.
    np.testing.assert_allclose(model.parameters, theta, rtol=1e-6)
    np.testing.assert_allclose(
        model.standard_errors, np.sqrt(np.diagonal(covariance)), rtol=1e-4
    )


def test_arx_standard_errors_are_those_of_repetition():
    scores = []
    for seed in range(80):
        model = fit_linear(records("ARX", (seed,), 400), SETTINGS["ARX"]).value
        error = np.asarray(model.parameters) - TRUE["ARX"]
        scores.append(error / model.standard_errors)
    # The scatter of 80 figures is known to 8 %: three of these and the bias.
    assert np.all(np.abs(np.std(scores, axis=0) - 1) < 0.3)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ARMAX", "OE", "BJ"])
def test_standard_errors_of_searches_are_those_of_repetition(kind):
    scores = []
    for seed in range(80):
        model = fit_linear(records(kind, (seed,), 1000), SETTINGS[kind]).value
        scores.append(
            (np.asarray(model.parameters) - TRUE[kind]) / model.standard_errors
        )
    # The scatter of 80 figures is known to 8 %: three of these and the bias.
    assert np.all(np.abs(np.std(scores, axis=0) - 1) < 0.3)


def scaled_problem(kind: str, seed: int = 1):
    """A problem of unit size with some samples unknown, and a vector to stand at."""
    data = records(kind, (seed, seed + 1), SAMPLES)
    structure = make_structure(SETTINGS[kind], data.channels)
    u = np.stack([r.u for r in data])
    y = np.stack([r.y[:, 0] for r in data])
    known = np.ones(y.shape, bool)
    known[:, :4] = known[0, 300:310] = False
    signals = Signals(
        jnp.asarray((u - MEAN) * 100), jnp.asarray((y - LEVEL) / 10), jnp.asarray(known)
    )
    theta = np.asarray(TRUE[kind]) * 0.9
    theta[: len(theta)] = np.where(np.abs(theta) > 5, theta / 1000, theta)
    rng = np.random.default_rng(0)
    initial = rng.normal(size=2 * states(structure))
    return PredictionErrorProblem(structure, signals), np.concatenate([theta, initial])


@pytest.mark.parametrize("order", [0, 1, 2, 3, 6])
def test_stability_by_steps_down_is_that_of_the_roots(order):
    rng = np.random.default_rng(order)
    poles = rng.uniform(0.5, 1.2, (200, order)) ** 0.5 * rng.choice([-1, 1], order)
    told = jax.jit(jax.vmap(has_stable_roots))
    polynomials = np.stack([np.poly(p) if order else np.ones(1) for p in poles])
    # Coefficients at random have complex roots, too, and orders may be zero.
    some = 0.6 * rng.normal(size=polynomials.shape)
    some[:, 0], some[::3, -1] = 1.0, 0.0 if order else 1.0
    for found in (polynomials, some):
        inside = np.array([radius(p) < 1 for p in found])
        np.testing.assert_array_equal(told(found), inside)
        assert not order or inside.any() and not inside.all()
    assert not told(np.full((1, order + 1), np.nan))[0]


def test_the_derivative_is_that_of_central_differences():
    """By parameters and initial states, across samples that are not known."""
    problem, u = scaled_problem("BJ")
    found = jax.device_get(evaluate_at(problem.linear, u))

    def loss(u) -> float:
        return float(evaluate_at(problem.loss, u))

    assert found.loss == pytest.approx(loss(u), rel=1e-12)
    step = 1e-6
    for n in range(len(u)):
        ahead, behind = u.copy(), u.copy()
        ahead[n] += step
        behind[n] -= step
        slope = (loss(ahead) - loss(behind)) / (4 * step)
        # Rounding of the loss, 1e-16 of it, over the step.
        assert found.gradient[n] == pytest.approx(slope, abs=1e-8 * found.loss)


def test_gauss_newton_matrix_is_that_of_the_innovations():
    problem, u = scaled_problem("BJ")
    count = problem.structure.size

    def e(u):
        parts = jnp.asarray(u[:count]), jnp.asarray(u[count:].reshape(2, -1))
        return np.asarray(residuals(problem.structure, *parts, problem.data)).ravel()

    columns = []
    for n in range(len(u)):
        step = np.zeros(len(u))
        step[n] = 1e-6
        columns.append((e(u + step) - e(u - step)) / 2e-6)
    j = np.stack(columns, axis=1)
    gram = evaluate_at(problem.linear, u).gram
    np.testing.assert_allclose(
        gram, j.T @ j, rtol=1e-6, atol=1e-6 * np.abs(j).max() ** 2
    )


def test_innovations_are_those_of_the_inverse_filter(fits):
    """From rest, where nothing depends on initial values."""
    model = fits["BJ"].value
    exact = eqx.tree_at(lambda m: m.parameters, model, jnp.asarray(TRUE["BJ"]))
    rng = np.random.default_rng(3)
    e = rng.normal(size=SAMPLES)
    u = np.full(SAMPLES, MEAN)
    e[:10], u[10:] = 0.0, rng.uniform(0.38, 0.41, SAMPLES - 10)
    y = LEVEL + np.asarray(scipy.signal.lfilter(NUMERATOR, F, u - MEAN))
    y += scipy.signal.lfilter(C, D, e)
    found = innovations(exact, dataset([u, u], [y, y]))
    # The states are least squares, so they take up a little of the noise at the start.
    settled = slice(60, None)
    np.testing.assert_allclose(found.error[0][settled], e[settled], atol=1e-6)
    np.testing.assert_array_equal(found.error[0], found.error[1])
    np.testing.assert_allclose(found.predicted[0] + found.error[0], y, rtol=1e-14)
    assert found.scored[0].sum() == SAMPLES - 3
    assert len(found.pooled) == 2 * (SAMPLES - 3)


def test_innovations_of_the_fit_are_what_it_minimised(fits):
    data = records("OE", (1, 2), SAMPLES)
    found = innovations(fits["OE"].value, data)
    loss = fits["OE"].stats["loss"]
    # The search ends when a step gains less than 1e-9.
    assert np.sum(found.pooled**2) == pytest.approx(loss, rel=1e-7)
    shifted = data.records[0].y[:, 0] - found.error[0]
    np.testing.assert_allclose(found.predicted[0], shifted)


@pytest.mark.parametrize("kind", ["ARX", "OE"])
def test_records_and_gaps_are_borders(fits, kind):
    """What lies in a masked sample cannot matter, nor what another record holds."""
    u, y = record(kind, 1, SAMPLES)
    parameters = []
    for junk in (0.0, 1e4):
        broken = y.copy()
        broken[500] = np.nan
        # The sample before the gap is what the gap is held at.
        data = dataset([u, u], [broken, y], missing="mask")
        data.records[0].y[500] += junk
        parameters.append(fit_linear(data, SETTINGS[kind]).value.parameters)
    # The search may start elsewhere; it ends when a step gains less than 1e-9.
    np.testing.assert_allclose(*parameters, rtol=1e-5)


def test_units_do_not_matter(fits):
    data = records("OE", (1, 2), SAMPLES)
    us = [100 * r.u for r in data]
    ys = [r.y / 60 for r in data]
    found = fit_linear(dataset(us, ys), SETTINGS["OE"]).value
    scale = np.array([1 / 6000, 1 / 6000, 1, 1, 1 / 60])
    # Two searches that end when a step gains less than 1e-9 of the loss.
    np.testing.assert_allclose(
        found.parameters, np.asarray(fits["OE"].value.parameters) * scale, rtol=1e-4
    )


def test_reflection_keeps_the_magnitude():
    p = np.poly([1.25, 0.5, 0.8 + 0.9j, 0.8 - 0.9j]).real
    q = reflect_roots(p)
    assert radius(p) > 1 > radius(q)
    w = np.exp(1j * np.linspace(0.1, 3, 7))
    ratio = np.abs(np.polyval(p, w)) / np.abs(np.polyval(q, w))
    np.testing.assert_allclose(ratio, ratio[0])
    np.testing.assert_array_equal(reflect_roots(q), q)


def test_unstable_polynomials_are_no_step():
    problem, u = scaled_problem("BJ")
    u[2] = 1.2
    assert evaluate_at(problem.loss, u) == np.inf


@pytest.mark.parametrize("method", [ARX(1, 2, 1), OutputError(1, 1)])
def test_a_constant_input_is_not_identifiable(method):
    u, y = record("ARX", 1, SAMPLES)
    data = dataset(np.full(SAMPLES, 0.4), y)
    found = fit_linear(data, method)
    assert found.status == RESULTS.unidentifiable and not found.is_okay
    assert "b1(duty)" in found.detail or "b2(duty)" in found.detail
    # The smallest: rounding of the mean is not fitted.
    np.testing.assert_array_equal(found.value.b[0], 0.0)
    assert np.all(np.isfinite(found.value.parameters))
    assert np.all(np.isfinite(found.value.standard_errors))


def test_an_unstable_fit_says_so():
    y = 1.05 ** np.arange(120.0) + 0.01 * np.random.default_rng(0).normal(size=120)
    found = fit_linear(dataset(np.sin(np.arange(120.0)), y), ARX(1, 1, 1))
    assert found.is_okay and not found.value.stable
    assert "unstable" in found.detail and found.stats["pole"] > 1


@pytest.mark.parametrize(
    "method",
    [ARX(2, 2, 200), FIR(60), OutputError(2, 2, 200), ARMAX(40, 40, 2)],
    ids=["delay", "long", "delay of a search", "parameters"],
)
def test_too_few_samples_are_data_errors(method):
    u, y = record("ARX", 1, 100)
    with pytest.raises(DataError, match="need at least"):
        fit_linear(dataset(u, y), method)


@pytest.mark.parametrize("method", [ARX(1, 1), OutputError(1, 1)])
def test_a_constant_output_is_a_data_error(method):
    u, _ = record("ARX", 1, 100)
    with pytest.raises(DataError, match="speed is constant"):
        fit_linear(dataset(u, np.full(100, 7.0)), method)


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: ARX(-1), "na"),
        (lambda: ARX(1, 0), "nb"),
        (lambda: ARX(1, (1, True)), "nb"),
        (lambda: ARX(1, {"duty": 1}, [-1]), "nk"),
        (lambda: BoxJenkins(nc=-1), "nc"),
        (lambda: OutputError(tolerance=1.0), "tolerance"),
    ],
)
def test_wrong_orders_name_their_field(make, field):
    with pytest.raises(SpecError) as error:
        make()
    assert error.value.field == field


def test_orders_by_input_must_name_inputs():
    u, y = record("ARX", 1, 100)
    for method in (ARX(1, {"dutty": 2}), ARX(1, (1, 2))):
        with pytest.raises(SpecError, match="duty"):
            fit_linear(dataset(u, y), method)
    with pytest.raises(SpecError, match="name one"):
        fit_linear(dataset(u, y), ARX(1, 1), output="torque")
