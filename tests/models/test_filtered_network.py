"""Models of filtered inputs: identified, run, shown, stored; alone and beside lags."""

import dataclasses
import json

import common
import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal
from common import A, B, W, Y
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from jaxnarx.design import network_sensitivity
from jaxnarx.errors import ModelFileError, SpecError
from jaxnarx.evaluation import report
from jaxnarx.evaluation.regions import describe_partition
from jaxnarx.models import load, save
from jaxnarx.partition import grow
from jaxnarx.refinement import refine
from jaxnarx.regressors import LowPass, Orthonormal, Variables, polynomial_pool
from jaxnarx.selection import select
from jaxnarx.settings import ForwardOLS, Global, Lolimot, SimulationError
from jaxnarx.simulation import predict, simulate

BANK = (LowPass(1.0), LowPass(0.4))
TRUE = {
    "1": 0.5,
    "lp(a, 1 s)[t]": 2.0,
    "lp(a, 1 s)[t]*lp(b, 0.4 s)[t]": -1.5,
    "lp(b, 1 s)[t]^2": 0.7,
}


def low_pass(u: np.ndarray, time_constant: float) -> np.ndarray:
    a = np.exp(-0.1 / time_constant)
    return scipy.signal.lfilter([1 - a], [1, -a], u, zi=[a * u[0]])[0]


