"""FMUs of FMI 2.0 and 3.0 by fmpy, beside `simulate` and the reference in numpy."""

import ctypes
import dataclasses
import itertools
import platform
import subprocess
import sys
import warnings
import zipfile
from io import BytesIO
from pathlib import Path
from xml.etree import ElementTree as ET

import common
import hidden_problems
import jax
import numpy as np
import pytest
from common import some

from jaxnarx.data import Channel, Channels, Dataset
from jaxnarx.exporters import ExportError, Instance, a2l, c99, export, lower
from jaxnarx.exporters.a2l import addresses_in
from jaxnarx.exporters.code import digits
from jaxnarx.exporters.compilers import WARNING_FLAGS, compilers
from jaxnarx.exporters.fmu import fmu_runner, pack
from jaxnarx.exporters.fmu.prove import load_memory
from jaxnarx.exporters.fmu.xcp import xcp_files
from jaxnarx.exporters.form import SampleProgram
from jaxnarx.exporters.interpret import STARTS
from jaxnarx.exporters.maps import FREE_AXIS, rest_maps
from jaxnarx.exporters.proof import make_cases
from jaxnarx.exporters.target import as_bytes
from jaxnarx.models import Network, hold_to_range
from jaxnarx.regressors import Variables
from jaxnarx.simulation import simulate

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    fmpy = pytest.importorskip("fmpy")
    import fmu_problems
    from fmpy.validation import validate_fmu
from fmu_problems import REFUSED, Importer

HERE = 1e-12
"""Largest difference, in shares of an output's largest value: rounding."""
STEP = 0.1
NAMES = common.CHANNELS.names
ELF_HERE = platform.system() == "Linux" and sys.maxsize > 2**32
"""Whether binaries have addresses that are read here."""

pytestmark = pytest.mark.skipif(not compilers(), reason="there is no C compiler here")


def records() -> Dataset:
    return common.dataset((60,), seed=3)


def network() -> Network:
    """Two outputs that depend on inputs of their own time; a bound that acts."""
    return common.named("coupled", bound=0.6)


@pytest.fixture(scope="module")
def places(tmp_path_factory) -> dict[int, Path]:
    """Unpacked FMUs of both versions."""
    files = export(
        network(), records(), to=["fmu2", "fmu3"], name="m", verify=False
    ).files
    folder = tmp_path_factory.mktemp("fmu")
    return {
        n: fmu_problems.unpacked(files[f"m_fmi{n}.fmu"], folder / f"fmi{n}")
        for n in (2, 3)
    }


@pytest.fixture(params=[2, 3])
def place(request, places) -> Path:
    return places[request.param]


@pytest.fixture
def unit(place):
    """An instance in initialization mode."""
    found = Importer(place)
    found.enter()
    yield found
    found.end()


def inputs(samples: int, seed: int = 1) -> np.ndarray:
    return common.signals(samples, seed)[:, :2]


def reference(u: np.ndarray) -> Instance:
    """The form in numpy, from the steady state."""
    instance = Instance(lower(network()))
    instance.settle(u)
    return instance


def beyond(found, expected) -> float:
    size = np.max(np.abs(expected), axis=0)
    return float(np.max(np.abs(np.asarray(found) - expected) / size))


# validity -------------------------------------------------------------------------


def renamed(names) -> Network:
    """The same network with other channels."""
    net = network()
    units = ["°C", "", "1/h", "<&>"]
    a, b, y, w = (Channel(n, u) for n, u in zip(names, units, strict=True))
    return dataclasses.replace(net, channels=Channels((a, b), (y, w)))


CHECKER = "fmu_manipulation_toolbox"
ODD = ['<a href="x">&*/', "start", "time", "limited.time"]


def description_only(net: Network, version: int, path: Path) -> Path:
    """An FMU without a binary, for checks that do not run it."""
    program = lower(net)
    none = np.zeros((1, 0))
    golden = {"inputs": none, "measured": none, "outputs": none}
    parts = pack.contents(program, c99.sources(program, golden), version)
    path.write_bytes(pack.archive(parts))
    return path


@pytest.mark.parametrize(
    ("kind", "version"),
    some(
        itertools.product(("usual", "hidden", "odd names"), (2, 3)),
        *(("usual", 3), ("hidden", 2), ("odd names", 3)),
    ),
)
def test_two_checkers_find_nothing(tmp_path, kind, version, places):
    path = tmp_path / "model.fmu"
    if kind == "usual":
        path = places[version].with_suffix(".fmu")
    elif kind == "hidden":
        description_only(hidden_problems.network(), version, path)
    else:
        description_only(renamed(ODD), version, path)
    assert validate_fmu(str(path)) == []
    done = subprocess.run(
        [sys.executable, "-m", CHECKER, "-input", str(path), "-check"],
        capture_output=True,
        text=True,
    )
    said = done.stdout + done.stderr
    assert f"compliant with FMI-{version}.0" in said
    assert "No semantic error" in said
    if kind == "odd names":
        about = fmpy.read_model_description(str(path))
        names = [v.name for v in about.modelVariables]
        assert names[:4] == ODD
        assert "limited.time_2" in names and "start_2" in names


