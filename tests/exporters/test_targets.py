"""Exports of every kind of network beside its free run, and what they refuse."""

import ctypes
import dataclasses
import importlib.util
import itertools
import subprocess
from functools import cache
from pathlib import Path

import common
import equinox as eqx
import hidden_problems
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from common import B, some

import jaxnarx as jnx
from jaxnarx.data.batch import stack_records
from jaxnarx.errors import SpecError
from jaxnarx.exporters import ExportError, Instance, export, lower, proof, runners
from jaxnarx.exporters._export import TARGETS, make_golden
from jaxnarx.exporters.compilers import WARNING_FLAGS
from jaxnarx.exporters.maps import choose_axes
from jaxnarx.exporters.proof import Case, make_cases
from jaxnarx.exporters.runners import c_runner
from jaxnarx.models import (
    NAN,
    OUTSIDE,
    Boxes,
    Compact,
    Gaussians,
    LogSigmoids,
    SigmoidTree,
    advance,
    hold_to_range,
    set_nan_policy,
)
from jaxnarx.regressors import Kautz, Laguerre, LowPass, Variables
from jaxnarx.simulation import make_drive, simulate

HERE = 1e-12
"""Largest difference in double, in shares of an output's largest value: rounding, that
the feedback of these networks does not let grow."""
ONCE = 1e-5
"""The same in single precision."""

needs_compiler = pytest.mark.skipif(
    runners.compiler() is None, reason="there is no C compiler here"
)


def validities(models: int, dims: int) -> dict:
    """One of every class, for so many local models."""
    rng = np.random.default_rng(5)
    middle = np.sort(rng.uniform(0.1, 0.9, (models, dims)), axis=0)
    low, high = middle - 0.2, middle + 0.2
    margin = np.full((models, dims), np.log(0.15))
    gates = models - 1
    path = np.tril(-np.ones((models, gates)), -1) + np.eye(models, gates)
    direction, border = rng.normal(size=(gates, dims)), rng.uniform(0, 1, gates)
    found = {
        "Boxes": Boxes(*jax.device_put((low, high))),
        "Compact": Compact(*jax.device_put((low, high, margin))),
        "SigmoidTree": SigmoidTree(
            *jax.device_put((direction, border, np.full(gates, 2.0), path.astype(int)))
        ),
    }
    if dims == 1:
        ends = np.linspace(0.3, 0.7, gates), np.array(2.5)
        found["LogSigmoids"] = LogSigmoids(*jax.device_put(ends))
    return found


def with_validity(net, name: str):
    """A network with the class in place of its Gaussians, wherever there are several
    local models."""
    models = []
    for model in net.models:
        count, dims = len(np.asarray(model.active)), len(model.scheduling)
        known = validities(count, dims) if count > 1 else {}
        kind = known.get(name, model.validity)
        models.append(dataclasses.replace(model, validity=kind))
    return dataclasses.replace(net, models=tuple(models))


def filtered(net):
    """Inputs through a lag, and through functions of cascades that begin alike."""
    bank = [LowPass(0.5), Laguerre(0.3, 3), None, None]
    variables = Variables(net.variables.rows, tuple(bank[: len(net.variables)]))
    first = net.models[0]
    over = Variables(((B, 1),), (Kautz(4.0, 0.4, 2),))
    offset, span = jax.device_put((np.array([-1.0]), np.array([2.0])))
    count = len(np.asarray(first.active))
    ends = np.linspace(0.3, 0.7, count - 1), np.array(2.0)
    first = dataclasses.replace(
        first,
        scheduling=over,
        offset=offset,
        span=span,
        validity=LogSigmoids(*jax.device_put(ends)),
    )
    return dataclasses.replace(net, variables=variables, models=(first,))


def grouped(net):
    """Two local models that are fed back their own outputs, and a group of two."""
    (model,) = net.models
    own = jax.device_put(np.array([[True, False, False], [False, True, True]]))
    model = dataclasses.replace(model, own=own)
    return dataclasses.replace(net, models=(model,))


