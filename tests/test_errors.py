"""The guard at the edge of every reader."""

import csv
import json
import tomllib

import pyarrow as pa
import pytest

from jaxnarx.errors import DataFileError, ModelFileError, SpecError, guard_reading

DEEP = "[" * 100_000


@pytest.mark.parametrize(
    "parse",
    [
        lambda: tomllib.loads("x = " + DEEP),
        lambda: json.loads(DEEP),
        lambda: int("9" * 5_000),
        lambda: float(10**400),
        lambda: b"\xff".decode(),
        lambda: {}["a"],
        lambda: [][1],
        lambda: next(csv.reader(["x" * 200_000])),
        lambda: pa.array([1], pa.int64()).cast("no type"),
        lambda: pa.ipc.open_file(pa.py_buffer(b"junk")),
        lambda: "ab".decode(),  # type: ignore[attr-defined]
        lambda: open("a\0b"),
    ],
)
@pytest.mark.parametrize("error", [DataFileError, ModelFileError])
def test_whatever_a_parser_raises_names_the_file_and_what_to_do(parse, error):
    with pytest.raises(error) as caught:
        with guard_reading("a.x", "an X file", error=error, advice="Do this."):
            parse()
    assert caught.value.path == "a.x" and caught.value.__cause__ is not None
    said = str(caught.value)
    assert said.startswith("a.x: cannot be read as an X file (")
    assert said.endswith(" Do this.") and "\n" not in said and len(said) < 300


def test_a_file_that_cannot_be_opened_says_why(tmp_path):
    with pytest.raises(DataFileError, match=r"cannot be opened \(No such file"):
        with guard_reading(tmp_path / "a"):
            open(tmp_path / "a")


@pytest.mark.parametrize(
    "own", [SpecError("s", field="f"), KeyboardInterrupt(), MemoryError(), SystemExit()]
)
def test_own_errors_interrupts_and_lack_of_memory_pass_as_they_are(own):
    with pytest.raises(type(own)) as caught:
        with guard_reading("a"):
            raise own
    assert caught.value is own
