"""A controller in C beside the controller, over networks of every kind."""

import ctypes
import dataclasses
import shutil
import subprocess

import jax.numpy as jnp
import numpy as np
import pytest
from calibration_problems import network_and_cycle
from common import some
from control_problems import linear
from kinds import EVERY, problem

import jaxnarx as jnx
from jaxnarx.control import Command, OutputLimit, _export_controller, mpc
from jaxnarx.control._export_controller import (
    AGREEMENT,
    control_program,
    export_controller,
)
from jaxnarx.control.planning import plan_of
from jaxnarx.exporters import ExportError, control_files, write_files
from jaxnarx.exporters.compilers import compiler, load_library
from jaxnarx.exporters.state_program import name_states, without_gaps
from jaxnarx.models import hold_to_range

with_compiler = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
FREE = {"force": Command(low=-1.0, high=1.0, rate=1.0, effort=0.03)}


def controller_of(name: str, **more):
    """A controller of a network that a run distinguishes, with a limit."""
    network = problem(name)[0]
    command, *_ = jnx.state_space(network).inputs
    last = network.output_names[-1]
    most = float(network.high[network.signals[len(network.modelled) - 1]])
    limits = {last: OutputLimit(at_most=most)}
    free = {command: Command()}
    return mpc(network, free, [network.output_names[0]], limits, horizon=8, **more)


class Library:
    """The C of a controller, its memory within reach."""

    def __init__(self, controller, folder) -> None:
        control = control_program(controller, "m")
        write_files(folder, control_files(control))
        self.library = load_library([folder / "m_control.c"], folder / "m.so")
        self.memory = np.zeros(100_000)
        self.decision = np.zeros(100)
        self.commands = len(controller.commands)
        names = list(name_states(without_gaps(control.program)))
        self.states = len(names)
        self.fed_back = [k for k, name in enumerate(names) if name.startswith("y_")]

    def _call(self, what: str, *rows) -> None:
        kept = [np.append(np.ravel(r).astype(float), 0.0) for r in rows]
        arrays = [self.memory, *kept]
        if what == "step":
            arrays.append(self.decision)
        getattr(self.library, f"m_control_{what}")(
            *(a.ctypes.data_as(ctypes.c_void_p) for a in arrays)
        )

    def begin(self, u, measured) -> None:
        self._call("begin", u, measured)

    def step(self, measured, reference, given) -> tuple[np.ndarray, np.ndarray]:
        """Commands, and whether it was solved and begun anew."""
        self._call("step", measured, reference, given)
        flags = self.decision.view(np.int32)
        # Outputs of eight samples, one limit or none, disturbances of two outputs.
        at = 2 * (self.commands + 8 * 2 + 1 + 2)
        return self.decision[: self.commands].copy(), flags[at : at + 2].copy()


@with_compiler
@pytest.mark.parametrize("name", some(EVERY, "coupled", "root", "own feedback"))
def test_it_decides_as_the_controller_does(name):
    found = export_controller(controller_of(name).value, name="m")
    assert found.difference["c, controller"] <= AGREEMENT
    assert set(found.files) == {"m_control.h", "m_control.c"}


@with_compiler
def test_it_begins_at_the_same_rest(tmp_path):
    """Of a network that keeps roots, and far from all regions."""
    controller = controller_of("root").value
    network, c = controller.network, Library(controller, tmp_path)
    random = np.random.default_rng(0)
    for _ in range(30):
        u = random.uniform(-1, 2, 2) * np.asarray(network.high[:2])
        state = controller.begin(u, [0.0])
        c.begin(u, [0.0])
        np.testing.assert_allclose(
            c.memory[c.states], state.estimate.offset[0], rtol=1e-8, atol=1e-8
        )


