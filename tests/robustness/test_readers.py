"""Damaged CSV, Parquet and TOML files, read as a description says."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as parquet
import pytest
from battery import mutate

from jaxnarx.data import (
    Dataset,
    Hampel,
    LowPass,
    RemoveOffset,
    Scale,
    prepare,
    read_split,
)
from jaxnarx.errors import JaxnarxError

pytestmark = pytest.mark.slow

DESCRIPTION = """
[data]
time = "t"
sample_time = 0.1
missing = "mask"
delimiter = ","
decimal = "."
encoding = "utf-8"
skip_rows = 0
unit_row = true
root = "."
[channels.inputs]
N = "rpm"
TRQ = {column = "Md", unit = "Nm"}
[channels.outputs]
NOx = "ppm"
[records]
train = ["a*.csv", "!ab.csv"]
test = ["b.csv"]
"""
SETTINGS = [
    *('missing = "split"', 'missing = "interpolate"', 'encoding = "cp1252"'),
    *('encoding = "utf-16"', 'encoding = "utf-7"', "unit_row = true", "skip_rows = 2"),
    *('delimiter = ";"', 'decimal = ","', 'time_unit = "ms"', 'missing = "refuse"'),
]
VALUES = [
    *("0", "-1", "1.5", "1e-320", "1e999", "nan", "-inf", "true", "[]", "{}", '""'),
    *("0.1", "0.2", "1e9", "9" * 400, "0x" + "f" * 5000, "[1, 2]", '["a.csv"]', "[[]]"),
    *('"a.csv"', '"N"', '"t"', '"."', '".."', '"/etc"', '"a\\u0000b"', '"\\u001b[31m"'),
    *('["**"]', '["**/*"]', '["a**"]', '["!a.csv"]', '["a.csv", "!a.csv"]', '["["]'),
    *(
        '"punycode"',
        '"undefined"',
        '"idna"',
        '"utf-7"',
        '"utf-16"',
        '"hex"',
        '"cp1252"',
    ),
    *(
        '"split"',
        '"interpolate"',
        '"mask"',
        '"ms"',
        '","',
        '";"',
        '"\\n"',
        "1979-05-27",
    ),
    *(
        '{column = "N", unit = "rpm"}',
        "{column = 1}",
        '{unit = ""}',
        '"p.json"',
        "'\"'",
    ),
]
CSV_TOKENS = [
    *(b"\r", b"\r\n", b"\n\n", b"\n", b";", b"\t", b",", b'"', b'""', b"\0"),
    *(b"NaN", b"-inf", b"1e308", b"-1e308", b"1e-320", b"1e999", b"1_0", b"0x1F"),
    *(b"\xff\xfe", b"\xef\xbb\xbf", b"\xb0", b"1,5", b"+1", b"'", b"\x1b[31m"),
    *(b"9" * 400, b"x" * 140_000, b"," * 3000, b"2024-05-31 12:00:00", b"\x85"),
]
TOML_TOKENS = [
    *(b"[" * 3000, b"9" * 5000, b"0x" + b"f" * 5000, b"1e999", b"-1", b"nan", b"inf"),
    *(b"\\u0000", b"\\u001b", b"\\ud800", b'"', b'"""', b"=", b"[", b"]", b"{", b"}"),
    *(b"[[data]]", b"a.b.c = 1\n", b"..", b"/", b"/etc", b"**", b"!", b"*", b"?"),
    *(b"punycode", b"undefined", b"utf-16", b"idna", b"true", b"[1, 2]", b"1979-05-27"),
    *(b"root = '..'\n", b"time = 'x'\n", b"time_unit = 'ms'\n", b"columns = ['N']\n"),
    *(b"preparation = 'p.json'\n", b"skip_rows = 99999999999999999999\n", b"\xff"),
]


def edited(text: str, rng) -> str:
    """`text` with up to three settings that are TOML, but of other values or places."""
    lines = text.split("\n")
    for _ in range(int(rng.integers(1, 4))):
        i, j = rng.integers(0, len(lines), 2)
        key = lines[i].split("=")[0].strip() or "root"
        if rng.random() < 0.8 and not key.startswith("["):
            lines[i] = f"{key} = {VALUES[rng.integers(0, len(VALUES))]}"
        elif rng.random() < 0.5:
            lines[i], lines[j] = lines[j], lines[i]
        else:
            lines[i] = ""
    return "\n".join(lines)


def table(rng, rows=40) -> pa.Table:
    x = rng.standard_normal((3, rows)).round(3)
    t = (0.1 * np.arange(rows)).round(1)
    return pa.table({"t": t, "N": x[0], "Md": x[1], "NOx": x[2]})


