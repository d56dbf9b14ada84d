"""Exported C: what a run starts from, and the rules that cppcheck knows."""

import ctypes
import dataclasses
import shutil
import subprocess
from pathlib import Path

import common
import hidden_problems
import jax
import numpy as np
import pytest

from jaxnarx.exporters import Instance, lower
from jaxnarx.exporters.c99 import sources
from jaxnarx.exporters.compilers import WARNING_FLAGS, compilers
from jaxnarx.exporters.interpret import STARTS
from jaxnarx.models import Network

needs_compiler = pytest.mark.skipif(
    not compilers(), reason="there is no C compiler here"
)
ROOM = 1 << 16
"""Bytes for a state and for what a step tells: more than they take."""


def written(net: Network, place: Path) -> Path:
    """The source of a network, with a self-test that expects nothing."""
    program = lower(net, "m")
    golden = {
        "inputs": np.zeros((20, len(program.inputs))),
        "measured": np.zeros((program.history + 1, len(program.computed))),
        "outputs": np.zeros((20 - program.history, len(program.reported))),
    }
    for name, text in sources(program, golden).items():
        (place / name).write_text(str(text))
    return place / "m.c"


class Compiled:
    """The functions of a library, for arrays; an instance is a state."""

    def __init__(self, net: Network, place: Path) -> None:
        source = written(net, place)
        words = [compilers()[0], *WARNING_FLAGS, "-fPIC", "-shared", source, "-lm"]
        subprocess.run([*map(str, words), "-o", str(place / "m.so")], check=True)
        self.own = ctypes.CDLL(str(place / "m.so"))
        self.state, self.out = (ctypes.create_string_buffer(ROOM) for _ in range(2))
        self.reported = len(lower(net).reported)

    def start(self, kind: int, u: np.ndarray, y: np.ndarray | None) -> int:
        arrays = [None if a is None else np.ascontiguousarray(a) for a in (u, y)]
        pointers = [
            None if a is None else a.ctypes.data_as(ctypes.c_void_p) for a in arrays
        ]
        return self.own.m_start(self.state, kind, *pointers)

    def step(self, u: np.ndarray) -> np.ndarray:
        self.own.m_step(self.state, u.ctypes.data_as(ctypes.c_void_p), self.out)
        return np.frombuffer(self.out.raw, float, self.reported)


def reference(net: Network, kind: str, u: np.ndarray, y: np.ndarray) -> Instance:
    """The rule, by the form's own steps."""
    program = lower(net)
    own = Instance(program)
    if kind == "steady":
        own.settle(u[0])
    elif kind == "mean":
        own.begin(u[0], np.array([0.5 * (p.low + p.high) for p in program.computed]))
    elif kind == "zeros":
        own.begin(u[0], np.zeros(y.shape[1]))
    else:
        own.begin(u[0], y[0])
    return own


@needs_compiler
@pytest.mark.parametrize("name", ["coupled", "hidden"])
def test_a_run_starts_from_what_is_asked_for(tmp_path, name):
    net = hidden_problems.network() if name == "hidden" else common.named(name)
    # the middle of a range is not zero
    net = dataclasses.replace(net, low=jax.device_put(0.5 * np.asarray(net.low)))
    program = lower(net)
    rows = common.signals(6, 4)
    u, y = rows[:, :2].copy(), np.resize(rows[:, 2:], (6, len(program.computed)))
    model = Compiled(net, tmp_path)
    firsts = []
    for n, kind in enumerate(STARTS):
        own = reference(net, kind, u, y)
        assert model.start(n, u, y if kind == "given" else None) == 0
        expected = np.array([own.step(now)["outputs"] for now in u])
        found = np.array([model.step(now) for now in u])
        np.testing.assert_allclose(found, expected, rtol=1e-12)
        firsts.append(tuple(found[0]))
    assert len(set(firsts)) == len(STARTS), "two starts are the same"


@needs_compiler
def test_a_start_that_is_not_known_and_a_state_that_never_rests(tmp_path):
    # y is thrown from one bound to the other
    part = common.Part([[((0, 0), 1.0), ((0, 3), -2.0)]])
    net = common.network([part], variables=common.VARIABLES[:4])
    model = Compiled(net, tmp_path)
    u, before = np.zeros((1, 2)), bytes(model.state.raw)
    assert model.start(4, u, None) == 2
    assert model.start(-1, u, None) == 2
    assert model.state.raw == before
    assert model.start(0, u, None) == 1
    assert model.start(1, u, None) == 0


@pytest.mark.skipif(shutil.which("cppcheck") is None, reason="no cppcheck here")
@pytest.mark.parametrize("single", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_cppcheck_finds_only_the_deviations_that_are_listed(tmp_path, single):
    source = written(common.named("one model"), tmp_path)
    words = ["cppcheck", "--std=c99", "-q", "--addon=misra"]
    words += ["--enable=warning,style,performance,portability"]
    words += [
        "--suppress=missingIncludeSystem",
        "-DM_SINGLE" if single else "-UM_SINGLE",
    ]
    done = subprocess.run(
        [*words, str(source), str(tmp_path / "m_selftest.c")],
        capture_output=True,
        text=True,
        check=True,
    )
    if "misra.py" in done.stderr and "Did not find" in done.stderr:
        pytest.skip("this cppcheck has no MISRA rules")
    found = [line for line in done.stderr.splitlines() if line.endswith("]")]
    listed = {"misra-c2012-2.5", "misra-c2012-8.7"}
    assert "Deviations: 2.5 and 8.7" in source.read_text()
    known = {line.rsplit("[", 1)[1].rstrip("]") for line in found}
    # the self-test prints: it is for a machine with a screen
    assert known - listed <= {"misra-c2012-21.6"}, done.stderr
    assert "misra-c2012-8.7" in known, "the rules were not looked at"
    assert not [line for line in found if "21.6" in line and "selftest" not in line]