@with_compiler
@pytest.mark.parametrize("more", [{}, {"observe_states": False, "rounds": 2}])
def test_so_does_one_of_bounds_rates_limits_and_a_domain(more):
    network, _ = network_and_cycle()
    free = {"c": Command(low=-0.9, high=0.8, rate=0.6, effort=0.1)}
    limit = {"heat": OutputLimit(at_most=0.1)}
    found = mpc(network, free, {"y": 2.0}, limit, **more).value
    assert export_controller(found).difference["c, controller"] <= AGREEMENT
    held = dataclasses.replace(found, network=hold_to_range(network))
    assert export_controller(held).difference["c, controller"] <= AGREEMENT


@with_compiler
def test_the_filter_sees_values_where_the_model_keeps_roots(tmp_path):
    """A state of the C is the root of what the controller estimates."""
    controller = controller_of("root", observe_states=True).value
    network, c = controller.network, Library(controller, tmp_path)
    middle = 0.5 * (np.asarray(network.low) + np.asarray(network.high))
    u, measured = middle[:2], middle[2:3]
    state = controller.begin(u, measured)
    c.begin(u, measured)
    for t in range(4):
        measured = middle[2:3] + 0.3 * t
        state, decision = controller.step(state, measured, middle[2:3], middle[1:2])
        commands, _ = c.step(measured, np.repeat(middle[2], 8), np.repeat(middle[1], 8))
        np.testing.assert_allclose(commands, decision.commands, atol=1e-9)


@with_compiler
def test_it_begins_anew_and_holds_what_is_missing(tmp_path):
    """Both at once: a run at its bounds, and an input that is no number."""
    controller = mpc(linear(), FREE, ["speed"], horizon=8).value
    c, names = Library(controller, tmp_path), jnx.state_space(linear()).names
    state = controller.begin([0.2, -0.1], [0.1, 0.1])
    c.begin([0.2, -0.1], [0.1, 0.1])
    at = [k for k, name in enumerate(names) if name.startswith(("speed", "heat"))]
    far = state.estimate.x.at[np.array(at)].set(1e3)
    lost = state._replace(estimate=state.estimate._replace(x=far))
    c.memory[c.fed_back] = 1e6
    given = np.full((8, 1), np.nan)
    reference = np.full((8, 1), 0.1)
    for measured in ([0.1, 0.1], [0.12, np.nan]):
        lost, decision = controller.step(lost, measured, reference, given)
        commands, (solved, restarted) = c.step(measured, reference, given)
        assert np.isfinite(commands).all() and solved
        assert bool(decision.restarted) == bool(restarted) == (measured[0] == 0.1)
        assert float(lost.u[1]) == -0.1


@with_compiler
def test_both_begin_where_an_input_is_missing(tmp_path):
    """At the middle of its trained range, and with a reference that is no number."""
    controller = mpc(linear(), FREE, ["speed"], horizon=8).value
    c = Library(controller, tmp_path)
    state = controller.begin([0.2, np.nan], [0.1, np.nan])
    c.begin([0.2, np.nan], [0.1, np.nan])
    for wanted in (0.1, np.nan, 0.2):
        rows = [0.1, 0.1], np.full((8, 1), wanted), np.full((8, 1), -0.1)
        state, decision = controller.step(state, *rows)
        commands, (solved, _) = c.step(*rows)
        assert bool(solved) == bool(decision.solved) == np.isfinite(wanted)
        assert np.isfinite(commands).all()
        np.testing.assert_allclose(commands, decision.commands, atol=1e-9)


@with_compiler
def test_inputs_beyond_a_range_that_is_reported_as_nan(tmp_path):
    """A report of NaN is no part of the state: neither is lost for ever."""
    network = hold_to_range(linear(), None, outside="nan")
    controller = mpc(network, FREE, ["speed"], horizon=8).value
    c = Library(controller, tmp_path)
    state = controller.begin([0.2, -0.1], [0.1, 0.1])
    c.begin([0.2, -0.1], [0.1, 0.1])
    for load in (-0.1, 1.5, 1.5, -0.1):
        rows = [0.1, 0.1], np.full((8, 1), 0.1), np.full((8, 1), load)
        state, decision = controller.step(state, *rows)
        commands, (solved, _) = c.step(*rows)
        assert bool(solved) and bool(decision.solved)
        np.testing.assert_allclose(commands, decision.commands, atol=1e-8)


