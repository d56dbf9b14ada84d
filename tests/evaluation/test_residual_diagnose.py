"""The verb `diagnose`: what it takes from networks, and what it says of them."""

import dataclasses
import json

import numpy as np
import pytest
import scipy.stats

from jaxnarx.data import Dataset, Record
from jaxnarx.errors import SpecError
from jaxnarx.evaluation import report
from jaxnarx.evaluation.residual_tests import diagnose, one_step
from jaxnarx.models import hold_to_range
from jaxnarx.partition import grow
from jaxnarx.regressors import polynomial_pool
from jaxnarx.settings import Global, Lolimot
from jaxnarx.simulation import predict


def record(rng, samples, name, missing=(), square=0.3):
    """y = 0.5 y(t-1) + a(t-1) + square b(t-1)^2 + e."""
    u, e = rng.normal(size=(samples, 2)), 0.2 * rng.normal(size=samples)
    y = np.zeros(samples)
    for t in range(1, samples):
        y[t] = 0.5 * y[t - 1] + u[t - 1, 0] + square * u[t - 1, 1] ** 2 + e[t]
    valid = np.ones((samples, 3), bool)
    valid[list(missing)] = False
    u, y = np.where(valid[:, :2], 40 * u, 0.0), np.where(valid[:, 2], 7 * y, 0.0)
    return Record(u, y[:, None], valid, name)


@pytest.fixture(scope="module")
def data():
    rng = np.random.default_rng(20120507)
    empty = Dataset.from_arrays(
        np.zeros((9, 2)),
        np.zeros((9, 1)),
        inputs=["a", "b"],
        outputs=["y"],
        sample_time=0.1,
    )
    records = (
        record(rng, 300, "r0"),
        record(rng, 300, "r1", missing=range(100, 110)),
        record(rng, 200, "r2"),
    )
    return dataclasses.replace(empty, records=records)


def grown(data, degree, method=None):
    pool = polynomial_pool(
        data.channels, input_lags=(1,), output_lags=(1,), degree=degree
    )
    return grow(pool, data, method or Global()).value


@pytest.fixture(scope="module")
def linear(data):
    return grown(data, 1)


@pytest.fixture(scope="module")
def found(linear, data):
    solution = diagnose(linear, data)
    assert solution.status_name == "ok"
    return solution.value["y"]


@pytest.fixture(scope="module")
def rows(linear, data):
    """Of the report of `linear`."""
    return report(linear, data).rows


@pytest.fixture(scope="module")
def dense(data):
    """Columns of the linear model and the output, by loops; record and row of each."""
    rows = []
    for n, r in enumerate(data):
        for t in range(1, len(r)):
            if r.valid[t - 1 : t + 1].all():
                rows.append((1.0, *r.u[t - 1], r.y[t - 1, 0], r.y[t, 0], n, t))
    table = np.array(rows)
    return table[:, :4], table[:, 4], table[:, 5:].astype(int)


def test_residuals_are_measurement_less_prediction_gaps_left_out(found, linear, data):
    run = predict(linear, data).value
    for r, error, predicted, scored in zip(
        data, found.errors, run.outputs, run.scored, strict=True
    ):
        np.testing.assert_array_equal(np.isfinite(error), scored[:, 0])
        want = (r.y - predicted)[scored[:, 0], 0]
        np.testing.assert_allclose(error[scored[:, 0]], want, atol=1e-12)
    # Ten missing samples and the one that looks back on the last of them.
    assert found.samples == 299 + 299 - 11 + 199


def test_limits_on_what_is_reported_change_no_residual(found, linear, data):
    """Inputs are in their range here, outputs are cut at the middle of theirs."""
    low, high = linear.low.at[2].multiply(0.3), linear.high.at[2].multiply(0.3)
    held = hold_to_range(
        dataclasses.replace(linear, low=low, high=high), outside="hold"
    )
    assert predict(held, data).stats["held"].sum() > 50
    again = diagnose(held, data).value["y"]
    assert again.estimated == found.estimated == "global"
    for a, b in zip(again.errors, found.errors, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)


def test_coefficients_and_errors_are_those_of_dense_least_squares(found, dense):
    x, y, _ = dense
    theta = np.linalg.solve(x.T @ x, x.T @ y)
    s2 = np.sum((y - x @ theta) ** 2) / (len(y) - 4)
    error = np.sqrt(s2 * np.diagonal(np.linalg.inv(x.T @ x)))
    got = {c.term: c for c in found.coefficients}
    for n, name in enumerate(("1", "a[t-1]", "b[t-1]", "y[t-1]")):
        assert got[name].value == pytest.approx(theta[n], rel=1e-6, abs=1e-9)
        assert got[name].error == pytest.approx(error[n], rel=1e-6)
        p = 2 * scipy.stats.t.sf(abs(theta[n] / error[n]), len(y) - 4)
        assert got[name].p == pytest.approx(p, rel=1e-4)
    assert found.deviation == pytest.approx(np.sqrt(s2))


