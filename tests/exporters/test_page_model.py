"""The model of a report's page beside the form that `test_targets` holds to
`simulate`: networks of every kind.

What runs is what the page runs: its inline script and its own `freeRun`.
"""

import json
import subprocess

import common
import numpy as np
import pytest
import test_targets
from browser import Browser, needs_browser
from test_targets import NETWORKS, narrowed

from jaxnarx.exporters import lower, runners
from jaxnarx.exporters.proof import Case
from jaxnarx.models import OUTSIDE
from jaxnarx.shell.report.page._running import (
    describe_program,
    model_script,
    read_script,
)

EXACT = 1e-11
"""In shares of an output's largest value: rounding; the page is to keep to 1e-9."""


@pytest.fixture(scope="module")
def cases() -> list[tuple[str, str, list[Case]]]:
    """Name, script that makes `MODEL` and `program`, and records, of every network."""
    networks = {name: make() for name, make in NETWORKS.items()}
    for outside in OUTSIDE:
        networks[outside] = narrowed(common.named("by inputs"), outside)
    found = []
    for name, net in networks.items():
        program = lower(net)
        about = json.dumps(describe_program(program))
        script = f"{model_script(program)}\nconst program = {{...MODEL, ...{about}}};"
        found.append((name, script, [case_of(net, program)]))
    return found


def case_of(net, program) -> Case:
    """A record, with what the form makes of it; hidden channels begin at zero."""
    rows, names = common.signals(60, 3), net.channels.names
    inputs = rows[:, [names.index(port.name) for port in program.inputs]]
    padded = np.pad(rows, ((0, 0), (0, net.hidden)))
    measured = padded[: program.history + 1, list(net.signals)]
    told = test_targets.told(program, Case(inputs, measured, inputs, 0))
    return Case(inputs, measured, np.array([row["outputs"] for row in told]), 0)


def call(case: Case) -> str:
    """An expression for the outputs of the free run over a case."""
    inputs, measured = (json.dumps(x.tolist()) for x in (case.inputs, case.measured))
    start = len(case.inputs) - len(case.expected)
    return f"freeRun(program, {inputs}, {measured}, {start}).outputs"


def beside(case: Case, outputs: list[list[float | None]]) -> float:
    """The largest difference; samples of the history are not computed."""
    found = np.array(outputs, float).T  # None is NaN
    start = len(case.inputs) - len(case.expected)
    assert np.isnan(found[:start]).all()
    return case.difference(lambda *_: found[start:])


@pytest.mark.skipif(runners.node() is None, reason="there is no node here")
def test_node_runs_every_network_as_simulate_does(cases, tmp_path):
    run = read_script("run")
    parts = [
        f"(() => {{ {script}\nreturn [{', '.join(map(call, some))}]; }})()"
        for _, script, some in cases
    ]
    plain = "(k, v) => v instanceof Float64Array ? [...v] : v"
    file = tmp_path / "all.js"
    file.write_text(
        f"{run}\nconsole.log(JSON.stringify([{', '.join(parts)}], {plain}));"
    )
    node = runners.node()
    assert node is not None
    done = subprocess.run([node, str(file)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    for (name, _, some), outputs in zip(cases, json.loads(done.stdout), strict=True):
        for case, one in zip(some, outputs, strict=True):
            assert beside(case, one) < EXACT, name


@needs_browser
def test_chromium_runs_every_network_as_simulate_does(cases):
    run = read_script("run")
    with Browser() as browser:
        for name, script, some in cases:
            for case in some:
                told = browser.value(
                    f"(() => {{ {run}\n{script}\nreturn {call(case)}"
                    ".map((v) => Array.from(v, (x) => Number.isNaN(x) ? null : x));"
                    "})()"
                )
                assert beside(case, told) < EXACT, name