def test_the_same_model_makes_the_same_archive_and_another_one_another(tmp_path):
    def written(bound: float) -> bytes:
        net = common.named("coupled", bound=bound)
        return description_only(net, 2, tmp_path / "one.fmu").read_bytes()

    def token(content: bytes) -> str:
        with zipfile.ZipFile(BytesIO(content)) as packed:
            text = packed.read("modelDescription.xml").decode()
        return text.split('guid="')[1].split('"')[0]

    assert written(0.6) == written(0.6)
    assert token(written(0.6)) != token(written(0.7))


# values ---------------------------------------------------------------------------


def test_steps_are_the_free_run_from_measured_history(place, tmp_path):
    data, program = records(), lower(network())
    case = make_cases(network(), program, data)[0]
    history = program.history
    unit = Importer(place)
    unit.enter()
    unit.given(case.inputs[:history], case.measured[:history], NAMES)
    unit.leave()
    rows, u = [], case.inputs[history:]
    for t, now in enumerate(u):
        unit.set(["a", "b"], now)
        unit.step(t * STEP, STEP)
        rows.append(unit.get("y", "w"))
    unit.end()
    expected = np.asarray(simulate(network(), data).value[0])[history:]
    assert beyond(rows, expected) < HERE


def test_an_output_is_of_the_sample_that_the_step_has_taken(unit):
    """y(t) is at hand at the beginning, and again behind the step that takes it."""
    u = inputs(6)
    unit.set(["a", "b"], u[0])
    own = reference(u[0])
    first = own.step(u[0])["outputs"]
    np.testing.assert_allclose(unit.get("y", "w"), first, rtol=HERE)
    unit.leave()
    unit.step(0.0, STEP)
    np.testing.assert_allclose(unit.get("y", "w"), first, rtol=HERE)
    unit.set(["a", "b"], u[1])
    # not yet: the sample is taken by the step
    np.testing.assert_allclose(unit.get("y", "w"), first, rtol=HERE)
    unit.step(STEP, STEP)
    second = own.step(u[1])["outputs"]
    np.testing.assert_allclose(unit.get("y", "w"), second, rtol=HERE)
    # three samples in one step hold their inputs
    unit.set(["a", "b"], u[2])
    unit.step(2 * STEP, 3 * STEP)
    rows = [own.step(u[2])["outputs"] for _ in range(3)]
    np.testing.assert_allclose(unit.get("y", "w"), rows[-1], rtol=HERE)


def test_event_mode_has_no_delay_and_may_be_asked_again(places):
    u = inputs(8)
    unit = Importer(places[3], events=True)
    unit.enter()
    unit.set(["a", "b"], u[0])
    unit.own.exitInitializationMode()
    own = reference(u[0])
    for t, now in enumerate(u):
        unit.set(["a", "b"], 0.5 * now)
        unit.own.updateDiscreteStates()
        unit.get("y", "w")
        unit.set(["a", "b"], now)
        updated = unit.own.updateDiscreteStates()
        assert updated[:4] == (False,) * 4
        assert updated[5] == pytest.approx((t + 1) * STEP)
        expected = own.step(now)["outputs"]
        np.testing.assert_allclose(unit.get("y", "w"), expected, rtol=HERE)
        unit.own.enterStepMode()
        unit.step(t * STEP, STEP)
        # held until the next event
        np.testing.assert_allclose(unit.get("y", "w"), expected, rtol=HERE)
        assert unit.get("time")[0] == pytest.approx((t + 1) * STEP, rel=1e-15)
        unit.own.enterEventMode()
    unit.end()


def test_bounds_flags_and_the_past_are_variables(place):
    high = np.array([1.0, 1.0, 9.0, 9.0])
    low, high = jax.device_put((-high, high))
    net = dataclasses.replace(network(), low=low, high=high)
    net = hold_to_range(net, outside="linear")
    version = int(place.name[-1])
    files = export(net, records(), to=[f"fmu{version}"], name="m", verify=False).files
    folder = place.parent / f"held{version}"
    unit = Importer(fmu_problems.unpacked(files[f"m_fmi{version}.fmu"], folder))
    u = 1.5 * inputs(40)
    instance = Instance(lower(net))
    instance.settle(u[0])
    unit.enter()
    unit.set(["a", "b"], u[0])
    unit.leave()
    seen = set()
    past = np.zeros(2)
    for t, now in enumerate(u):
        unit.set(["a", "b"], now)
        unit.step(t * STEP, STEP)
        found = instance.step(now)
        assert unit.get("extrapolated") == [found["extrapolated"]]
        assert unit.truth("limited.y", "limited.w") == list(found["limited"] > 0)
        y1, y2, w1 = unit.get("past.y[1]", "past.y[2]", "past.w[1]")
        np.testing.assert_allclose([y1, w1], found["fed"], rtol=HERE, atol=HERE)
        if t:
            assert y2 == past[0]
        past = np.array([y1, w1])
        seen |= {*map(float, found["limited"]), 2.0 + float(found["extrapolated"])}
    unit.end()
    assert seen == {0.0, 1.0, 2.0, 3.0}, "something that is to be seen never occurs"