NETWORKS = {
    **{kind: lambda kind=kind: common.named(kind) for kind in common.KINDS},
    **{
        name: lambda name=name: with_validity(common.named("coupled"), name)
        for name in ("Boxes", "Compact", "SigmoidTree", "LogSigmoids")
    },
    "spare": lambda: common.named("coupled", spare_models=2, spare_slots=1),
    "filters": lambda: filtered(common.named("by inputs")),
    "groups": lambda: grouped(common.named("by inputs")),
    "hidden": lambda: hidden_problems.network(),
    "bounded": lambda: common.named("coupled", bound=0.3),
}
RANGE = np.array([-1.5, -0.3, -6.0, -2.0]), np.array([1.2, 0.4, 5.0, 2.5])
"""Ranges that some of the inputs and outputs leave."""


def narrowed(net, outside: str):
    low, high = jax.device_put(RANGE)
    net = dataclasses.replace(net, low=low, high=high)
    return hold_to_range(net, 0.02, outside=outside)


def records(net) -> jnx.Dataset:
    if net.hidden:
        return hidden_problems.truth(lengths=(60,)).data
    return common.dataset((60,), seed=3)


def written(net, to: str = "c") -> dict[str, str | bytes]:
    """Files of the network, called m, of which nothing is proven, without a run of the
    network: a number type of C is not left out."""
    program, u = lower(net, "m"), common.signals(40)[:, :2]
    y = np.zeros((program.history + 1, len(program.computed)))
    golden = make_golden(program, Case(u, y, u, 0)) | {
        "axes": choose_axes(net, program)
    }
    return TARGETS[to].write(program, golden)


def beside(net, data) -> float:
    """The reference beside the model."""
    program = lower(net)

    def run(inputs, measured):
        instance = Instance(program)
        instance.begin(inputs[0], measured[0])
        for u, y in zip(inputs[: program.history], measured, strict=False):
            instance.observe(u, y)
        rows = [instance.step(u)["outputs"] for u in inputs[program.history :]]
        return np.array(rows)

    cases = make_cases(net, program, data)
    assert len(cases) == len(data)
    return max(case.difference(run) for case in cases)


def gapped(net, data, seed: int = 0):
    """The records with a twelfth of the inputs missing, the first ones among them."""
    rng, records = np.random.default_rng(seed), []
    for record in data:
        valid = record.valid.copy()
        gone = rng.uniform(size=record.u.shape) < 1 / 12
        gone[0] = True
        gone[20:32] = True
        valid[:, : record.u.shape[1]] &= ~gone
        records.append(dataclasses.replace(record, valid=valid))
    return dataclasses.replace(data, records=tuple(records))


def told(program, case):
    """All that the form says of a case."""
    instance = Instance(program)
    instance.begin(case.inputs[0], case.measured[0])
    for u, y in zip(case.inputs[: program.history], case.measured, strict=False):
        instance.observe(u, y)
    return [instance.step(u) for u in case.inputs[program.history :]]


def compare(net, data):
    """Outputs and flags of the form beside those of `simulate`."""
    data, program = gapped(net, data), lower(net)
    cases = make_cases(net, program, data, missing="hold")
    run = simulate(net, data, missing="hold").value
    assert len(cases) == len(data)
    for n, case in enumerate(cases):
        rows = told(program, case)
        found = np.array([row["outputs"] for row in rows])
        assert case.difference(lambda u, y, found=found: found) < HERE
        after = slice(program.history, None)
        for name, mask in (
            ("extrapolated", run.extrapolated[n]),
            ("missing", run.missing[n]),
            ("invalid", run.invalid[n]),
        ):
            flags = np.array([row[name] for row in rows]) > 0
            np.testing.assert_array_equal(flags, mask[after], err_msg=name)
        assert 5 < run.missing[n][after].sum() and run.extrapolated[n].any()
    return run


@pytest.mark.parametrize("name", NETWORKS)
def test_the_form_runs_as_the_network_does(name):
    net = NETWORKS[name]()
    assert beside(net, records(net)) < HERE


@pytest.mark.parametrize(
    ("name", "outside"),
    some(
        itertools.product(("by inputs", "filters"), OUTSIDE),
        *(("by inputs", outside) for outside in OUTSIDE),
        ("filters", "hold"),
    ),
)
def test_the_form_leaves_its_range_as_the_network_does(name, outside):
    net = narrowed(NETWORKS[name](), outside)
    assert beside(net, records(net)) < HERE