def test_leverage_is_the_diagonal_of_the_hat_matrix(found, dense, data):
    x, y, place = dense
    hat = x @ np.linalg.solve(x.T @ x, x.T)
    h, e = np.diagonal(hat), y - hat @ y
    s2 = np.sum(e**2) / (len(y) - 4)
    top = np.argsort(-h)[: len(found.influences)]
    for n, got in zip(top, found.influences, strict=True):
        assert (got.record, got.time) == (
            data.records[place[n, 0]].name,
            pytest.approx(0.1 * place[n, 1]),
        )
        assert got.leverage == pytest.approx(h[n], rel=1e-6)
        r = e[n] / np.sqrt(s2 * (1 - h[n]))
        assert got.studentised == pytest.approx(r, rel=1e-6)
        assert got.distance == pytest.approx(r**2 * h[n] / (4 * (1 - h[n])), rel=1e-6)


def test_a_missing_square_is_found(found):
    assert "squared input, b" in found.failed_tests(0.05)
    # 0.3 b^2 has variance 2 * 0.09, the noise 0.04: the square explains most.
    assert found.strong(0.05)[0] in ("squared input, b", "means over b[t-1]")
    assert found.effects["squared input, b"] > 0.5
    assert found.test("squared input", "b").worst == 1
    assert found.test("input", "b").p > 0.01
    points = {o.variable: o.p for o in found.operating_points}
    assert points["b[t-1]"] < 1e-9 and points["a[t-1]"] > 1e-3


def test_what_a_residuals_past_foretells_is_a_share_of_its_variance(found):
    own = found.test("autocorrelation")
    assert found.effects["Ljung-Box"] == own.together < 0.1  # its noise is white
    every = dataclasses.replace(own, tested=np.ones(len(own.lags), bool))
    for pole in (0.3, -0.9, 0.99):
        # e[t] = pole e[t-1] + w: all but 1 - pole^2 is known before, from one lag.
        decaying = dataclasses.replace(every, value=pole**own.lags)
        assert decaying.together == pytest.approx(pole**2, abs=1e-9)
    none = dataclasses.replace(own, tested=np.zeros(len(own.lags), bool))
    assert none.together == 0.0


def test_what_many_samples_find_is_weighed_by_its_extent(data):
    """0.01 b^2 explains 0.5 % of the residual: certain at 15,000 samples, yet faint."""
    many = record(np.random.default_rng(5), 15_000, "many", square=0.01)
    many = dataclasses.replace(data, records=(many,))
    value = diagnose(grown(many, 1), many).value
    (sentence,), one = value.summary, value["y"]
    assert "squared input, b" in one.failed_tests(0.05) and one.strong(0.05) == []
    assert one.effects["squared input, b"] == pytest.approx(0.005, abs=0.003)
    assert "no test speaks against the model to an extent that matters" in sentence
    assert "15000 samples" in sentence or "14999 samples" in sentence


@pytest.mark.parametrize("inputs", [2.0**-498, 2.0**498])
@pytest.mark.parametrize("outputs", [2.0**-498, 2.0**498])
def test_units_beyond_all_reason_do_not_matter(data, found, rows, inputs, outputs):
    """About 1e-150 and 1e150: powers of two, so that nothing is rounded otherwise."""
    records = [
        dataclasses.replace(r, u=r.u * inputs, y=r.y * outputs) for r in data.records
    ]
    other = dataclasses.replace(data, records=tuple(records))
    network = grown(other, 1)
    one = diagnose(network, other).value["y"]
    for mine, given in zip(one.rows, found.rows, strict=True):
        assert mine[0] == given[0] and mine[1] == pytest.approx(given[1], rel=1e-6)
    assert one.deviation / outputs == pytest.approx(found.deviation, rel=1e-9)
    for mine, given in zip(one.coefficients, found.coefficients, strict=True):
        assert mine.term == given.term and mine.t == pytest.approx(given.t, rel=1e-6)
        assert mine.error is not None and 0 < mine.error < np.inf
    for mine, given in zip(report(network, other).rows, rows, strict=True):
        assert mine.nrmse == pytest.approx(given.nrmse, rel=1e-6)