def packed_alone(program: SampleProgram, version: int) -> bytes:
    """An archive that has not been proven."""
    golden = {k: np.zeros((1, 2)) for k in ("inputs", "measured", "outputs")}
    golden["axes"] = np.full((len(program.reported), 2), FREE_AXIS)
    content = pack.fmu(version)(program, golden)[f"m_fmi{version}.fmu"]
    assert isinstance(content, bytes)
    return content


@pytest.mark.parametrize("version", [2, 3])
def test_what_a_program_tells_beside_becomes_an_output(tmp_path, version):
    program = lower(network(), "m")
    flags = {**program.flags, "twice": program.fed[0], "band_w": program.fed[1]}
    program = dataclasses.replace(program, flags=flags)
    unit = Importer(
        fmu_problems.unpacked(packed_alone(program, version), tmp_path / "more")
    )
    unit.enter()
    unit.set(["a", "b"], [0.3, 0.1])
    unit.leave()
    unit.step(0.0, STEP)
    assert unit.get("twice", "band_w") == unit.get("y", "w")
    assert unit.truth("limited.y") == [False]
    assert 0.0 not in unit.get("y", "w")
    unit.end()


def metered() -> Network:
    """The network with the rates of two masses."""
    net = network()
    inputs = Channel("a", "rpm"), Channel("b", "°C")
    outputs = Channel("y", "kg/h"), Channel("w", "mg/s")
    return dataclasses.replace(net, channels=Channels(inputs, outputs))


@pytest.mark.parametrize("version", [2, 3])
def test_rates_are_summed_over_the_run(tmp_path, version):
    content = packed_alone(lower(metered(), "m"), version)
    unit = Importer(fmu_problems.unpacked(content, tmp_path / "rates"))
    unit.enter()
    unit.set(["a", "b"], [0.3, 0.1])
    at_once, per = np.array(unit.get("y", "w")), np.array([STEP / 3600, STEP])
    np.testing.assert_allclose(unit.get("total.y", "total.w"), at_once * per)
    unit.leave()
    # What is told stays what it was until a sample is taken.
    np.testing.assert_allclose(unit.get("y", "w"), at_once)
    np.testing.assert_allclose(unit.get("total.y", "total.w"), at_once * per)
    seen = []
    for row in np.repeat(inputs(3), 2, axis=0):
        unit.set(["a", "b"], row)
        unit.step(len(seen) * STEP, STEP)
        seen.append(unit.get("y", "w"))
        expected = np.sum(seen, axis=0) * per
        told = unit.get("total.y", "total.w")
        np.testing.assert_allclose(told, expected, rtol=1e-12, atol=1e-15)
    unit.end()


@pytest.mark.parametrize("version", [2, 3])
def test_units_are_told_in_those_of_si(version):
    with zipfile.ZipFile(
        BytesIO(packed_alone(lower(metered(), "m"), version))
    ) as packed:
        root = ET.fromstring(packed.read("modelDescription.xml"))
    bases = {
        unit.get("name"): {k: v for one in unit for k, v in one.items()}
        for unit in root.iter("Unit")
    }
    flow = {"kg": "1", "s": "-1", "factor": digits(1 / 3600), "offset": "0.0"}
    assert bases["kg/h"] == flow
    assert bases["°C"] == {"K": "1", "factor": "1.0", "offset": "273.15"}
    assert float(bases["rpm"]["factor"]) == pytest.approx(2 * np.pi / 60)
    assert {"kg", "mg"} <= set(bases)


@pytest.mark.parametrize("version", [2, 3])
def test_sums_and_differences_are_relative(version):
    """Zero of a difference in °C is zero of one in K."""
    program = lower(metered(), "m")
    ports = tuple(dataclasses.replace(p, unit="°C") for p in program.computed)
    flags = {**program.flags, "half_y": program.fed[0]}
    fields = {"reported": ports, "computed": ports, "flags": flags}
    content = packed_alone(dataclasses.replace(program, **fields), version)
    with zipfile.ZipFile(BytesIO(content)) as packed:
        root = ET.fromstring(packed.read("modelDescription.xml"))
    (listed,) = root.iter("ModelVariables")
    told = {v.get("name"): v[0] if version == 2 else v for v in listed}
    assert told["half_y"].get("unit") == told["y"].get("unit") == "°C"
    assert told["half_y"].get("relativeQuantity") == "true"
    assert told["y"].get("relativeQuantity") is None


def resting() -> Network:
    """A network that comes to rest wherever its inputs are."""
    part = common.Part([[((2,), 0.5), ((0,), 1.0), ((1,), 0.3)]])
    return common.network([part], variables=((0, 0), (1, 1), (2, 1)))