@pytest.mark.parametrize("name", NETWORKS)
def test_held_inputs_run_as_simulate_says(name):
    net = NETWORKS[name]()
    run = compare(net, records(net))
    assert all(np.isfinite(y).all() for y in run.outputs)


@pytest.mark.parametrize("nan", ["hold", "nan"])
@pytest.mark.parametrize("outside", OUTSIDE)
def test_so_do_all_policies(outside, nan):
    net = narrowed(NETWORKS["filters"](), outside)
    net = set_nan_policy(net, nan, invalid_after=0.35)
    run = compare(net, records(net))
    assert all(m.any() and not m.all() for m in run.invalid)
    for n, y in enumerate(run.outputs):
        silent = run.missing[n] if nan == NAN else np.zeros(len(y), bool)
        silent = run.extrapolated[n] if outside == NAN else silent
        after = slice(net.history, None)
        np.testing.assert_array_equal(np.isnan(y[after, 0]), silent[after])
        assert not run.scored[n][silent].any()


def test_slopes_are_those_of_the_network():
    net = common.named("coupled, by own output")
    program = lower(net)
    data = common.dataset((30,), seed=4)
    (case,) = make_cases(net, program, data)
    instance = Instance(program)
    instance.begin(case.inputs[0], case.measured[0])
    for u, y in zip(case.inputs[: program.history], case.measured, strict=False):
        instance.observe(u, y)
    needed = program.needed_operations([n for row in program.jacobian for n in row])
    values = instance._values(needed, case.inputs[program.history], np.zeros(0))
    found = np.array([[values[n] for n in row] for row in program.jacobian])
    drive = jax.tree.map(np.asarray, make_drive(net, stack_records(data)))
    v = drive.v[0][:, program.history]
    x = tuple(x_o[0][:, program.history] for x_o in drive.x)
    depth = max(k for _, k in program.past)
    past = np.stack(
        [drive.measured[0][program.history - k - 1] for k in range(depth)], axis=1
    )
    now, signals = jax.device_put((v, x))
    slopes = jax.jit(jax.jacobian(lambda h: advance(net, now, signals, h)))
    slope = np.asarray(slopes(past))  # outputs, outputs, depth
    gain = np.asarray(net.gain)[list(net.signals)]
    names = [line for line, _ in program.past]
    order = list(dict.fromkeys(names))
    for column, (line, k) in enumerate(program.past, start=len(program.inputs)):
        expected = slope[:, order.index(line), k - 1] * gain
        np.testing.assert_allclose(found[:, column], expected, rtol=1e-9, atol=1e-12)


@needs_compiler
@pytest.mark.parametrize("name", ["coupled", "Compact", "filters", "groups", "hidden"])
def test_every_target_is_the_network(name):
    net = NETWORKS[name]()
    found = export(net, records(net), to=["c", "python", "javascript"], name=name)
    others = [Path(cc).name for cc in runners.compilers()[1:]]
    single = {"c, single", *(f"c, single, {cc}" for cc in others)}
    tried = {"c, double", "python", *(f"c, double, {cc}" for cc in others)} | (
        {"javascript"} if runners.node() else set()
    )
    assert set(found.difference) == tried | single
    assert max(found.difference[k] for k in tried) < HERE
    assert all(HERE < found.difference[k] < ONCE for k in single)


def test_slopes_by_inputs_are_central_differences():
    net = narrowed(common.named("by inputs"), "linear")
    program = lower(net)
    (case,) = make_cases(net, program, common.dataset((30,), seed=4))
    instance = Instance(program)
    instance.begin(case.inputs[0], case.measured[0])
    u = np.array([0.3, 0.1])
    needed = program.needed_operations([*program.fed, *program.jacobian[0]])

    def at(x):
        return instance._values(needed, x, np.zeros(0))

    values = at(u)
    for i in range(len(program.inputs)):
        step = 1e-5 * np.eye(len(u))[i]
        up, down = (at(x)[program.fed[0]] for x in (u + step, u - step))
        # the differences' own error is of the order of the step squared
        slope = (up - down) / 2e-5
        np.testing.assert_allclose(values[program.jacobian[0][i]], slope, rtol=1e-6)


