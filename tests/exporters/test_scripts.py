"""Files of one page in every language: starts, flags, and what names may do to them."""

import dataclasses
import json
import subprocess
from pathlib import Path

import common
import numpy as np
import pytest
from common import A, Part, some
from test_targets import written

from jaxnarx.data import Channel, Channels
from jaxnarx.errors import SpecError
from jaxnarx.exporters import Instance, export, lower, octave, runners
from jaxnarx.exporters._export import write_files
from jaxnarx.exporters.interpret import STARTS
from jaxnarx.exporters.matlab import TAKEN_WORDS
from jaxnarx.exporters.proof import make_cases

FIRST = np.array([0.7, 0.2])
MEASURED = np.array([4.0])
SETTLED = 1e-8
"""Of a steady state: rounding decides at which sample it is found."""

needs_octave = pytest.mark.skipif(octave.octave() is None, reason="there is no Octave")


def expected(program, kind: str) -> np.ndarray:
    instance = Instance(program)
    instance.start(kind, FIRST, MEASURED)
    return np.array([instance.step(FIRST)["outputs"] for _ in range(8)])


def by_python(folder: Path, kind: str) -> np.ndarray:
    spec = (folder / "m.py").read_text()
    scope: dict = {}
    exec(compile(spec, "m.py", "exec"), scope)
    model = scope["Model"]()
    model.start(kind, FIRST.tolist(), MEASURED.tolist())
    return np.array([model.step(FIRST.tolist()) for _ in range(8)])


def by_javascript(folder: Path, kind: str) -> np.ndarray:
    u, y = json.dumps(FIRST.tolist()), json.dumps(MEASURED.tolist())
    code = (
        "import { Model } from './m.mjs'; const model = new Model(); "
        f"model.start('{kind}', {u}, {y}); "
        f"for (let t = 0; t < 8; t++) console.log(model.step({u})[0]);"
    )
    (folder / "main.mjs").write_text(code)
    node = runners.node()
    assert node is not None
    said = subprocess.check_output([node, "main.mjs"], cwd=folder, text=True)
    return np.array([[float(v)] for v in said.split()])


def by_octave(folder: Path, kind: str) -> np.ndarray:
    call = ", [4.0]" if kind == "given" else ""
    code = (
        f"m([0.7 0.2], '{kind}'{call}); "
        "for t = 1:8, printf('%.17g\\n', m([0.7; 0.2])); end"
    )
    return np.array([[float(v)] for v in octave.run_octave(folder, code).split()])


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Path:
    """A model of two inputs and one output, in every scripting language."""
    folder = tmp_path_factory.mktemp("scripts")
    net = common.named("by own output")
    to = ["python", "javascript", "matlab"]
    for one in to:
        write_files(folder, written(net, one))
    return folder


@pytest.mark.parametrize("kind", STARTS)
def test_starts_are_the_same_in_every_language(page, kind):
    right = expected(lower(common.named("by own output")), kind)
    found = [by_python(page, kind)]
    if runners.node():
        found.append(by_javascript(page, kind))
    if octave.octave():
        found.append(by_octave(page, kind))
    most = SETTLED if kind == "steady" else 1e-12
    for one in found:
        np.testing.assert_allclose(one, right, rtol=most)


def test_starts_differ_and_come_to_the_same_rest():
    program = lower(common.named("by own output"))
    runs = {}
    for kind in STARTS:
        instance = Instance(program)
        instance.start(kind, FIRST, MEASURED)
        rows = [instance.step(FIRST)["outputs"][0] for _ in range(200)]
        runs[kind] = rows
    rest = runs["steady"][0]
    # the middle of this output's range is zero
    assert runs["mean"] == runs["zeros"] != runs["given"]
    assert abs(runs["given"][0] - rest) > 0.1
    for rows in runs.values():
        assert abs(rows[-1] - rest) < 1e-7
    with pytest.raises(SpecError, match="kind must be one of 'steady', 'mean'"):
        Instance(program).start("warm", FIRST)
    with pytest.raises(SpecError, match="to start as given"):
        Instance(program).start("given", FIRST)


def test_many_runs_side_by_side_are_each_alone():
    """Of two outputs that feed each other, and a flag that some of the runs raise."""
    program = lower(common.named("coupled"))
    u = np.random.default_rng(0).uniform(-3, 3, (20, 2, 5))
    y = np.random.default_rng(1).uniform(-3, 3, (2, 5))
    together = Instance(program)
    together.start("given", u[0], y)
    rows = [together.step(now) for now in u]
    for n in range(5):
        alone = Instance(program)
        alone.start("given", u[0, :, n], y[:, n])
        for t, now in enumerate(u[:, :, n]):
            found = alone.step(now)
            for name in ("outputs", "limited"):
                np.testing.assert_allclose(found[name], rows[t][name][:, n], rtol=1e-13)
    rested = Instance(program).settle(u[0])
    single = [int(Instance(program).settle(u[0, :, n])) for n in range(5)]
    # rounding of a vector of numbers may decide a sample earlier or later
    assert np.all(abs(rested - single) <= 1) and len(set(single)) > 1


