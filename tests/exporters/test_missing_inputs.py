"""Inputs that are NaN, infinite or absurd: held, flagged and forgotten, in exports."""

import ctypes
import dataclasses
import math
import subprocess
from pathlib import Path

import common
import hidden_problems
import jax
import numpy as np
import pytest
import test_targets
from common import some
from test_targets import NETWORKS, needs_compiler, told, written

from jaxnarx.errors import SpecError
from jaxnarx.exporters import Instance, lower, octave, runners
from jaxnarx.exporters._export import write_files
from jaxnarx.exporters.fmu import documentation
from jaxnarx.exporters.fmu.prove import fmu_runner
from jaxnarx.exporters.fmu.variables import quantities
from jaxnarx.exporters.proof import make_cases
from jaxnarx.models import (
    LARGEST_INDEX,
    LINEAR,
    NAN,
    input_memory,
    largest_sizes,
    set_nan_policy,
)
from jaxnarx.models.limits import overshoots
from jaxnarx.simulation import simulate

JUNK = np.array([np.nan, np.inf, -np.inf, 1e300])
LONG = 20_000


def held(inputs: np.ndarray, net) -> np.ndarray:
    """By a loop: the last value that was there, before it the middle of the range."""
    kept = 0.5 * (np.asarray(net.low) + np.asarray(net.high))[: inputs.shape[1]]
    sizes, found = largest_sizes(net), np.empty_like(inputs)
    for t, row in enumerate(inputs):
        for k, value in enumerate(row):
            kept[k] = value if abs(value) < sizes[k] else kept[k]
        found[t] = kept
    return found


def absent(inputs: np.ndarray, net) -> np.ndarray:
    """Samples at which an input that the network uses is missing."""
    there = np.abs(inputs) < largest_sizes(net)[:2]
    return np.logical_not(np.all(there[:, list(net.used)], axis=1))


def spiked(samples: int, seed: int = 0) -> np.ndarray:
    """Inputs of which one in a hundred is no number that a sensor gives."""
    rng = np.random.default_rng(seed)
    u = common.signals(samples, seed)[:, :2]
    gone = rng.uniform(size=u.shape) < 0.01
    gone[0] = False
    u[gone] = rng.choice(JUNK, np.count_nonzero(gone))
    return u


@needs_compiler
@pytest.mark.parametrize("nan", ["hold", "nan"])
@pytest.mark.parametrize("name", ["coupled", "Compact", "filters", "groups"])
def test_c_runs_over_spikes_as_over_held_inputs(tmp_path, name, nan):
    net = set_nan_policy(test_targets.narrowed(NETWORKS[name](), LINEAR), nan)
    program = lower(net, "m")
    write_files(tmp_path, written(net))
    run = runners.c_runner(tmp_path, program, tmp_path, single=False)
    u = spiked(LONG)
    y = np.zeros((program.history + 1, len(program.computed)))
    clean = held(u, net)
    found, expected = run(u, y), run(clean, y)
    gone = absent(u, net)[program.history :]
    assert 200 < gone.sum() < 600
    assert np.isfinite(expected[~gone]).all()
    if nan == NAN:
        np.testing.assert_array_equal(
            np.isnan(found), np.tile(gone[:, None], found.shape[1])
        )
        found, expected = found[~gone], expected[~gone]
    np.testing.assert_array_equal(found, expected)


def test_a_spike_is_forgotten_within_the_memory():
    """Of a model with filters, at one sample, whatever the number."""
    net = test_targets.narrowed(NETWORKS["filters"](), LINEAR)
    program = lower(net)
    u = common.signals(360)[:, :2]
    runs = []
    for value in (None, *JUNK, 1e5):
        instance, inputs = Instance(program), u.copy()
        if value is not None:
            inputs[20, :] = value
        instance.start("mean", inputs[0])
        runs.append([instance.step(now)["outputs"][0] for now in inputs])
    clean, *others = np.array(runs)
    behind = 20 + math.ceil(15 * input_memory(net))
    assert behind < 340
    for other in others:
        assert np.isfinite(other).all()
        np.testing.assert_allclose(other[behind:], clean[behind:], atol=1e-4)
        np.testing.assert_array_equal(other[:20], clean[:20])


@pytest.mark.parametrize("kind", ["steady", "mean", "zeros", "given"])
def test_a_start_without_inputs_is_one_from_the_middle_and_is_invalid(kind):
    net = common.named("by inputs")
    program, gone = lower(net), np.array([np.nan, np.inf])
    middle = np.array([0.5 * (p.low + p.high) for p in program.inputs])
    runs = []
    for u in (gone, middle):
        instance = Instance(program)
        instance.start(kind, u, np.array([4.0]))
        runs.append([instance.step(u) for _ in range(5)])
    for a, b in zip(*runs, strict=True):
        np.testing.assert_array_equal(a["outputs"], b["outputs"])
        assert a["invalid"] == 1 and b["invalid"] == 0