@needs_compiler
@pytest.mark.parametrize("outside", some(("linear", "nan"), "nan"))
def test_c_has_no_heap_and_says_what_its_inputs_are(tmp_path, outside):
    net = narrowed(common.named("coupled"), outside)
    found = export(net, records(net), name="NOx model")
    assert set(found.files) == {
        f"NOx_model{end}" for end in (".h", ".c", "_selftest.c")
    }
    for name, text in found.texts.items():
        (tmp_path / name).write_text(text)
    assert "malloc" not in "".join(found.texts.values())
    assert "u[0] a [V], -1.5 to 1.2" in found.texts["NOx_model.h"]
    compiler = runners.compiler()
    assert compiler is not None
    checked = [
        "-fsanitize=address,undefined",
        "-fno-sanitize-recover",
        *WARNING_FLAGS,
    ]
    both = [tmp_path / "NOx_model.c", tmp_path / "NOx_model_selftest.c"]
    for extra in ([], ["-DNOX_MODEL_SINGLE"]):
        program = tmp_path / "selftest"
        command = [compiler, *checked, *extra, *both, "-lm", "-o", program]
        subprocess.run(list(map(str, command)), check=True)
        said = subprocess.run([program], check=True, capture_output=True, text=True)
        assert "largest difference" in said.stdout


@needs_compiler
def test_a_file_that_does_something_else_is_found_out(tmp_path):
    net = common.named("by inputs")
    program, data = lower(net, "m"), common.dataset((40,), seed=3)
    for name, text in export(net, data, name="m").texts.items():
        (tmp_path / name).write_text(text.replace("exp(x)", "(1.0 + (x))"))
    run = c_runner(tmp_path, program, tmp_path, single=False)
    (case,) = make_cases(net, program, data)
    assert case.difference(run) > 1e-3
    compiler, program_file = runners.compiler(), tmp_path / "selftest"
    both = [tmp_path / "m.c", tmp_path / "m_selftest.c"]
    command = [compiler, *both, "-lm", "-o", program_file]
    subprocess.run(list(map(str, command)), check=True)
    assert subprocess.run([program_file], capture_output=True).returncode == 1
    with pytest.raises(ExportError, match="differs from the model"):
        proof.worst([case], lambda u, y: 1.001 * run(u, y), 1e-6, "C")


def test_a_steady_state_is_where_the_model_rests():
    net = common.named("by inputs")
    instance = Instance(lower(net))
    u = np.array([0.7, 0.2, 0.0][: len(instance.program.inputs)])
    assert 10 < instance.settle(u) < 1000
    first = instance.step(u)["outputs"]
    rows = [instance.step(u)["outputs"] for _ in range(50)]
    np.testing.assert_allclose(rows[-1], first, rtol=1e-7)


def test_what_cannot_be_exported_is_told():
    class Sharp(Gaussians.__mro__[1]):  # type: ignore[name-defined, misc]
        def __call__(self, z, active):
            return jax.nn.one_hot(0, len(active), axis=0)

        def limits(self, width_band):
            return self, self

        def check(self, models, dims):
            pass

        def regions(self, names, offset, span):
            return []

    net = common.named("by inputs")
    other = eqx.tree_at(lambda n: n.models[0].validity, net, Sharp())
    with pytest.raises(SpecError, match="validity function Sharp cannot be exported"):
        lower(other)
    with pytest.raises(SpecError, match="there is no target 'fortran'"):
        export(net, to=["fortran"])


@cache
def trusting():
    """A network that knows its domain and its errors."""
    net, data = common.named("by inputs"), common.dataset((160, 140), seed=3)
    return jnx.confidence.fit_error_model(
        jnx.confidence.fit_domain(net, data, points=6), data
    )


@pytest.fixture(scope="module")
def trusted():
    """The network, and records beyond what it knows."""
    net = trusting()
    assert net.errors is not None
    far = common.dataset((60,), seed=9)
    (record,) = far.records
    wide = dataclasses.replace(record, u=2.5 * record.u)
    return net, dataclasses.replace(far, records=(wide,))