def test_maps_at_rest_are_constants_that_terminals_group(tmp_path):
    """As FMI-LS-STRUCT 1.0.0-rc.1 wants it; fmpy reads the arrays."""
    program = lower(resting(), "m")
    place = fmu_problems.unpacked(packed_alone(program, 3), tmp_path / "maps")
    (one,) = rest_maps(program, np.full((1, 2), FREE_AXIS))
    assert np.isfinite(one.values).all()
    root = ET.parse(place / "terminalsAndIcons" / "terminalsAndIcons.xml").getroot()
    (terminal,) = root.iter("Terminal")
    kind = "org.fmi-standard.fmi-ls-struct.map"
    assert terminal.get("terminalKind") == f"{kind}.rectilinearGrid"
    members = [(m.get("variableKind"), m.get("variableName")) for m in terminal]
    first, second = (port.name for port in one.axes)
    assert members == [
        (f"{kind}.domain", f"rest.y.{first}"),
        (f"{kind}.domainInput", first),
        (f"{kind}.domain", f"rest.y.{second}"),
        (f"{kind}.domainInput", second),
        (f"{kind}.codomain", "rest.y"),
    ]
    about = fmpy.read_model_description(str(place))
    variables = {v.name: v for v in about.modelVariables}
    unit = Importer(place)
    unit.enter()
    at = [variables[name].valueReference for name in ("y", "rest.y", f"rest.y.{first}")]
    told = unit.own.getFloat64(at, nValues=1 + 121 + 11)
    np.testing.assert_array_equal(told[1:122], one.values.ravel())
    np.testing.assert_array_equal(told[122:], one.points[0])
    with pytest.raises(REFUSED):
        unit.own.getFloat64(at, nValues=3)
    unit.end()
    manifest = place / "extra" / kind.removesuffix(".map") / "fmi-ls-manifest.xml"
    assert 'fmi-ls:fmi-ls-version="1.0.0-rc.1"' in manifest.read_text()


def test_a_model_without_a_past_and_one_that_says_nothing_outside(tmp_path):
    """Nothing is kept from sample to sample; what is no number passes through."""
    edge = np.array([1.0, 1.0, 100.0, 100.0])
    low, high = jax.device_put((-edge, edge))
    part = common.Part([[((0, 0), 1.0), ((0, 1), 0.5)]])
    net = common.network([part], variables=((common.A, 0),))
    net = dataclasses.replace(net, low=low, high=high)
    net = hold_to_range(net, outside="nan")
    found = export(net, records(), to=["fmu2", "fmu3"], name="m")
    assert max(found.difference.values()) < HERE
    place = fmu_problems.unpacked(found.files["m_fmi3.fmu"], tmp_path / "static")
    unit = Importer(place)
    assert "past.y[1]" not in unit.at and "given.y[1]" not in unit.at
    unit.enter()
    # of scaled signals: y/10 = 1 + 0.5 a/2
    for a, expected in ((0.5, 11.25), (1.5, np.nan)):
        unit.set(["a"], [a])
        np.testing.assert_allclose(unit.get("y"), [expected], rtol=HERE)
    unit.end()


@pytest.mark.parametrize("kind", STARTS)
def test_a_run_starts_from_what_is_asked_for(unit, kind):
    u = inputs(4)
    program = lower(network())
    own = Instance(program)
    unit.set(["a", "b"], u[3])
    if kind == "steady":
        own.settle(u[3])
    elif kind == "mean":
        own.begin(u[3], np.array([0.5 * (p.low + p.high) for p in program.computed]))
    elif kind == "zeros":
        own.begin(u[3], np.zeros(2))
    else:
        y = common.signals(4, 9)[:, 2:]
        own.begin(u[0], y[0])
        for k in range(program.history):
            own.observe(u[k], y[k])
        unit.given(u[: program.history], y[: program.history], NAMES)
    unit.start(list(STARTS).index(kind))
    unit.leave()
    for t in range(4):
        unit.step(t * STEP, STEP)
        expected = own.step(u[3])["outputs"]
        np.testing.assert_allclose(unit.get("y", "w"), expected, rtol=HERE, atol=HERE)


def test_directional_derivatives_are_central_differences(unit):
    """Of the sample that the next step takes, by inputs and by past outputs."""
    u = np.array([0.3, 0.1])
    unit.set(["a", "b"], [1.0, -0.2])
    unit.start(3)
    unit.leave()
    unit.step(0.0, STEP)
    unit.set(["a", "b"], u)
    outputs = [unit.at["y"], unit.at["w"]]
    names = ["a", "b", "past.y[1]", "past.y[2]", "past.w[1]"]
    knowns = [unit.at[n] for n in names]
    one = np.eye(5)
    found = np.array(
        [unit.own.getDirectionalDerivative(outputs, knowns, list(row)) for row in one]
    ).T
    # the program's past, in its own scaling, by the names that it has
    program = lower(network())
    own = Instance(program)
    own.begin(np.array([1.0, -0.2]), np.zeros(2))
    own.step(np.array([1.0, -0.2]))
    kept = {k: v.copy() for k, v in own.delays.items()}
    gains = [common.GAIN[common.Y]] * 2 + [common.GAIN[common.W]]
    h = 1e-6
    for column in range(5):
        rows = []
        for sign in (1, -1):
            for line, value in kept.items():
                own.delays[line] = value.copy()
            moved = u.copy()
            if column < 2:
                moved[column] += sign * h
            else:
                line, lag = program.past[column - 2]
                own.delays[line][lag - 1] += sign * h / gains[column - 2]
            rows.append(own.step(moved)["outputs"])
        # the differences' own error is h squared and rounding over h
        slope = (rows[0] - rows[1]) / (2 * h)
        np.testing.assert_allclose(found[:, column], slope, rtol=1e-6, atol=1e-8)
    assert np.all(np.any(found != 0, axis=0)[[0, 1, 2, 4]])
    both = unit.own.getDirectionalDerivative(outputs[:1], knowns, [1, 2, 3, 4, 5])
    np.testing.assert_allclose(both, found[:1] @ np.arange(1, 6), rtol=1e-13)
    if unit.version == 3:
        back = unit.own.getAdjointDerivative(outputs, knowns, [1.0, -2.0], 5)
        np.testing.assert_allclose(back, found.T @ [1.0, -2.0], rtol=1e-13)