def test_measured_outputs_that_are_missing_are_held_too():
    program = lower(common.named("by own output"))
    middle = 0.5 * (program.computed[0].low + program.computed[0].high)
    runs = []
    rows = [np.nan, 2.0, np.inf, np.nan], [middle, 2.0, 2.0, 2.0]
    for y in rows:
        instance = Instance(program)
        instance.begin(np.zeros(2), np.array(y[:1]))
        for value in y:
            instance.observe(np.zeros(2), np.array([value]))
        runs.append([instance.step(np.zeros(2))["outputs"][0] for _ in range(4)])
    assert np.isfinite(runs[0]).all()
    np.testing.assert_array_equal(*runs)


class Compiled:
    """The C of a network by ctypes, for its flags."""

    def __init__(self, net, place: Path) -> None:
        program = self.program = lower(net, "m")
        write_files(place, written(net))
        words = [runners.compiler(), "-shared", "-fPIC", place / "m.c", "-lm", "-o"]
        subprocess.run([*map(str, words), str(place / "m.so")], check=True)
        self.own = ctypes.CDLL(str(place / "m.so"))

        class Out(ctypes.Structure):
            _fields_ = [
                ("reported", ctypes.c_double * len(program.reported)),
                ("fed", ctypes.c_double * len(program.computed)),
                ("limited", ctypes.c_int * len(program.computed)),
                *((flag, ctypes.c_double) for flag in program.flags),
            ]

        kept = sum(d.length for d in program.delays) + len(program.states)
        self.state, self.out = (ctypes.c_double * kept)(), Out()

    def begin(self, u, y) -> None:
        self.own.m_begin(self.state, self.numbers(u), self.numbers(y))

    def step(self, u):
        self.own.m_step(self.state, self.numbers(u), ctypes.byref(self.out))
        return self.out

    @staticmethod
    def numbers(x):
        return (ctypes.c_double * len(x))(*x)


@needs_compiler
def test_c_and_the_page_of_python_flag_as_the_form_does(tmp_path):
    net = set_nan_policy(test_targets.trusting(), invalid_after=0.3)
    code = Compiled(net, tmp_path)
    scope: dict = {}
    page = str(written(net, "python")["m.py"])
    exec(compile(page, "m.py", "exec"), scope)
    model, instance = scope["Model"](), Instance(code.program)
    u = spiked(400, 1)
    u[50:60, 0] = np.nan
    code.begin(u[0], [0.0])
    model.begin(u[0].tolist(), [0.0])
    instance.begin(u[0], np.zeros(1))
    absent = []
    for row in u:
        expected, out = instance.step(row), code.step(row)
        reported = model.step(row.tolist())
        assert out.reported[0] == pytest.approx(expected["outputs"][0], rel=1e-12)
        assert reported[0] == pytest.approx(expected["outputs"][0], rel=1e-12)
        for flag in code.program.flags:
            value = pytest.approx(expected[flag], rel=1e-9)
            assert getattr(out, flag) == value and getattr(model, flag) == value
        if expected["missing"]:
            absent.append(expected)
            assert expected["extrapolated"] == 1 and expected["index"] == LARGEST_INDEX
            assert expected["invalid"] == (expected["missing"] >= 3)
        else:
            assert expected["index"] < 1e3 and not expected["invalid"]
    assert len(absent) > 12 and max(row["missing"] for row in absent) >= 10


@needs_compiler
@pytest.mark.parametrize("flag", ["-ffast-math", "-Ofast", "-ffinite-math-only"])
def test_c_is_not_compiled_where_nan_is_no_number(tmp_path, flag):
    write_files(tmp_path, written(common.named("one model")))
    words = [runners.compiler(), flag, "-c", tmp_path / "m.c", "-o", tmp_path / "o"]
    done = subprocess.run(list(map(str, words)), capture_output=True, text=True)
    assert done.returncode and "a missing input would not be found" in done.stderr


@needs_compiler
@pytest.mark.parametrize("version", some((2, 3), 3))
def test_fmus_hold_missing_inputs(tmp_path, version):
    net = common.named("coupled")
    program = lower(net, "m")
    write_files(tmp_path, written(net, f"fmu{version}"))
    run = fmu_runner(tmp_path, program, version)
    assert run is not None
    u, y = spiked(500), np.zeros((program.history + 1, len(program.computed)))
    np.testing.assert_array_equal(run(u, y), run(held(u, net), y))


SCRIPTS = {
    "python": (lambda folder, _: runners.python_runner(folder / "m.py"), True),
    "javascript": (
        lambda folder, _: runners.javascript_runner(folder / "m.mjs"),
        runners.node(),
    ),
    "matlab": (octave.octave_runner, octave.octave()),
}


