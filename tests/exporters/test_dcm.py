"""DCM files: read by another program, and the way back from changed ones."""

import dataclasses
import logging
import re

import common
import jax
import numpy as np
import pytest
import test_targets
from common import A, B, Part

import jaxnarx as jnx
from jaxnarx.data import Channel, Channels
from jaxnarx.errors import DataFileError, SpecError
from jaxnarx.exporters import Instance, export, lower, maps, read_parameters
from jaxnarx.exporters.dcm import dcm_files
from jaxnarx.exporters.parameters import network_tables
from jaxnarx.exporters.target import Files
from jaxnarx.models import Network
from jaxnarx.refinement import attach_certificate


def rising() -> Network:
    """Two outputs that come to rest everywhere: y by regions of a, w by y."""
    slow = [((0, 0, 0), 0.1), ((0, 0, 1), 0.5), ((0, 0, 3), 0.6)]
    quick = [((0, 0, 0), 0.3), ((0, 1, 1), 0.2), ((0, 0, 2), 0.3), ((0, 0, 3), 0.2)]
    first = Part(
        [slow, quick],
        scheduling=((A, 0), (B, 2)),
        offset=(-20.0, -5.0),
        span=(40.0, 10.0),
        centre=((0.3, 0.4), (0.7, 0.6)),
        width=((0.3, 0.35), (0.25, 0.3)),
    )
    second = Part([[((0, 0, 3), 0.2), ((0, 0, 5), 0.5), ((0, 0, 1), 0.1)]])
    return common.network([first, second], (0, 1), bound=100.0)


def bytes_of(files: Files, name: str = "m") -> bytes:
    content = files[f"{name}.dcm"]
    assert isinstance(content, bytes)
    return content


def text_of(net, name: str = "m") -> str:
    """Its DCM file, without the maps' cost."""
    axes = np.full((len(net.modelled), 2), maps.FREE_AXIS)
    bare = dataclasses.replace(lower(net, name), reported=())
    return bytes_of(dcm_files(bare, {"axes": axes[:0]}), name).decode("iso-8859-1")


def leaves(net) -> list[np.ndarray]:
    return [np.asarray(x) for x in jax.tree.leaves(net)]


def same(one, other) -> bool:
    pairs = zip(leaves(one), leaves(other), strict=True)
    return all(np.array_equal(a, b) for a, b in pairs)


KINDS = (
    *("spare", "Boxes", "Compact", "SigmoidTree", "LogSigmoids", "filters", "hidden"),
)
"""Networks of `test_targets`: of every validity function, with unused slots, filters
and hidden channels."""


@pytest.fixture(scope="module")
def written() -> tuple[Network, bytes]:
    net = rising()
    found = export(net, to=["dcm"], name="m")
    assert found.left_out == ()
    return net, bytes_of(dict(found.files))


def test_another_program_reads_the_same(written, tmp_path, caplog):
    reader = pytest.importorskip("dcmReader.dcm_reader")
    net, data = written
    (tmp_path / "m.dcm").write_bytes(data)
    dcm = reader.DcmReader()
    with caplog.at_level(logging.DEBUG):
        dcm.read(str(tmp_path / "m.dcm"), file_encoding="iso-8859-1")
    assert not caplog.records
    blocks = {one.name: one for one in dcm.get_block_parameters()}
    program = lower(net, "m")
    assert set(blocks) == {f"m_{t.name}" for t in program.tables}
    for table in program.tables:
        block = blocks[f"m_{table.name}"]
        assert np.array_equal(block.values, table.values)
        assert block.function == "m" and block.description == table.about
        for column in table.columns:
            assert column in block.comment
    (function,) = dcm.get_functions()
    assert function.name == "m" and "y, w from a, b" in function.description
    first, second = dcm.get_characteristic_maps()
    assert (first.name, second.name) == ("m_rest_y", "m_rest_w")
    assert (first.unit_x, first.unit_y, first.unit_values) == ("V", "", "ppm")
    # at rest: that is what the network's own free run comes to
    for x, y in ((-20.0, -5.0), (4.0, 3.0), (20.0, 5.0)):
        u, names = np.tile([x, y], (300, 1)), common.CHANNELS
        data = jnx.Dataset.from_arrays(
            [u],
            [np.zeros((300, 2))],
            inputs=names.inputs,
            outputs=names.outputs,
            sample_time=0.1,
        )
        run = jnx.simulate(net, data).value[0][-1]
        for o, one in enumerate((first, second)):
            found = np.interp(
                y, list(one.values), [row[x] for row in one.values.values()]
            )
            assert abs(found - run[o]) < 1e-7 * max(1.0, abs(run[o]))