# what is refused ------------------------------------------------------------------


@pytest.mark.parametrize(
    "time, size",
    [
        (0.0, 0.5 * STEP),
        (0.0, 1.5 * STEP),
        (0.0, 0.0),
        (0.0, -STEP),
        (0.0, STEP * (1 + 1e-6)),
        (STEP, STEP),
        (0.0, float("nan")),
        (0.0, 1e300),
        (0.0, 11 * STEP),
    ],
)
def test_a_step_that_does_not_fit_is_refused_and_changes_nothing(place, time, size):
    unit = Importer(place)
    unit.enter(stop=10 * STEP)
    unit.set(["a", "b"], [0.4, 0.1])
    unit.leave()
    before = unit.get("y", "w", "past.y[1]")
    with pytest.raises(REFUSED):
        unit.step(time, size)
    assert unit.get("y", "w", "past.y[1]") == before
    unit.step(0.0, 10 * STEP)
    unit.end()


def test_times_that_an_importer_adds_up_fit(place):
    unit = Importer(place)
    begin = 1e4
    unit.enter(begin)
    unit.leave()
    now = begin
    for _ in range(2000):
        later = now + STEP
        unit.step(now, later - now)
        now = later
    unit.step(begin + 2000 * STEP, STEP)
    unit.end()


def test_references_values_and_times_of_day_that_are_wrong_are_refused(unit):
    get, put = (
        (unit.own.getReal, unit.own.setReal)
        if unit.version == 2
        else (unit.own.getFloat64, unit.own.setFloat64)
    )
    with pytest.raises(REFUSED):
        get([9999])
    with pytest.raises(REFUSED):
        get([unit.at["limited.y"]])
    with pytest.raises(REFUSED):
        unit.own.getBoolean([unit.at["y"]])
    with pytest.raises(REFUSED):
        put([unit.at["y"]], [1.0])
    with pytest.raises(REFUSED):
        unit.own.setBoolean([unit.at["limited.y"]], [True])
    for kind in (-1, 4):
        with pytest.raises(REFUSED):
            unit.start(kind)
    before = unit.get("a")
    with pytest.raises(REFUSED):
        put([unit.at["a"], 9999], [3.0, 1.0])
    assert unit.get("a") == before
    with pytest.raises(REFUSED):
        unit.step(0.0, STEP)
    with pytest.raises(REFUSED):
        unit.own.getDirectionalDerivative([unit.at["limited.y"]], [unit.at["a"]], [1.0])
    with pytest.raises(REFUSED):
        unit.own.getDirectionalDerivative([unit.at["y"]], [unit.at["y"]], [1.0])
    unit.leave()
    with pytest.raises(REFUSED):
        unit.start(1)
    with pytest.raises(REFUSED):
        unit.set(["given.y[1]"], [1.0])
    with pytest.raises(REFUSED):
        unit.enter()
    unit.step(0.0, STEP)
    unit.own.terminate()
    with pytest.raises(REFUSED):
        unit.step(STEP, STEP)


def test_another_models_token_makes_no_instance(place):
    with pytest.raises(Exception, match="[Ff]ailed to instantiate"):
        Importer(place, guid="{00000000-0000-0000-0000-000000000000}")


# states and instances -------------------------------------------------------------


def run(unit: Importer, u: np.ndarray, begin: int = 0) -> list[list[float]]:
    rows = []
    for t, now in enumerate(u, start=begin):
        unit.set(["a", "b"], now)
        unit.step(t * STEP, STEP)
        rows.append(unit.get("y", "w", "extrapolated"))
    return rows