@pytest.mark.parametrize("kind", SCRIPTS)
def test_scripts_hold_missing_inputs(kind, tmp_path):
    runner, here = SCRIPTS[kind]
    if not here:
        pytest.skip(f"nothing runs {kind} here")
    net = set_nan_policy(test_targets.narrowed(NETWORKS["filters"](), LINEAR), "nan")
    program = lower(net, "m")
    write_files(tmp_path, written(net, kind))
    u, y = spiked(300), np.zeros((program.history + 1, 1))
    u[0] = np.nan, 0.1
    run = runner(tmp_path, program)
    found, expected = run(u, y), run(held(u, net), y)
    gone = absent(u, net)[program.history :]
    assert 3 < gone.sum() < 20 and np.isfinite(expected).all()
    np.testing.assert_array_equal(np.isnan(found[:, 0]), gone)
    np.testing.assert_array_equal(found[~gone], expected[~gone])


def test_every_target_says_so():
    net = set_nan_policy(common.named("coupled"), "nan", invalid_after=2.0)
    to = ["c", "python", "javascript", "matlab"]
    texts = {k: str(v) for one in to for k, v in written(net, one).items()}
    program = lower(net, "m")
    texts["page"] = documentation.page(program, quantities(program, 3), 3)
    about = {v.name: v.about for v in quantities(program, 3)}
    assert "missing for too long" in about["invalid"]
    for name in ("m.h", "m.py", "m.mjs", "m.m", "page"):
        text = " ".join(texts[name].replace("%", "").replace("*", "").split())
        assert "An input that is NaN, infinite, or 1,000,000 times as large" in text
        assert "outputs are NaN, while the states go on with held inputs" in text
        assert "invalid is 1 from 20 samples in a row (2 s) on" in text


def test_the_limit_of_an_export_forgets_a_spike():
    """Of 1e5 at one sample, as `simulate` does, sample by sample."""
    net = test_targets.narrowed(common.named("by inputs"), "flag")
    u = 0.2 * common.signals(700)[:, :2]
    u[100, 0] = 1e5
    instance = Instance(lower(net))
    instance.begin(u[0], np.zeros(1))
    limits = []
    for row in u:
        instance.step(row)
        limits.append(float(instance.states["overshoot"]))
    np.testing.assert_allclose(limits, overshoots(net, u), rtol=1e-12)
    assert limits[100] > 1e4 and limits[100 + 25 * math.ceil(input_memory(net))] < 1e-5


def test_limited_means_the_same_in_simulate_and_exports():
    """A sample of which a hidden channel is held is limited for all outputs."""
    net = hidden_problems.network()
    tight = np.asarray(net.upper).copy()
    tight[2:] = 0.7, 1.2
    net = dataclasses.replace(net, upper=jax.device_put(tight))
    data, program = hidden_problems.truth().data, lower(net)
    run = simulate(net, data).value
    seen = 0
    for n, case in enumerate(make_cases(net, program, data)):
        rows = told(program, case)
        first = program.history + net.window
        found = np.array([row["limited"] for row in rows])[net.window :]
        outputs = len(net.modelled)
        np.testing.assert_array_equal(found[:, :outputs], run.limited[n][first:])
        assert np.all(found[:, :outputs] >= found[:, outputs:].max(axis=1)[:, None])
        seen += found[:, outputs:].sum()
    assert seen > 5


def test_simulate_holds_numbers_that_no_sensor_gives():
    """A spike is no gap of the records, and is none without being asked."""
    net, rows = common.named("by inputs"), [common.signals(60)]
    spike = rows[0].copy()
    spike[0, 0], spike[30:33, 1] = 1e9, [1e20, np.nan, -1e20]
    clean = rows[0].copy()
    clean[:, :2] = held(spike[:, :2], net)
    found = simulate(net, common.from_rows([spike]), missing="hold")
    expected = simulate(net, common.from_rows([clean]))
    np.testing.assert_array_equal(found.value[0], expected.value[0])
    assert np.flatnonzero(found.value.missing[0]).tolist() == [0, 30, 31, 32]
    assert np.flatnonzero(found.value.invalid[0]).tolist() == [0]
    assert found.stats["missing"] == 4 and found.stats["invalid"] == 1
    assert simulate(net, common.from_rows([spike])).value.missing == ()
    with pytest.raises(SpecError, match="missing must be one of 'hold'"):
        simulate(net, common.from_rows([spike]), missing="drop")


@pytest.mark.parametrize("wrong", [0.0, -1.0, np.inf])
def test_a_policy_that_is_none_is_refused(wrong):
    net = common.named("one model")
    with pytest.raises(SpecError, match="invalid_after"):
        set_nan_policy(net, invalid_after=wrong)
    with pytest.raises(SpecError, match="nan must be one of hold, nan"):
        set_nan_policy(net, "guess")


def test_an_input_that_was_zero_in_training_may_be_something():
    """Rounding of zeros is no size that others could be absurd beside."""
    net = common.named("coupled")
    for low, high in ((0.0, 0.0), (-1e-17, 1e-17)):
        ends = np.asarray(net.low).copy(), np.asarray(net.high).copy()
        ends[0][0], ends[1][0] = low, high
        ranges = dict(zip(("low", "high"), jax.device_put(ends), strict=True))
        sizes = largest_sizes(dataclasses.replace(net, **ranges))
        np.testing.assert_array_equal(sizes[:2], [1e6, 5e6])
