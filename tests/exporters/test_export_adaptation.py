"""C of a network that learns: what it learns is what `adapt` learns."""

import dataclasses
from typing import Any

import numpy as np
import pytest
import test_targets
from adapt_problems import dataset, excitation, one_model, plant, two_models
from common import some

import jaxnarx as jnx
from jaxnarx.errors import DataError, SpecError
from jaxnarx.exporters import adaptation_runner, adaptive_files, export, write_files
from jaxnarx.exporters.compilers import compiler
from jaxnarx.exporters.proof import make_steps
from jaxnarx.linear._adapt import adapt
from jaxnarx.linear._export_adaptation import adaptive_program, export_adaptation
from jaxnarx.models import hold_to_range, total
from jaxnarx.settings import Recursive

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
TIME = 600


@pytest.fixture(scope="module")
def changed():
    """A network, and a record of a plant that has changed, with gaps."""
    u = excitation(TIME)
    network = one_model(dataset(u, plant(u, np.full(TIME, 0.5), noise=0.02)))
    y = plant(u, np.full(TIME, 0.6), noise=0.1)
    y[200:210] = np.nan
    u = u.copy()
    u[400:403] = np.nan
    return network, dataset(u, y, missing="mask")


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"regressors": "simulated", "dead_zone": 0.01},
        # Both undo windows: what came before is brought back.
        {"forgetting": 0.9, "start": 1e4, "growth": 1.01, "excitation": 0.0},
        {"regressors": "simulated", "forgetting": 0.8, "start": 1e4, "growth": 1.01},
    ],
)
def test_the_c_learns_what_adapt_learns(changed, settings: dict[str, Any]):
    network, data = changed
    method = Recursive(**settings)
    found = export_adaptation(network, data, method, name="m")
    assert found.difference["c, adaptation"] < 1e-12
    assert {"m.c", "m.h", "m_adapt.c", "m_adapt.h"} <= set(found.files)
    undone = adapt(network, data, method).stats["restarts"][0]
    assert (undone > 0) == ("growth" in settings)


@pytest.mark.parametrize("settings", [{"estimation": "local"}, {}, {"models": (1,)}])
def test_regions_learn_alone_together_or_some_of_them(settings):
    u = excitation(TIME)
    data = dataset(u, plant(u, np.full(TIME, 0.5), noise=0.02))
    network = two_models(data)
    with pytest.raises(SpecError, match="model 1 of y has 3 coefficients for 0 terms"):
        export_adaptation(network, data)
    network = adapt(network, data).value
    found = export_adaptation(network, data, Recursive(**settings))
    assert found.difference["c, adaptation"] < 1e-12


def test_a_million_samples_of_one_level_neither_blow_up_nor_move(changed, tmp_path):
    network, data = changed
    adaptive = adaptive_program(network, Recursive(forgetting=0.98), "m")
    write_files(tmp_path, export(network, data, name="m").files)
    write_files(tmp_path, adaptive_files(adaptive))
    run = adaptation_runner(tmp_path, adaptive)
    u = np.concatenate([excitation(TIME), np.full(1_000_000, 0.4)])
    noise = 0.002 * np.random.default_rng(0).normal(size=len(u))
    y = np.zeros(len(u))
    for t in range(1, len(u)):
        y[t] = 0.8 * y[t - 1] + 0.5 * u[t - 1] + noise[t]
    before, _ = run(u[:TIME, None], y[:TIME, None])
    after, _ = run(u[:, None], y[:, None])
    np.testing.assert_allclose(after, before, atol=0.05)


def test_the_header_states_memory_and_operations(changed):
    network, data = changed
    text = export_adaptation(network, data).texts["model_adapt.h"]
    adaptive = adaptive_program(network, Recursive(), "model")
    # Three coefficients twice, a root of nine, three sums and three errors; lines.
    lines = sum(line.length for line in adaptive.program.delays)
    kept = lines + len(adaptive.program.states)
    assert f"{21 + kept} numbers in memory, and 72 multiplications" in " ".join(
        text.replace("*", "").split()
    )


KINDS = [
    *("one model", "by inputs", "by own output", "coupled", "SigmoidTree"),
    *("LogSigmoids", "spare", "filters", "bounded"),
]


@pytest.mark.parametrize("regressors", ["measured", "simulated"])
@pytest.mark.parametrize("name", some(KINDS, "coupled"))
def test_every_kind_of_network_learns_alike_in_its_domain_and_beyond(name, regressors):
    network = test_targets.NETWORKS[name]()
    data = make_steps(network, 400)
    (record,) = data.records
    noise = np.random.default_rng(0).normal(size=record.y.shape)
    run = jnx.simulate(network, data).value.outputs[0]
    y = np.array(record.y)
    own = [data.channels.output_names.index(n) for n in network.output_names]
    y[20:, own] = np.nan_to_num(np.asarray(run))[20:] + 0.3 * noise[20:, own]
    u = np.array(record.u)
    u[200:260] *= 1.3  # beyond the domain, and the trained range
    u[300, 0] = np.nan
    y[320:325, 0] = np.nan
    stream = jnx.Dataset.from_arrays(
        u,
        y,
        inputs=data.channels.inputs,
        outputs=data.channels.outputs,
        sample_time=data.sample_time,
        missing="mask",
    )
    method = Recursive(regressors=regressors, window=50)
    beyond = hold_to_range(network)  # goes on to first order there
    known = jnx.confidence.fit_domain(network, data)
    for one in (beyond, known):
        found = export_adaptation(one, stream, method)
        assert found.difference["c, adaptation"] < 1e-9