def test_a_state_that_was_kept_goes_on_as_before(unit, place):
    u = inputs(30)
    unit.set(["a", "b"], u[0])
    unit.leave()
    run(unit, u[:10])
    state = unit.own.getFMUState()
    packed = unit.own.serializeFMUState(state)
    straight = run(unit, u[10:], 10)
    unit.own.setFMUState(state)
    assert run(unit, u[10:], 10) == straight
    unit.own.freeFMUState(state)
    unit.own.setFMUState(unit.own.deserializeFMUState(packed))
    assert run(unit, u[10:], 10) == straight
    # into a fresh instance, whatever that has done so far
    other = Importer(place)
    other.enter()
    other.own.setFMUState(other.own.deserializeFMUState(packed))
    assert run(other, u[10:], 10) == straight
    for wrong in (b"x" * len(packed), packed[:-1], b""):
        with pytest.raises(REFUSED):
            other.own.deserializeFMUState(wrong)
    other.own.reset()
    other.enter()
    other.set(["a", "b"], u[0])
    other.leave()
    assert run(other, u)[10:] == straight
    other.end()


def test_two_instances_know_nothing_of_each_other(place):
    u = inputs(20)
    alone = []
    for rows in (u, 0.5 * u):
        unit = Importer(place)
        unit.enter()
        unit.leave()
        alone.append(run(unit, rows))
        unit.end()
    one, two = Importer(place), Importer(place)
    for unit in (one, two):
        unit.enter()
        unit.leave()
    found: list[list] = [[], []]
    for t in range(len(u)):
        found[0] += run(one, u[t : t + 1], t)
        found[1] += run(two, 0.5 * u[t : t + 1], t)
    assert found == alone
    one.end()
    two.end()


# sources and proof ----------------------------------------------------------------


def test_without_a_compiler_there_are_sources_and_no_proof(monkeypatch):
    monkeypatch.setattr(pack, "compilers", tuple)
    found = export(network(), records(), to=["fmu2", "fmu3"])
    assert not found.difference
    assert [text[:4] for text in found.left_out] == ["fmu2", "fmu3"]
    for content in found.files.values():
        with zipfile.ZipFile(BytesIO(bytes(content))) as packed:  # type: ignore[arg-type]
            names = packed.namelist()
        assert "sources/model.c" in names
        assert not any(name.startswith("binaries") for name in names)


@pytest.mark.parametrize("version", some((2, 3), 2))
def test_a_binary_that_does_something_else_does_not_come_into_being(
    monkeypatch, version
):
    honest = pack.c99.sources

    def other(program, golden):
        files = honest(program, golden)
        return {k: str(v).replace("exp(x)", "(1.0 + (x))") for k, v in files.items()}

    monkeypatch.setattr(pack.c99, "sources", other)
    with pytest.raises(ExportError, match=rf"FMU {version}\.0 differs from the model"):
        export(network(), records(), to=[f"fmu{version}"])


def test_proof_of_both_versions():
    found = export(network(), records(), to=["fmu2", "fmu3"])
    versions = {"fmu2", "fmu3"}
    more = {f"{v}, addresses of the A2L file" for v in versions} if ELF_HERE else set()
    assert set(found.difference) == versions | more
    assert max(found.difference.values()) < HERE


@pytest.mark.parametrize("version", [2, 3])
def test_a_calibration_tool_writes_where_the_a2l_says(version, tmp_path):
    """By the rules of FMI-LS-XCP 1.0; a coefficient that is written counts in the next
    sample."""
    if not ELF_HERE:
        pytest.skip("binaries of this system are not read")
    net, place = network(), pack.place_of_binary("m", version)
    assert place is not None
    target = Path(place).parent.name
    found = export(net, to=[f"fmu{version}"], name="m")
    path = tmp_path / "m.fmu"
    path.write_bytes(as_bytes(found.files[f"m_fmi{version}.fmu"]))
    folder = "extra/org.fmi-standard.fmi-ls-xcp"
    with zipfile.ZipFile(path) as packed:
        manifest = ET.fromstring(packed.read(f"{folder}/fmi-ls-manifest.xml"))
        text = packed.read(f"{folder}/{target}/m.a2l").decode("iso-8859-1")
        sources = packed.read(f"{folder}/m.a2l").decode("iso-8859-1")
        assert b"once" in packed.read("documentation/fmi-ls-xcp.txt")
        packed.extractall(tmp_path)
    space = "{http://fmi-standard.org/fmi-ls-manifest}fmi-ls-"
    assert manifest.tag == "fmiLayeredStandardManifest"
    assert manifest.get(f"{space}name") == "org.fmi-standard.fmi-ls-xcp"
    assert manifest.get(f"{space}version") == "1.0.0"
    assert str(manifest.get(f"{space}description")).startswith("Layered standard based")
    (interface,) = manifest
    assert interface.tag == "Interface" and interface.get("definition") == "m.a2l"
    assert interface.get("supportsDirectMemoryAccess") == "true"
    assert "/include" not in text.lower()
    assert set(addresses_in(sources).values()) == {0}
    assert 'SYMBOL_LINK "m_in[0]" 0' in sources
    if tool := a2l.a2ltool():
        said = subprocess.run(
            [tool, "--strict", "--check", f"{folder}/{target}/m.a2l"],
            cwd=tmp_path,
            capture_output=True,
            text=True,
        )
        assert said.returncode == 0 and not a2l.complaints(said.stdout + said.stderr)
    program = lower(net, "m")
    path.rename(tmp_path / f"m_fmi{version}.fmu")
    run = fmu_runner(tmp_path, program, version)
    assert run is not None
    u, y = (np.full((9, n), 0.1) for n in (len(program.inputs), len(program.computed)))
    before = run(u, y)
    handle = ctypes.CDLL(str(tmp_path / f"fmi{version}" / "m.so"))
    memory = load_memory(program, tmp_path, version, handle)
    assert memory is not None
    table = max(program.tables, key=lambda t: t.values.size)
    numbers = memory(f"m_{table.name}", table.values.size)
    numbers[:] = [2 * n for n in numbers]
    assert np.abs(run(u, y) - before).max() > 1e-6
    assert not xcp_files(program, {place: b"another kind of binary"})
    numbers[:] = table.values.ravel().tolist()
    np.testing.assert_array_equal(run(u, y), before)