@needs_octave
def test_octave_runs_it_and_its_own_test_finds_what_is_wrong(page, tmp_path):
    assert "given: differs by" in octave.run_octave(page, "m_test")
    for file in page.glob("m*.m"):
        (tmp_path / file.name).write_text(file.read_text())
    text = (tmp_path / "m.m").read_text()
    assert text.count("exp(v") > 1
    (tmp_path / "m.m").write_text(text.replace("exp(v", "exp(0.9 * v"))
    with pytest.raises(octave.ExportError, match="after the start given it differs"):
        octave.run_octave(tmp_path, "m_test")


def test_the_test_of_matlab_leaves_out_a_steady_state_that_is_far(monkeypatch):
    """Of a model that swings for ever, and says so."""
    part = common.Part([[((0, 0), 1.0), ((0, 3), -2.0)]])
    net = common.network([part], variables=common.VARIABLES[:4])
    text = str(written(net, "matlab")["m_test.m"])
    assert "from_steady" not in text
    assert "'steady' takes more than 2000 samples" in text
    program, ran = lower(net, "m"), []
    monkeypatch.setattr(octave, "octave", lambda: "octave")
    monkeypatch.setattr(octave, "run_octave", lambda *words: ran.append(words) or "")
    monkeypatch.setattr(octave, "worst", lambda *words: 0.0)
    cases = make_cases(net, program, common.dataset((60,), seed=3))
    _, left_out = octave.prove_matlab(program, Path("."), cases)
    assert len(ran) == 1 and "the start 'steady', which takes more than" in left_out[0]
    settled = written(common.named("one model"), "matlab")
    assert "from_steady" in str(settled["m_test.m"])


def odd(name: str):
    net = common.named("by inputs")
    channels = Channels(
        (Channel(name, "V"), Channel("b", name)), (Channel(f"y{name}"), Channel("w"))
    )
    return dataclasses.replace(net, channels=channels)


@pytest.mark.parametrize("name", ['"""; */ x', "'; quit(3) %", "%{ é\\", "$name {0}"])
def test_names_of_channels_stay_texts(name, tmp_path):
    to = ["python", "javascript"] + ["matlab"] * bool(octave.octave())
    found = export(odd(name), to=to, name="m")
    assert set(found.difference) >= {"python"}
    for file, text in found.texts.items():
        (tmp_path / file).write_text(text, "utf-8")
    scope: dict = {}
    exec(compile(found.texts["m.py"], "m.py", "exec"), scope)
    assert scope["INPUTS"] == [name, "b"]


HOSTILE = [
    ["/*", "*/ int x; /*", "//", "x\\", "??/"],
    ["/*/**/", '"""\\"', "'%{ --", "]]>&", "\\u002a/"],
]


@pytest.mark.parametrize("names", some(HOSTILE, HOSTILE[1]))
def test_hostile_names_go_through_every_target(names):
    """Proven where there are the programs for it: warnings of compilers are errors."""
    net, (a, b, unit, y, w) = common.named("by inputs"), names
    channels = Channels((Channel(a, "V"), Channel(b, unit)), (Channel(y), Channel(w)))
    net = dataclasses.replace(net, channels=channels)
    to = ["c", "fmu2", "fmu3", "python", "javascript", "matlab", "dcm", "a2l"]
    found = export(net, to=to, name="m")
    assert len(found.files) == 11 and not found.failed
    if runners.compiler():
        assert {"c, double", "c, single", "fmu2", "fmu3"} <= set(found.difference)


@pytest.mark.parametrize("word", ["class", "end", "exp", "Clear"])
def test_words_of_a_language_name_no_model(word):
    to = "python" if word == "class" else "matlab"
    with pytest.raises(SpecError, match="is a word of"):
        export(common.named("one model"), to=[to], name=word, verify=False)
    assert word == "class" or word.lower() in TAKEN_WORDS


def test_a_model_without_memory_keeps_its_input_alone():
    """Its last value, and for how many samples it has been missing."""
    variables = ((A, 0),)
    net = common.network([Part([[((0,), 0.3), ((1,), 0.5)]])], variables=variables)
    to = ["python", "javascript"] + ["matlab"] * bool(octave.octave())
    found = export(net, to=to)
    assert found.kept == 2 and max(found.difference.values()) < 1e-14