def csv_bytes(rng, rows=40) -> bytes:
    lines = [",".join(map(repr, row.values())) for row in table(rng, rows).to_pylist()]
    return "\n".join(["t,N,Md,NOx", "s,rpm,Nm,ppm", *lines, ""]).encode()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A description that is read, with its files."""
    monkeypatch.delenv("JAXNARX_DATA", raising=False)
    rng = np.random.default_rng(1)
    for name in ("a.csv", "ab.csv", "b.csv"):
        (tmp_path / name).write_bytes(csv_bytes(rng))
    (tmp_path / "p.json").write_text('{"steps": []}')
    (tmp_path / "d.toml").write_text(DESCRIPTION)
    read_split(tmp_path / "d.toml")
    return tmp_path


def require_usable(data: Dataset):
    """What is read is finite, in shape, and named so that it can be shown."""
    assert 0 < data.sample_time < np.inf and data.samples > 0
    for record in data:
        width = len(data.channels.inputs), len(data.channels.outputs)
        assert (record.u.shape[1], record.y.shape[1]) == width
        assert record.valid.shape == (len(record), sum(width))
        assert np.isfinite(record.u).all() and np.isfinite(record.y).all()
    texts = [*data.names, *data.channels.names, *(c.unit for c in data.channels.all)]
    assert all(text.isprintable() for text in texts)


def read_all(folder):
    try:
        require_usable(read_split(folder / "d.toml", root=folder).all)
    except JaxnarxError as error:
        assert str(error).replace("\n", "").isprintable() and len(str(error)) < 3000
        raise


def test_damaged_csv(folder, battery):
    def attempt(rng):
        (folder / "a.csv").write_bytes(mutate(csv_bytes(rng), rng, CSV_TOKENS))
        text = DESCRIPTION
        if rng.random() < 0.5:
            setting = SETTINGS[rng.integers(0, len(SETTINGS))]
            kept = [s for s in text.split("\n") if s.split("=")[0] not in setting]
            text = "\n".join(kept).replace("[data]", f"[data]\n{setting}")
        (folder / "d.toml").write_text(text)
        read_all(folder)

    ends = battery.run(attempt)
    assert battery.cases < 100 or {"done", "DataFileError", "DataError"} <= set(ends)


def test_damaged_descriptions(folder, battery):
    def attempt(rng):
        raw = edited(DESCRIPTION, rng).encode()
        if rng.random() < 0.4:
            raw = mutate(raw, rng, TOML_TOKENS)
        (folder / "d.toml").write_bytes(raw)
        read_all(folder)

    ends = battery.run(attempt)
    assert battery.cases < 100 or {"done", "DataFileError", "SpecError"} <= set(ends)


def test_damaged_preparations(folder, battery):
    steps = [Hampel(), LowPass(cutoff=1.0), RemoveOffset(), Scale()]
    prepared = prepare(read_split(folder / "d.toml").all, steps)[1]
    text = json.dumps(prepared.to_dict())
    described = DESCRIPTION.replace("[data]", '[data]\npreparation = "p.json"')
    (folder / "d.toml").write_text(described)

    def attempt(rng):
        tokens = [
            b"[" * 9000,
            b"null",
            b"1e999",
            b"NaN",
            b"{",
            b"}",
            b'""',
            b"9" * 5000,
        ]
        (folder / "p.json").write_bytes(mutate(text.encode(), rng, tokens))
        read_all(folder)

    ends = battery.run(attempt)
    assert battery.cases < 100 or {"done", "DataFileError"} <= set(ends)


def odd_column(rng, rows: int):
    """A column of some type that files may have in the place of a number's."""
    x = rng.standard_normal(rows)
    made = [
        lambda: pa.array(x.astype(np.float32)),
        lambda: pa.array(x.astype(np.float16)),
        lambda: pa.array((1e9 * x).astype(np.int64)),
        lambda: pa.array(rng.integers(0, 2**64 - 1, rows, np.uint64)),
        lambda: pa.array(x > 0),
        lambda: pa.array([str(v) for v in x]),
        lambda: pa.array([str(v) for v in x], pa.large_string()),
        lambda: pa.array([v.tobytes() for v in x], pa.binary(8)),
        lambda: pa.array(["D", "N"] * (rows // 2)).dictionary_encode(),
        lambda: pa.nulls(rows, [pa.null(), pa.string(), pa.int8()][rng.integers(0, 3)]),
        lambda: pa.array([[v, v] for v in x]),
        lambda: pa.array([{"a": v} for v in x]),
        lambda: pa.array([[("k", v)] for v in x], pa.map_(pa.string(), pa.float64())),
        lambda: pa.array((1e3 * x).astype(np.int64), pa.timestamp("ms")),
        lambda: pa.array((1e18 * x).astype(np.int64), pa.duration("ns")),
        lambda: pa.array((1e3 * np.abs(x)).astype(np.int32), pa.time32("s")),
        lambda: pa.array((1e3 * x).astype(np.int32), pa.date32()),
        lambda: pa.array((1e6 * x).astype(np.int64)).cast(pa.decimal128(38, 5)),
        lambda: pa.array(x * 10.0 ** rng.integers(-320, 308)),
        lambda: pa.array(np.where(x > 1, np.inf, x)),
        lambda: pa.array([None if v > 0 else v for v in x]),
    ]
    return made[rng.integers(0, len(made))]()


def test_damaged_parquet(folder, battery):
    parts = '[records]\ntrain = ["a.parquet"]\n'
    text = DESCRIPTION.split("[records]")[0] + parts
    (folder / "d.toml").write_text(text.replace("unit_row = true", ""))
    path = folder / "a.parquet"

    def attempt(rng):
        whole = table(rng)
        for name in rng.choice(whole.column_names, rng.integers(0, 3)):
            at = whole.column_names.index(name)
            whole = whole.set_column(at, name, odd_column(rng, len(whole)))
        codec = ["none", "snappy", "zstd", "gzip", "lz4"][rng.integers(0, 5)]
        parquet.write_table(
            whole,
            path,
            compression=codec,
            use_dictionary=bool(rng.integers(0, 2)),
            row_group_size=int(rng.integers(5, 50)),
            data_page_version=["1.0", "2.0"][rng.integers(0, 2)],
        )
        if rng.random() < 0.7:
            path.write_bytes(mutate(path.read_bytes(), rng))
        read_all(folder)

    ends = battery.run(attempt)
    assert battery.cases < 100 or {"done", "DataFileError", "DataError"} <= set(ends)