HOST = """
#include <stdio.h>
#include "m_fmi2.c"
static void say(void *e, fmi2String i, fmi2Status s, fmi2String c, fmi2String m, ...)
{
    (void)e; (void)i; (void)s; (void)c; (void)m;
}
int main(void)
{
    fmi2CallbackFunctions f = {say, calloc, free, NULL, NULL};
    fmi2ValueReference in[2] = {0, 1}, all[FMI_AT_TIME], start = FMI_AT_START;
    fmi2Real u[2] = {0.3, 0.1}, v[FMI_AT_TIME], seed[2] = {1, 1}, d[UPPER_REPORTED];
    fmi2Component a = m_fmi2Instantiate("a", fmi2CoSimulation, TOKEN, "", &f, 0, 0);
    fmi2Component b = m_fmi2Instantiate("b", fmi2CoSimulation, TOKEN, "", &f, 0, 0);
    fmi2FMUstate s = NULL;
    char *bytes;
    size_t size;
    int k, wrong = m_fmi2Instantiate(NULL, fmi2CoSimulation, "x", "", &f, 0, 0) != NULL;
    for (k = 0; k < 4; k++) {
        m_fmi2Reset(a);
        m_fmi2SetupExperiment(a, 0, 0.0, 0.0, 0, 0.0);
        m_fmi2EnterInitializationMode(a);
        m_fmi2SetInteger(a, &start, 1, &k);
        m_fmi2SetReal(a, in, 2, u);
        wrong |= m_fmi2ExitInitializationMode(a) != fmi2OK;
        wrong |= m_fmi2DoStep(a, 0.0, 0.5, 1) != fmi2OK;
        wrong |= m_fmi2DoStep(a, 0.5, 0.03, 1) != fmi2Error;
    }
    for (k = 0; k <= FMI_AT_TIME; k++) {
        fmi2ValueReference one = (fmi2ValueReference)k;
        int truth;
        int is_real = k < FMI_AT_LIMITED || k >= FMI_AT_PAST;
        is_real = is_real && k != FMI_AT_START && k != FMI_AT_TIME;
        wrong |= (m_fmi2GetReal(a, &one, 1, v) == fmi2OK) != is_real;
        m_fmi2GetBoolean(a, &one, 1, &truth);
        m_fmi2SetReal(a, &one, 1, v);
    }
    for (k = 0; k < FMI_AT_TIME; k++) {
        all[k] = (fmi2ValueReference)k;
    }
    wrong |= m_fmi2GetReal(a, all, FMI_AT_LIMITED, v) != fmi2OK;
    m_fmi2GetDirectionalDerivative(a, all + FMI_AT_REPORTED, 1, in, 2, seed, d);
    m_fmi2GetFMUstate(a, &s);
    m_fmi2SerializedFMUstateSize(a, s, &size);
    bytes = malloc(size);
    wrong |= m_fmi2SerializeFMUstate(a, s, bytes, size) != fmi2OK;
    wrong |= m_fmi2DeSerializeFMUstate(b, bytes, size - 1, &s) != fmi2Error;
    wrong |= m_fmi2DeSerializeFMUstate(b, bytes, size, &s) != fmi2OK;
    wrong |= m_fmi2SetFMUstate(b, s) != fmi2OK;
    wrong |= m_fmi2DoStep(b, 0.5, 0.1, 1) != fmi2OK;
    m_fmi2FreeFMUstate(b, &s);
    free(bytes);
    m_fmi2FreeInstance(a);
    m_fmi2FreeInstance(b);
    return wrong;
}
"""