@with_compiler
def test_values_that_no_sensor_gives_are_missing(tmp_path):
    controller = mpc(linear(), FREE, ["speed"], horizon=8).value
    c = Library(controller, tmp_path)
    state = controller.begin([0.2, 1e30], [0.1, -1e30])
    c.begin([0.2, 1e30], [0.1, -1e30])
    for measured, load in (([0.1, 1e30], -0.1), ([0.1, 0.1], 1e30)):
        rows = measured, np.full((8, 1), 0.2), np.full((8, 1), load)
        state, decision = controller.step(state, *rows)
        commands, (solved, _) = c.step(*rows)
        assert bool(solved) and bool(decision.solved)
        np.testing.assert_allclose(commands, decision.commands, atol=1e-8)


@with_compiler
def test_files_of_any_name_compile():
    controller = mpc(linear(), FREE, ["speed"], horizon=3).value
    found = export_controller(controller, name="UPPER_NAME")
    assert found.difference["c, controller"] <= AGREEMENT


@pytest.mark.skipif(shutil.which("cppcheck") is None, reason="no cppcheck here")
@pytest.mark.parametrize("name", some(("root", "coupled"), "root"))
def test_cppcheck_finds_only_the_deviations_that_are_listed(tmp_path, name):
    control = control_program(controller_of(name).value, "m")
    write_files(tmp_path, control_files(control))
    source = tmp_path / "m_control.c"
    words = ["cppcheck", "--std=c99", "-q", "--addon=misra", "--enable=style"]
    words += ["--suppress=missingIncludeSystem", str(source)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    if "misra.py" in done.stderr and "Did not find" in done.stderr:
        pytest.skip("this cppcheck has no MISRA rules")
    found = [line for line in done.stderr.splitlines() if line.endswith("]")]
    known = {line.rsplit("[", 1)[1].rstrip("]") for line in found}
    known = {rule for rule in known if rule.startswith("misra")}
    assert known <= {f"misra-c2012-{k}" for k in ("2.2", "2.5", "8.7", "8.9")}
    assert "misra-c2012-8.7" in known, "the rules were not looked at"
    assert "Deviations: 2.2" in source.read_text()


@with_compiler
def test_one_that_decides_otherwise_is_found_out(monkeypatch):
    def bent(control):
        files = control_files(control)
        text = str(files["model_control.c"])
        assert "price * c->change[i];" in text
        files["model_control.c"] = text.replace(
            "price * c->change[i];", "1.01 * price * c->change[i];"
        )
        return files

    monkeypatch.setattr(_export_controller, "control_files", bent)
    controller = mpc(linear(), FREE, ["speed"], horizon=8).value
    with pytest.raises(ExportError, match="differ from those of the controller"):
        export_controller(controller)


def test_without_a_compiler_it_is_written_and_says_so(monkeypatch):
    monkeypatch.setattr(_export_controller, "compiler", lambda: None)
    controller = mpc(linear(), FREE, ["speed"], horizon=8).value
    found = export_controller(controller, name="plant 1")
    assert "no C compiler" in found.left_out[0]
    header = str(found.files["plant_1_control.h"])
    assert "commands: force" in header and "given: load" in header
    assert "malloc" not in str(found.files["plant_1_control.c"])


def test_commands_near_their_bounds_stand_there():
    """Beyond a trained range by round-off an input would have another slope."""
    controller = mpc(linear(), {"force": Command()}, ["speed"], horizon=4).value
    high = float(controller.high[0])
    z = jnp.full((4, 1), high / float(controller.span[0]) * (1 + 1e-12))
    assert np.all(np.asarray(plan_of(controller, z)) == high)
    inside = np.asarray(plan_of(controller, 0.5 * z))
    np.testing.assert_allclose(inside, 0.5 * high, rtol=1e-9)