def test_sums_and_short_records_are_refused(changed):
    network, data = changed
    with pytest.raises(DataError, match="window of 1000 samples; the longest has 600"):
        export_adaptation(network, data, Recursive(window=1000))
    with pytest.raises(SpecError, match="sum of models"):
        export_adaptation(total([network, network], [1.0, 1.0]), data)


@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_learns_what_the_c_learns(changed, tmp_path, version):
    """Compared in the proof, and driven here by another's importer: learning stops when
    it is told to, and a state that is set again brings back what it had learnt."""
    fmu_problems = pytest.importorskip("fmu_problems")
    network, data = changed
    method = Recursive(window=50)
    target = f"fmu{version}"
    found = export_adaptation(network, data, method, name="m", to=[target])
    assert found.difference[f"{target}, adaptation"] < 1e-12
    content = found.files[f"m_fmi{version}.fmu"]
    place = fmu_problems.unpacked(content, tmp_path / "m")
    model = fmu_problems.Importer(place)
    assert not any(
        getattr(model.about.coSimulation, name)
        for name in ("providesDirectionalDerivative", "providesAdjointDerivatives")
        if hasattr(model.about.coSimulation, name)
    )
    (record,) = data.records
    step, (name,) = float(network.sample_time), network.channels.input_names
    told = [f"{k}.y" for k in ("rmse", "rmse_start", "drift", "undone")]
    rows = np.column_stack([record.signals, np.ones(len(record))])
    model.enter()
    model.set([name, "measured.y", "learn"], rows[0])
    model.leave()
    for t in range(150):
        model.set([name, "measured.y", "learn"], rows[t])
        model.step(t * step, step)
    part = dataclasses.replace(data, records=(record.part(0, 150),))
    few = adapt(network, part, method).stats
    expected = [few[k][-1, 0] for k in ("rmse", "rmse_start", "drift")]
    np.testing.assert_allclose(model.get(*told)[:3], expected, rtol=1e-9)
    kept, ahead = model.own.getFMUState(), []
    for learn in (1.0, 0.0, 1.0):
        model.own.setFMUState(kept)
        for t in range(150, 200):
            model.set([name, "measured.y", "learn"], [*rows[t, :2], learn])
            model.step(t * step, step)
        ahead.append(model.get("y", *told))
    assert ahead[0] == ahead[2] != ahead[1]
    # A window without learning tells what the last one told, and the run goes on: it is
    # as near to the plant as the model is.
    np.testing.assert_allclose(ahead[1][1:4], expected, rtol=1e-9)
    assert abs(ahead[1][0] - rows[199, 1]) < 5 * expected[0]
    model.own.freeFMUState(kept)
    model.end()


def test_what_learns_is_written_as_c_and_fmu_alone(changed):
    with pytest.raises(SpecError, match="'casadi'.*c, fmu2 or fmu3"):
        export_adaptation(*changed, to=["casadi"])


@pytest.mark.parametrize("regressors", ["measured", "simulated"])
def test_an_fmu_that_does_not_learn_is_the_model_that_was_exported(
    changed, tmp_path, regressors
):
    """From its first sample on, with measured outputs connected."""
    fmu_problems = pytest.importorskip("fmu_problems")
    network, data = changed
    method = Recursive(regressors=regressors)
    found = export_adaptation(network, data, method, name="m", to=["fmu3"])
    place = fmu_problems.unpacked(found.files["m_fmi3.fmu"], tmp_path / "m")
    model = fmu_problems.Importer(place)
    (record,) = data.records
    step, (name,) = float(network.sample_time), network.channels.input_names
    names = [name, "measured.y", "learn"]
    rows = np.column_stack([record.signals, np.zeros(len(record))])
    model.enter()
    model.set(names, rows[0])
    model.leave()
    reported = []
    for t in range(150):
        model.set(names, rows[t])
        model.step(t * step, step)
        reported += model.get("y")
    part = dataclasses.replace(data, records=(record.part(0, 150),))
    ways = {"measured": jnx.predict, "simulated": jnx.simulate}
    (expected,) = ways[regressors](network, part).value.outputs
    np.testing.assert_allclose(reported[10:], expected[10:, 0], rtol=1e-9)
    assert model.get("rmse.y") == [0.0]
    model.end()


def test_an_fmu_whose_outputs_are_nan_where_the_model_says_so_is_proven(changed):
    network, data = changed
    silent = dataclasses.replace(network, nan="nan")
    found = export_adaptation(silent, data, name="m", to=["fmu2"])
    assert found.difference["fmu2, adaptation"] < 1e-12
