"""A2L files: read by another program, which finds the symbols of the C files."""

import dataclasses
import re
import subprocess

import numpy as np
import pytest
import test_dcm
from test_targets import written

from jaxnarx.data import Channel, Channels
from jaxnarx.errors import SpecError
from jaxnarx.exporters import ExportError, a2l, export, lower, runners

needs_a2ltool = pytest.mark.skipif(a2l.a2ltool() is None, reason="there is no a2ltool")

MAIN = """#include "m.h"
m_state s;
m_real m_in[M_INPUTS];
m_out m_now;
int main(void)
{
    m_step(&s, m_in, &m_now);
    return 0;
}
"""


def write(folder, files) -> None:
    for name, content in files.items():
        data = content if isinstance(content, bytes) else content.encode()
        (folder / name).write_bytes(data)


@needs_a2ltool
@pytest.mark.skipif(runners.compiler() is None, reason="there is no C compiler")
def test_a_tool_finds_every_symbol_in_a_program(tmp_path):
    net = test_dcm.rising()
    write(tmp_path, written(net, "c") | written(net, "a2l"))
    (tmp_path / "main.c").write_text(MAIN)
    build = "cc -std=c99 -g -DM_SINGLE m.c main.c -lm -no-pie -o m.elf"
    subprocess.run(build.split(), cwd=tmp_path, check=True)
    tool = a2l.a2ltool()
    assert tool is not None
    words = "m.a2l --elffile m.elf --update ADDRESSES --output linked.a2l -v"
    said = subprocess.check_output([tool, *words.split()], cwd=tmp_path, text=True)
    program = lower(net, "m")
    tables = len(program.tables)
    measured = len(program.inputs) + len(program.reported) + len(program.flags)
    assert f"characteristic: {tables} updated, 0 not found" in said
    assert f"measurement: {measured} updated, 0 not found" in said
    linked = (tmp_path / "linked.a2l").read_text()
    listed = subprocess.check_output(["nm", "m.elf"], cwd=tmp_path, text=True)
    at = {n: int(a, 16) for a, _, n in re.findall(r"^(\w+) (\w) (\w+)$", listed, re.M)}
    for table in program.tables:
        found = re.search(
            rf'CHARACTERISTIC m_{table.name} ".*?" VAL_BLK 0x(\w+)', linked
        )
        assert found is not None and int(found[1], 16) == at[f"m_{table.name}"]
    found = re.search(r"MEASUREMENT m_out_w .*?ECU_ADDRESS 0x(\w+)", linked, re.S)
    # the second number of single precision in the structure
    assert found is not None and int(found[1], 16) == at["m_now"] + 4


@needs_a2ltool
def test_the_proof_reads_what_the_tool_says(tmp_path):
    net = test_dcm.rising()
    odd = '*/ "x\\ Ω'
    channels = Channels(
        (Channel(odd, '"°'), Channel("/* b")), (Channel("y", "ppm"), Channel("w"))
    )
    net = dataclasses.replace(net, channels=channels)
    found = export(net, to=["a2l"], name="m")
    assert found.difference == {"a2l, checked by a2ltool": 0.0}
    data = found.files["m.a2l"]
    assert isinstance(data, bytes)
    write(tmp_path, {"m.a2l": data.replace(b"m_numbers 0", b"m_others 0", 1)})
    with pytest.raises(ExportError, match="non-existent RECORD_LAYOUT m_others"):
        a2l.prove_a2l(lower(net, "m"), tmp_path, ())
    write(tmp_path, {"m.a2l": data[: len(data) // 2]})
    with pytest.raises(ExportError, match="a2ltool says"):
        a2l.prove_a2l(lower(net, "m"), tmp_path, ())


def test_without_the_tool_it_is_not_proven(monkeypatch):
    monkeypatch.setattr(a2l, "a2ltool", lambda: None)
    found = export(test_dcm.rising(), to=["a2l"])
    assert found.left_out == ("a2l: there is no a2ltool here",)
    assert not found.difference


def test_sizes_are_those_of_the_tables():
    program = lower(test_dcm.rising(), "m")
    data = a2l.a2l_files(program, {})["m.a2l"]
    assert isinstance(data, bytes)
    text = data.decode("iso-8859-1")
    for table in program.tables:
        found = re.search(
            rf"CHARACTERISTIC m_{table.name} .*?DIM ([\d ]+)\n", text, re.S
        )
        assert found is not None
        sizes = [int(w) for w in found[1].split()]
        assert sizes == list(np.shape(table.values))[::-1]
    with pytest.raises(SpecError, match="no target 'a3l'"):
        export(test_dcm.rising(), to=["a3l"])