def answer(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The output of the true system."""
    slow, quick = low_pass(a, 1.0), low_pass(b, 0.4)
    return 0.5 + 2 * slow - 1.5 * slow * quick + 0.7 * low_pass(b, 1.0) ** 2


def records(lengths, seed):
    rows = [common.signals(n, seed) for n in lengths]
    for r in rows:
        r[:, Y] = answer(r[:, A], r[:, B])
    return rows


@pytest.fixture(scope="module")
def train():
    """Two records; of the second some inputs are missing, held at their last value."""
    rows = records((200, 160), 3)
    rows[1][50:56, A] = rows[1][49, A]
    rows[1][:, Y] = answer(rows[1][:, A], rows[1][:, B])
    rows[1][50:56, A] = np.nan
    return common.from_rows(rows)


@pytest.fixture(scope="module")
def new():
    """Records of the same lengths with other signals."""
    return common.from_rows(records((200, 160), 4))


@pytest.fixture(scope="module")
def chosen(train):
    pool = polynomial_pool(
        train.channels,
        outputs=["y"],
        input_lags=(),
        output_lags=(),
        degree=2,
        filters=BANK,
    )
    return select(pool, train, ForwardOLS(max_terms=4))


@pytest.fixture(scope="module")
def network(chosen, train):
    return grow(chosen.value, train, Global()).value


# without feedback -----------------------------------------------------------------


def test_the_true_system_is_found_with_its_coefficients(network):
    (entry,) = network.equations()
    found = dict(entry["terms"])
    assert found.keys() == TRUE.keys()
    # no noise: what is left is rounding times the condition of four columns
    for name, value in TRUE.items():
        assert found[name] == pytest.approx(value, rel=1e-9)


def test_a_free_run_is_the_system_and_so_is_every_prediction(network, new):
    assert network.history == 0
    free, one = simulate(network, new), predict(network, new, 7)
    assert free.status_name == "ok"
    for n, record in enumerate(new):
        np.testing.assert_allclose(free.value[n][:, 0], record.y[:, 0], atol=1e-8)
        # without feedback it does not matter how many steps are predicted
        later = slice(6, None)
        np.testing.assert_allclose(one.value[n][later], free.value[n][later], 1e-12)


def test_only_samples_with_a_missing_input_are_not_scored(network, train):
    value = simulate(network, train).value
    wanted = np.ones(160, bool)
    wanted[50:56] = False
    np.testing.assert_array_equal(value.scored[1][:, 0], wanted)
    error = value[1][:, 0] - train.records[1].y[:, 0]
    np.testing.assert_allclose(error, 0, atol=1e-8)


def test_equations_show_the_filters(network):
    (text,) = network.equations()
    (latex,) = network.equations(style="latex")
    assert "2 lp(a, 1 s)[t]" in text["text"]
    assert r"\mathrm{lp(a,\ 1\ s)}(t)" in latex["latex"]


def test_refinement_brings_disturbed_coefficients_back(network, train, new):
    theta = network.models[0].local.coefficient
    local = dataclasses.replace(network.models[0].local, coefficient=1.1 * theta)
    model = dataclasses.replace(network.models[0], local=local)
    start = dataclasses.replace(network, models=(model,))
    method = SimulationError(horizons=(), max_steps=8, window_steps=0, ridge=0.0)
    fit = refine(start, train, method, validation=new).value
    # linear in the coefficients: Levenberg-Marquardt's damping is what is left
    np.testing.assert_allclose(fit.models[0].local.coefficient, theta, rtol=1e-4)


def test_a_report_can_be_made(network, train, new):
    found = report(network, {"train": train, "test": new})
    assert found.pooled_row("y", part="test").fit == pytest.approx(100, abs=1e-4)


# with feedback, local models and scheduling ---------------------------------------


@pytest.fixture(scope="module")
def local(train):
    """Local models beside output feedback, scheduled on a filtered input and w."""
    pool = polynomial_pool(
        train.channels,
        outputs=["y"],
        input_lags=(1,),
        output_lags=(1,),
        degree=1,
        filters={"a": (Orthonormal((-1.0, -0.5 + 2j), 3),)},
    )
    method = Lolimot(scheduling=("lp(b, 1 s)[t]", "lp(w, 0.5 s)[t-1]"), max_models=3)
    return grow(pool, train, method).value


def test_a_partition_over_filtered_variables(local, train):
    names = ["lp(b, 1 s)[t]", "lp(w, 0.5 s)[t-1]"]
    assert all(list(e["region"]) == names for e in local.equations())
    found = describe_partition(local, data=train)["y"]
    rows = np.concatenate(
        [
            np.stack([low_pass(r.u[:, 1], 1.0)[1:], low_pass(r.y[:, 1], 0.5)[:-1]], 1)
            for r in train
        ]
    )
    np.testing.assert_allclose(found["cloud"], rows, rtol=1e-9)
    # rows with a missing input take no part in growing, but stay in the cloud
    low, high = zip(*found["ranges"], strict=True)
    assert np.all(rows.min(axis=0) <= np.array(low) + 1e-12)
    assert np.all(rows.max(axis=0) >= np.array(high) - 1e-12)


def test_a_run_is_the_network_step_by_step(local, new):
    """By hand: measured columns, only the lag of y taken from the run."""
    value = simulate(local, new).value
    record = new.records[0]
    signals = jnp.asarray(common.rows_of(new, 0))
    v, (x,) = eqx.filter_jit(local.columns)(signals)
    gain = float(local.gain[Y])
    at = 1 + local.variable_names.index("y[t-1]")
    past = record.y[0, 0] / gain
    model = local.models[0]
    z = (x - model.offset[:, None]) / model.span[:, None]
    step = eqx.filter_jit(lambda t, past: model(v[:, t].at[at].set(past), z[:, t]))
    for t in range(1, 40):
        past = float(step(jnp.asarray(t), jnp.asarray(past)))
        past = float(np.clip(past, local.lower[0], local.upper[0]))
        assert value[0][t, 0] == pytest.approx(past * gain, rel=1e-9)


def test_modelled_outputs_cannot_be_filtered(network, train, chosen):
    with pytest.raises(SpecError, match="y is computed by the model"):
        grow(chosen.value, train, Lolimot(scheduling=("lp(y, 1 s)[t-1]",)))
    table = Variables.of([(Y, 1, LowPass(1.0)), (W, 1, None)])
    with pytest.raises(SpecError, match="y is computed by the model"):
        dataclasses.replace(network, variables=table)


def test_a_constant_filtered_scheduling_variable_is_named(train, chosen):
    from jaxnarx.errors import DataError

    flat = [np.where(np.arange(4)[None] == B, 1.5, common.rows_of(train, 0))]
    with pytest.raises(DataError, match=r"variable lp\(b, 1 s\)\[t\] is constant"):
        grow(
            chosen.value,
            common.from_rows(flat),
            Lolimot(scheduling=("lp(b, 1 s)[t]",), max_models=2),
        )


def test_sensitivity_of_an_experiment_sees_the_filters(network, new):
    # linear in its parameters: the regressors, which the oracle has in closed form
    inputs = jnp.asarray(new.records[0].u)
    sensitivity = network_sensitivity(network, noise={"y": 1.0}, lead=0)
    slope = eqx.filter_jit(sensitivity)(inputs)
    a, b = np.asarray(inputs).T
    columns = {
        "1": np.ones(200),
        "lp(a, 1 s)[t]": low_pass(a, 1.0),
        "lp(a, 1 s)[t]*lp(b, 0.4 s)[t]": low_pass(a, 1.0) * low_pass(b, 0.4),
        "lp(b, 1 s)[t]^2": low_pass(b, 1.0) ** 2,
    }
    for k, (name, _) in enumerate(network.equations()[0]["terms"]):
        found = np.asarray(slope[:, 0, k])
        # parameters belong to scaled signals: the same column but for its size
        size = found @ columns[name] / (columns[name] @ columns[name])
        np.testing.assert_allclose(found, size * columns[name], atol=1e-10)


# files ----------------------------------------------------------------------------


def header_of(path):
    with safe_open(path, framework="numpy") as file:
        return json.loads(file.metadata()["jaxnarx"])


def test_a_model_with_filters_comes_back(local, new, tmp_path):
    save(local, tmp_path / "m")
    again = load(tmp_path / "m")
    assert again.variables == local.variables
    assert again.models[0].scheduling == local.models[0].scheduling
    for left, right in zip(
        simulate(again, new).value.outputs,
        simulate(local, new).value.outputs,
        strict=True,
    ):
        np.testing.assert_array_equal(left, right)


def test_only_models_with_filters_have_the_newer_format(local, tmp_path):
    save(local, tmp_path / "m")
    assert header_of(tmp_path / "m")["format"] == 2
    save(common.named("coupled"), tmp_path / "m")
    header = header_of(tmp_path / "m")
    assert header["format"] == 1 and "filters" not in json.dumps(header)


LAG = {"kind": "low_pass", "time_constant": 1.0}
DAMAGE = {
    "too few": [LAG],
    "a step up": [None, LAG | {"time_constant": -1.0}, None],
    "no number": [None, LAG | {"time_constant": "1"}, None],
    "huge": [None, {"kind": "laguerre", "time_constant": 1.0, "order": 10**6}, None],
    "too slow": [None, LAG | {"time_constant": 1e12}, None],
    "of another kind": [None, LAG | {"kind": "exec"}, None],
    "code": ["__import__('os')", None, None],
    "of the output": [None, None, None, LAG],
    "a number": 3,
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_tampered_filters_are_refused(local, tmp_path, kind):
    import jaxtyping

    path = tmp_path / "m"
    save(local, path)
    header, tensors = header_of(path), load_file(path)
    del header["sha256"]  # which would refuse every change
    header["variables_filters"] = DAMAGE[kind]
    save_file(tensors, path, metadata={"jaxnarx": json.dumps(header)})
    # as installed: without the tests' own type checks
    jaxtyping.config.update("jaxtyping_disable", True)
    try:
        with pytest.raises(ModelFileError, match="damaged or not complete"):
            load(path)
    finally:
        jaxtyping.config.update("jaxtyping_disable", False)