@pytest.mark.slow
def test_a_whole_model_passes(data):
    whole = diagnose(grown(data, 2), data).value
    assert whole["y"].failed_tests(0.05) == []
    assert "no test speaks against" in whole.summary[0]


def test_whether_the_data_are_those_of_the_fit_is_found_out(found, linear, data):
    assert found.estimated == "global" and found.parameters == pytest.approx(4)
    other = diagnose(linear, data[:2]).value["y"]
    assert other.estimated == "no"
    # The mean that the tests take out is the one parameter left.
    assert other.parameters == pytest.approx(1)
    told = diagnose(linear, data, estimated="no").value["y"]
    assert np.all(told.test("input", "a").high > 0)
    assert not found.test("input", "a").tested[found.test("input", "a").lags == 1]


@pytest.mark.slow
def test_local_models_fitted_each_by_itself_are_told_from_a_joint_fit(data):
    lolimot = Lolimot(scheduling=["a[t-1]"], max_models=2, criterion="none")
    local = diagnose(grown(data, 1, lolimot), data).value["y"]
    assert local.estimated == "local" and 4 < local.parameters < 8
    assert len(local.condition) == 2 and len(local.coefficients) == 8


def test_the_order_of_records_does_not_matter(found, linear, data):
    turned = dataclasses.replace(data, records=data.records[::-1])
    again = diagnose(linear, turned).value["y"]
    for one, two in zip(found.lag_tests, again.lag_tests, strict=True):
        # Equal scores of ranks do not occur; sums round differently.
        np.testing.assert_allclose(one.value, two.value, atol=1e-9)
        np.testing.assert_allclose(one.high, two.high, atol=1e-9)
    for one, two in zip(found.scalar_tests, again.scalar_tests, strict=True):
        assert one.p == pytest.approx(two.p, abs=1e-9)


def test_fewer_rows_for_the_fit_give_nearly_the_same_bounds(
    found, linear, data, monkeypatch
):
    monkeypatch.setattr(one_step, "_rows", lambda parameters: 400)
    thinned = diagnose(linear, data).value["y"]
    assert thinned.estimated == "global"
    for one, two in zip(found.lag_tests, thinned.lag_tests, strict=True):
        np.testing.assert_allclose(one.value, two.value, atol=1e-12)
    one, two = found.test("autocorrelation"), thinned.test("autocorrelation")
    # Half of the samples: a variance is known to sqrt(2/400) = 7 %, a bound to half.
    np.testing.assert_allclose(one.high[1:], two.high[1:], rtol=0.15)
    errors = [[c.error for c in f.coefficients] for f in (found, thinned)]
    np.testing.assert_allclose(*np.array(errors, float), rtol=0.15)


def test_wrong_use_is_refused_and_short_data_are_named(linear, data):
    for field, value in (("lags", 0), ("level", 0.0), ("level", 0.6)):
        with pytest.raises(SpecError, match=field):
            diagnose(linear, data, **{field: value})  # pyright: ignore
    with pytest.raises(SpecError, match="zz"):
        diagnose(linear, data, over=["zz[t]"])
    short = dataclasses.replace(
        data, records=(record(np.random.default_rng(1), 25, "s"),)
    )
    solution = diagnose(linear, short)
    assert solution.status_name == "too_short" and not solution.value.outputs
    assert "residuals of y were not tested" in solution.detail


def test_the_report_holds_it_all(linear, data):
    err = {"names": ["a[t-1]", "y[t-1]"], "err": [0.6, 0.2]}
    parts = {"train": data[:1], "test": data[1:]}
    full = report(linear, parts, horizons=(1,), stability=False, selection=err)
    assert full.diagnostics is not None
    assert any("One-step residuals on test" in note for note in full.notes)
    values = full.to_dict()
    json.dumps(values, allow_nan=False)
    tests = values["diagnostics"]["outputs"]["y"]["lag_tests"]
    assert {t["name"] for t in tests} >= {"autocorrelation", "squared input"}
    shown = full.diagnostics.table
    line = next(row for row in shown.splitlines() if row.startswith("a[t-1]"))
    assert line.split()[1] == "60.00000" and "not white, by design" in shown
    given = full.diagnostics
    again = report(linear, parts, horizons=(1,), stability=False, diagnostics=given)
    assert again.diagnostics is given
    without = report(linear, parts, horizons=(1,), stability=False, diagnostics=False)
    assert without.diagnostics is None and without.to_dict()["diagnostics"] is None