def test_the_same_file_gives_the_same_network(written):
    net, data = written
    assert read_parameters(net, data.decode("iso-8859-1")) is net


@pytest.mark.parametrize("name", KINDS)
def test_every_number_comes_back_and_no_other_moves(name):
    """One of every block, in the file, by 10 %: a new export says what the file said,
    to rounding of the way there and back, and nothing else has moved."""
    net = test_targets.NETWORKS[name]()
    text = text_of(net)
    assert read_parameters(net, text) is net
    tables = {t.name: t.values for t in lower(net).tables}
    assert tables.keys() == network_tables(net).keys()
    for kind, before in tables.items():
        assert before.size
        at = tuple(np.argwhere(before)[-1])
        number = 1.1 * float(before[at])
        head, block, tail = re.split(rf"(m_{kind} .*?END)", text, flags=re.S)
        rows = block.split("  WERT ")
        row = 1 + (at[0] if before.ndim > 1 else 0)
        words = rows[row].split(" ")
        words[at[-1]] = words[at[-1]].replace(repr(float(before[at])), repr(number))
        rows[row] = " ".join(words)
        other = read_parameters(net, head + "  WERT ".join(rows) + tail)
        expected = {k: v.copy() for k, v in tables.items()}
        expected[kind][at] = number
        for table in lower(other).tables:
            # a gate that turns changes its steepness, by which its border is kept
            rtol = 0 if kind != "gate_y" and table.name != kind else 1e-14
            np.testing.assert_allclose(table.values, expected[table.name], rtol=rtol)


def test_one_coefficient_is_one_coefficient(written):
    net, data = written
    text = data.decode("iso-8859-1")
    assert text.count(" 0.5 ") >= 1
    changed = read_parameters(net, re.sub(r"WERT 0\.1 0\.5 ", "WERT 0.1 0.625 ", text))
    old, new = (n.models[0].local.coefficient for n in (net, changed))
    moved = np.asarray(old) != np.asarray(new)
    assert moved.sum() == 1 and np.asarray(new)[moved] == [0.625]
    back = dataclasses.replace(
        changed.models[0],
        local=dataclasses.replace(changed.models[0].local, coefficient=old),
    )
    assert same(net, dataclasses.replace(changed, models=(back, changed.models[1])))


def test_the_source_in_c_comes_back_too(written):
    net, _ = written
    text = str(test_targets.written(net)["m.c"])
    assert read_parameters(net, text) is net
    assert text.count("(m_real)0.625") == 0
    changed = text.replace("(m_real)0.5,", "0.625f, /* was\n 0.5, */", 1)
    (line,) = [k for k, t in enumerate(text.splitlines(), 1) if "(m_real)0.5," in t][:1]
    other = read_parameters(net, changed)
    assert not same(net, other)
    tables = {t.name: t.values for t in lower(net).tables}
    moved = [t.values[t.values != tables[t.name]] for t in lower(other).tables]
    assert [m.tolist() for m in moved if m.size] == [[0.625]]
    broken = changed.replace("0.625f", "half")
    with pytest.raises(DataFileError, match=f"m.c, line {line}: block m_.* has 'half'"):
        read_parameters(net, broken, "m.c")