def test_index_and_intervals_are_those_of_the_network(trusted):
    net, data = trusted
    program = lower(net, level=0.9)
    (case,) = make_cases(net, program, data)
    instance = Instance(program)
    instance.begin(case.inputs[0], case.measured[0])
    for u, y in zip(case.inputs[: program.history], case.measured, strict=False):
        instance.observe(u, y)
    rows = [instance.step(u) for u in case.inputs[program.history :]]
    index = jnx.domain(net, data).value.index[0][program.history :]
    assert index.min() < 1 < index.max()
    np.testing.assert_allclose([r["index"] for r in rows], index, rtol=1e-9)
    found = jnx.intervals(net, data, level=0.9).value
    half = 0.5 * (found.upper[0] - found.lower[0])[program.history :, 0]
    # s(t) spans orders of magnitude; rounding of the run goes through its logarithm
    np.testing.assert_allclose([r["half_y"] for r in rows], half, rtol=1e-8)


@needs_compiler
def test_c_and_python_tell_index_and_intervals_as_the_form_does(trusted, tmp_path):
    net, data = trusted
    program = lower(net, "m", level=0.9)
    found = export(net, data, to=["c", "python"], name="m", level=0.9)
    for name, text in found.texts.items():
        (tmp_path / name).write_text(text)
    compiler, library = runners.compiler(), tmp_path / "m.so"
    command = [compiler, "-shared", "-fPIC", "-O1", tmp_path / "m.c", "-lm", "-o"]
    subprocess.run([*map(str, command), str(library)], check=True)

    class Out(ctypes.Structure):
        _fields_ = [
            ("reported", ctypes.c_double * len(program.reported)),
            ("fed", ctypes.c_double * len(program.computed)),
            ("limited", ctypes.c_int * len(program.computed)),
            *((flag, ctypes.c_double) for flag in program.flags),
        ]

    kept = sum(d.length for d in program.delays) + len(program.states)
    state, out = (ctypes.c_double * kept)(), Out()
    called = ctypes.CDLL(str(library))
    spec = importlib.util.spec_from_file_location("m", tmp_path / "m.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    model, instance = module.Model(), Instance(program)
    (case,) = make_cases(net, program, data)

    def numbers(x):
        return (ctypes.c_double * len(x))(*x)

    instance.begin(case.inputs[0], case.measured[0])
    model.begin(case.inputs[0].tolist(), case.measured[0].tolist())
    called.m_begin(state, numbers(case.inputs[0]), numbers(case.measured[0]))
    seen = []
    for u in case.inputs:
        told = instance.step(u)
        model.step(u.tolist())
        called.m_step(state, numbers(u), ctypes.byref(out))
        for flag in program.flags:
            expected = pytest.approx(told[flag], rel=1e-9)
            assert getattr(out, flag) == expected and getattr(model, flag) == expected
        seen.append(told["index"])
    assert min(seen) < 1 < max(seen)


def test_intervals_of_a_network_without_errors_are_refused(trusted):
    net = dataclasses.replace(trusted[0], errors=None)
    with pytest.raises(SpecError, match="has no error model"):
        export(net, to=["python"], level=0.9)
    assert set(lower(net, index=False).flags) == {
        "extrapolated",
        "missing",
        "invalid",
    }


def drawn(net, seed: int):
    """The same structure with other numbers: coefficients, regions, scales and ranges
    each off by some 20 %, so that nothing but the structure is as it was made."""
    rng = np.random.default_rng(seed)

    def moved(x):
        if not jnp.issubdtype(x.dtype, jnp.floating):
            return x
        return x * jnp.asarray(np.exp(rng.uniform(-0.2, 0.2, x.shape)))

    other = jax.tree.map(moved, net)
    return dataclasses.replace(other, sample_time=net.sample_time)


@pytest.mark.slow
@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize("seed", range(5))
def test_networks_of_random_numbers_run_as_their_form_does(name, seed):
    net = drawn(NETWORKS[name](), seed)
    assert beside(net, records(net)) < HERE