@pytest.mark.parametrize("single", [False, True])
def test_sources_linked_statically_are_clean_under_sanitizers(places, tmp_path, single):
    sources = places[2] / "sources"
    (tmp_path / "host.c").write_text(HOST.replace("UPPER_", "M_"))
    words = [compilers()[0], "-std=c99", "-g", "-fsanitize=address,undefined"]
    words += ["-fno-sanitize-recover", "-DFMI2_FUNCTION_PREFIX=m_", f"-I{sources}"]
    words += ["-DM_SINGLE"] if single else []
    words += [str(tmp_path / "host.c"), str(sources / "m.c"), "-lm"]
    subprocess.run([*words, "-o", str(tmp_path / "host")], check=True)
    done = subprocess.run([tmp_path / "host"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_sources_compile_with_the_headers_of_the_standard(place, tmp_path):
    """Those of fmpy in place of ours, as an importer may do."""
    headers = Path(fmpy.__file__).parent / "c-code"
    version = int(place.name[-1])
    for name in ("m.c", "m.h", f"m_fmi{version}.c"):
        (tmp_path / name).write_text((place / "sources" / name).read_text())
    for cc in compilers():
        command = [cc, *WARNING_FLAGS, "-isystem", str(headers), "-c"]
        command += [str(tmp_path / f"m_fmi{version}.c"), "-o", str(tmp_path / "m.o")]
        subprocess.run(command, check=True)


@pytest.mark.slow
def test_fmpy_builds_the_binary_from_the_sources(place, tmp_path):
    import shutil

    from fmpy.build import build_platform_binary

    if shutil.which("make") is None:
        pytest.skip("there is no make here")
    other = tmp_path / place.name
    shutil.copytree(place, other)
    shutil.rmtree(other / "binaries")
    build = tmp_path / "build"
    build.mkdir()
    build_platform_binary(other, build)
    rows = []
    for folder in (place, other):
        unit = Importer(folder)
        unit.enter()
        unit.leave()
        rows.append(run(unit, inputs(20)))
        unit.end()
    np.testing.assert_allclose(rows[0], rows[1], rtol=HERE)


# a measured record ----------------------------------------------------------------


def tanks(measured: Path) -> Dataset:
    """The record for estimation of the cascaded tanks."""
    path = measured / "cascaded_tanks" / "dataBenchmark.csv"
    if not path.exists():
        pytest.skip("the cascaded tanks are not here")
    rows = np.genfromtxt(path, delimiter=",", skip_header=1)[:, [0, 2]]
    return Dataset.from_arrays(
        rows[:, :1],
        rows[:, 1:],
        inputs=(Channel("pump", "V"),),
        outputs=(Channel("level", "V"),),
        sample_time=4.0,
    )


def fitted(data: Dataset) -> Network:
    """A polynomial by least squares one step ahead: nothing to be proud of, but run on
    what was measured."""
    (record,) = data.records
    u, y = record.u[:, 0], record.y[:, 0]
    x = np.stack([u[2:], u[1:-1], y[1:-1], y[:-2]], axis=1)
    rows = [(0, 0), (0, 1), (0, 2), (0, 3), (0, 4), (1, 3), (3, 3)]
    v = np.concatenate([np.ones((len(x), 1)), x / 10.0], axis=1)
    columns = np.prod(v[:, np.array(rows)], axis=2)
    theta = np.linalg.lstsq(columns, y[2:] / 10.0, rcond=None)[0]
    part = common.Part([list(zip(rows, theta.tolist(), strict=True))])
    leaves = (
        np.array([10.0, 10.0]),
        np.array([0.0]),
        np.array([1.1]),
        np.array([u.min(), y.min()]),
        np.array([u.max(), y.max()]),
        np.array(4.0),
    )
    return Network(
        data.channels,
        (0,),
        Variables(((0, 0), (0, 1), (1, 1), (1, 2))),
        (common.output_model(part),),
        *map(jax.device_put, leaves),
    )


@pytest.mark.parametrize("version", some((2, 3), 2))
def test_fmpy_simulates_a_measured_record(tmp_path, measured, version):
    data = tanks(measured)
    net = fitted(data)
    found = export(net, data, to=[f"fmu{version}"], name="tanks")
    assert max(found.difference.values()) < HERE
    path = tmp_path / "tanks.fmu"
    path.write_bytes(bytes(found.files[f"tanks_fmi{version}.fmu"]))  # type: ignore[arg-type]
    (record,) = data.records
    history, step = net.history, 4.0
    u = record.u[history:, 0]
    time = step * np.arange(len(u))
    signals = np.zeros(len(u), dtype=[("time", float), ("pump", float)])
    signals["time"], signals["pump"] = time, u
    start = {"start": 2}
    for k in range(history):
        start[f"given.pump[{k + 1}]"] = record.u[history - 1 - k, 0]
        start[f"given.level[{k + 1}]"] = record.y[history - 1 - k, 0]
    result = fmpy.simulate_fmu(
        str(path),
        stop_time=float(time[-1]),
        output_interval=step,
        start_values=start,
        input=signals,
        output=["level"],
        use_event_mode=version == 3,
    )
    expected = np.asarray(simulate(net, data).value[0])[history:, 0]
    size = np.max(np.abs(expected))
    if version == 2:
        # one sample behind: what a step returns is of its beginning
        np.testing.assert_allclose(result["time"], time, rtol=1e-12)
        off = result["level"][1:] - expected[:-1]
        assert result["level"][0] == pytest.approx(expected[0], rel=HERE)
    else:
        # behind an event's own row, the later of two of the same time
        last = np.append(np.diff(result["time"]) > 0, True)
        np.testing.assert_allclose(result["time"][last], time, rtol=1e-12)
        off = result["level"][last] - expected
    assert np.max(np.abs(off)) < HERE * size
    assert np.std(expected) > 1.0