WRONG = {
    "unknown": (
        r"m_centre_y",
        "m_center_y",
        r"line \d+: block m_center_y is no table.*'m_centre_y'",
    ),
    "foreign map": ("m_rest_w", "n_rest_w", "block n_rest_w is no table"),
    "size": ("m_theta_w 3 @ 1", "m_theta_w 4 @ 1", "m_theta_w says 4 values and has 3"),
    "turned": (
        "m_theta_y 5 @ 2",
        "m_theta_y 2 @ 5",
        "of size 2 @ 5; the model's is 5 @ 2",
    ),
    "text": (
        r"WERT 0\.1 0\.5",
        'WERT 0.1 "a"',
        r"line \d+: block m_theta_y has '\"a\"'",
    ),
    "comma": (r"WERT 0\.1 0\.5", "WERT 0.1 0,5", "'0,5' in place of a finite number"),
    "nan": (r"WERT 0\.1 0\.5", "WERT 0.1 nan", "'nan' in place of a finite number"),
    "huge": (r"WERT 0\.1 0\.5", "WERT 0.1 1e999", "'1e999' in place of a finite"),
    "text block": (r"WERT 0\.1 0\.5.*", 'TEXT "half"', "block m_theta_y has a text in"),
    "no term": (
        r"WERT 0\.1 0\.5 0\.0",
        "WERT 0.1 0.5 0.2",
        "row 1, column 3: the local",
    ),
    "negative": (
        r"WERT 3\.33",
        "WERT -3.33",
        "m_narrowness_y cannot be so: every number",
    ),
    "no end": (
        r"(?s)END\n\nFESTWERTEBLOCK m_theta_y",
        "FESTWERTEBLOCK m_theta_y",
        "has a line 'FESTWERTEBLOCK'",
    ),
    "twice": (r"m_centre_y", "m_theta_w", "m_theta_w"),
    "format": ("FORMAT 2.0", "FORMAT 3.0", "line 5: a DCM file begins with"),
    "field": ("  FUNKTION m", "  FUNCTION m", "has a line 'FUNCTION'"),
    "cut short": (r"(?s)  ST/Y -4.*", "", r"block m_rest_y has no END"),
    "none": (r"(?s)END\n\nFESTWERTEBLOCK.*", "END\n", "holds no table of the model"),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_is_wrong_in_a_file_is_named_with_its_line(written, what):
    net, data = written
    pattern, put, message = WRONG[what]
    text, count = re.subn(pattern, put, data.decode("iso-8859-1"), count=1)
    assert count == 1
    with pytest.raises(DataFileError, match=message) as caught:
        read_parameters(net, text, "changed.dcm")
    assert "changed.dcm" in str(caught.value)


def test_a_network_that_changes_is_not_known_as_it_was():
    net = rising()
    only = dataclasses.replace(net, models=net.models[:1], modelled=(0,))
    steady = attach_certificate(
        dataclasses.replace(only, lower=net.lower[:1], upper=net.upper[:1])
    )
    assert steady.certificate is not None
    text = text_of(steady)
    assert "WERT 0.1 0.5 0.0 0.6" in text
    still = text.replace("WERT 0.1 0.5 0.0 0.6", "WERT 0.1 0.5 0.0 0.7")
    unstable = text.replace("WERT 0.1 0.5 0.0 0.6", "WERT 0.1 0.5 0.0 1.2")
    found = read_parameters(steady, still)
    assert found.certificate is not None and same(found, attach_certificate(found))
    lost = read_parameters(steady, unstable)
    assert lost.certificate is None
    assert not np.array_equal(lost.upper, steady.upper)


def test_of_a_known_model_only_what_has_changed_is_written():
    net = rising()
    text = text_of(net).replace("WERT 0.1 0.5 0.0 0.6", "WERT 0.1 0.5 0.0 0.7")
    moved = read_parameters(net, text)
    files = export(moved, to=["dcm"], name="m", since=net).files
    text = bytes_of(dict(files)).decode("iso-8859-1")
    blocks = re.findall(r"^(?:FESTWERTEBLOCK|KENN\w+) (\S+)", text, re.M)
    assert len(blocks) == 1 and "0.7" in text and "rest_" not in text
    assert same(read_parameters(net, text), moved)
    nothing = export(net, to=["dcm"], name="m", since=net)
    assert "FESTWERTEBLOCK" not in bytes_of(dict(nothing.files)).decode("iso-8859-1")
    short = {"lower": net.lower[:1], "upper": net.upper[:1]}
    only = dataclasses.replace(net, models=net.models[:1], modelled=(0,), **short)
    with pytest.raises(SpecError, match="other tables"):
        export(only, to=["dcm"], name="m", since=net)


def test_what_is_known_of_the_training_is_no_parameter():
    """Of a network with a domain and errors, exported with its intervals."""
    net = test_targets.trusting()
    assert net.errors is not None
    data, to = test_targets.records(net), ["dcm", "c"]
    files = export(net, data, to=to, name="m", level=0.9, verify=False).files
    text = bytes_of(dict(files)).decode("iso-8859-1")
    assert "m_domain_points" in text and "m_doubt_y" in text
    source = files["m.c"]
    assert isinstance(source, str)
    for one in (text, source, text_of(net)):
        assert read_parameters(net, one) is net
    moved = read_parameters(net, re.sub(r"WERT 0\.1 0\.5 ", "WERT 0.1 0.6 ", text))
    assert moved.errors is None and moved.domain is net.domain
    other = re.sub(r"(?s)(m_domain_points.*?WERT )\S+", r"\g<1>9.5", text)
    with pytest.raises(DataFileError, match=r"line \d+: block m_domain_points is what"):
        read_parameters(net, other)


def test_maps_go_over_inputs_that_are_named_or_matter():
    net = rising()
    program = lower(net)
    assert maps.choose_axes(net, program).tolist() == [[0, 1], [-1, -1]]
    over = maps.choose_axes(net, program, ("b", "a"))
    assert over.tolist() == [[1, 0], [1, 0]]
    turned, _ = maps.rest_maps(program, over)
    right, other = maps.rest_maps(program, maps.choose_axes(net, program))
    np.testing.assert_allclose(turned.values.T, right.values, rtol=1e-12)
    assert [port.name for port in other.axes] == ["a", "b"]
    with pytest.raises(SpecError, match="over must name two inputs, got a"):
        maps.choose_axes(net, program, ("a",))
    with pytest.raises(SpecError, match="unknown over 'c'"):
        maps.choose_axes(net, program, ("a", "c"))


def test_an_input_that_was_never_moved_is_no_axis():
    net = rising()
    low = np.asarray(net.low).copy()
    low[B] = net.high[B]
    program = lower(dataclasses.replace(net, low=jax.device_put(low)), "m")
    found = maps.rest_maps(program, maps.choose_axes(net, program))
    assert [[p.name for p in one.axes] for one in found] == [["a"], ["a"]]
    assert found[0].values.shape == (maps.AXIS_POINTS,)
    instance = Instance(program)
    instance.settle(np.array([found[0].points[0][3], 5.0]))
    rest = instance.step(np.array([found[0].points[0][3], 5.0]))["outputs"]
    np.testing.assert_allclose([one.values[3] for one in found], rest, rtol=1e-8)
    text = bytes_of(dcm_files(program, {"axes": maps.choose_axes(net, program)}))
    assert b"KENNLINIE m_rest_y 11\n" in text


def test_names_of_channels_stay_texts_of_latin_letters():
    net = rising()
    odd = 'T " END*/ Ω°'
    channels = Channels(
        (Channel(odd, "µ°Ω"), Channel("b")), (Channel("*y"), Channel("END"))
    )
    text = text_of(dataclasses.replace(net, channels=channels))
    for line in text.splitlines():
        assert line.count('"') in (0, 2, 4)
    assert "T ' END* / ?°" in text
    assert re.findall(r"^FESTWERTEBLOCK ([\w.\[\]]+) ", text, re.M)
    assert read_parameters(net, text_of(net)) is net
