"""Datasets from files: what a description may say, and every way a file may be odd."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as parquet
import pytest
from described import HEADER, grouped, mixed, refuse, rows, write

from jaxnarx.data import read, read_split
from jaxnarx.errors import DataError, DataFileError, SpecError


@pytest.fixture(autouse=True)
def no_environment(monkeypatch):
    monkeypatch.delenv("JAXNARX_DATA", raising=False)


# what works -----------------------------------------------------------------------


def test_a_csv_file_becomes_a_record_of_named_channels(tmp_path):
    data = read(write(tmp_path, HEADER + rows()))
    assert data.names == ["a"] and data.sample_time == 0.1
    assert [c.label for c in data.channels.all] == ["N [rpm]", "TRQ [Nm]", "NOx [ppm]"]
    record = data.records[0]
    np.testing.assert_array_equal(record.u[:, 0], 1000 + np.arange(20.0))
    np.testing.assert_array_equal(record.u[:, 1], np.arange(20) / 8)
    np.testing.assert_array_equal(record.y[:, 0], np.arange(20) % 7 + 0.5)
    assert record.start_row == 2


@pytest.mark.parametrize(
    ("content", "data"),
    [
        (b"\xef\xbb\xbf" + (HEADER + rows()).encode(), ""),
        ((HEADER + rows()).replace("\n", "\r\n"), ""),
        ((HEADER + rows()).replace(",", ";"), ""),
        ((HEADER + rows()).replace(",", "\t"), ""),
        ((HEADER + rows(sep=";")).replace(",", ";").replace(".", ","), 'decimal = ","'),
        (rows(), 'columns = ["t", "N", "Md", "NOx", "comment"]'),
        (b"\xef\xbb\xbf" + rows().encode(), 'columns = ["t","N","Md","NOx","c"]'),
        ("bench 4\n\n" + HEADER + rows(), "skip_rows = 2"),
        (HEADER + "s,rpm,[Nm],ppm,\n" + rows(), "unit_row = true"),
        ((HEADER + rows()).replace(",x", ",°").encode("cp1252"), 'encoding = "cp1252"'),
        (HEADER + rows() + "\n\n", ""),
        (HEADER.replace(",", " , ") + rows(), ""),
        (HEADER + rows(), 'time = "t"'),
        ((HEADER + rows()).encode("utf-16"), 'encoding = "utf-16"'),
        ((HEADER + rows()).replace("\n", "\r"), ""),
        ((HEADER + rows()).replace("\n", "\r\r\n"), ""),
        (("bench 4\n" + HEADER + rows()).replace("\n", "\r\r\n"), "skip_rows = 1"),
        (mixed(HEADER + rows(), "\r", "\n", "\r\n", "\r\r\n"), ""),
        ((HEADER + rows()).replace("1.9,1019,", f"{'9' * 200_000},1019,"), ""),
    ],
)
def test_csv_dialects_read_alike(tmp_path, content, data):
    plain = read(write(tmp_path, HEADER + rows())).records[0]
    record = read(write(tmp_path, content, data=data)).records[0]
    np.testing.assert_array_equal(record.u, plain.u)
    np.testing.assert_array_equal(record.y, plain.y)


def test_parquet_keeps_float32_and_reads_like_csv(tmp_path):
    plain = read(write(tmp_path, HEADER + rows())).records[0]
    table = pa.table(
        {
            "N": pa.array(plain.u[:, 0].astype(np.float32)),
            "Md": pa.array(plain.u[:, 1].astype(np.float32)),
            "NOx": pa.array(plain.y[:, 0].astype(np.float32)),
            "more": pa.array(["x"] * 20),
        }
    )
    parquet.write_table(table, tmp_path / "b.parquet")
    record = read(write(tmp_path, None, records='files = ["b.parquet"]')).records[0]
    assert record.u.dtype == np.float32 and record.start_row == 1
    np.testing.assert_array_equal(record.u, plain.u)


def test_units_of_the_file_fill_in_and_may_not_contradict(tmp_path):
    content = HEADER + "s,rpm,[Nm],mg/m3,\n" + rows()
    path = write(tmp_path, content, data="unit_row = true")
    error = refuse(SpecError, path, "a.csv", "NOx is in 'mg/m3'", "'ppm'")
    assert error.field == "NOx"
    path.write_text(path.read_text().replace('"ppm"', '""'))
    assert read(path).channels.outputs[0].unit == "mg/m3"


def test_parts_in_order_and_names_with_folders_where_they_collide(tmp_path):
    for k, name in enumerate(["x/a", "y/a", "y/b"]):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / f"{name}.csv").write_text(HEADER + rows(20 + k))
    path = write(tmp_path, None, records='test = ["y/a.csv"]\ntrain = ["x/*", "y/b*"]')
    assert read(path).names == ["x/a", "y/b", "y/a"]
    split = read_split(path)
    assert split.train is not None and split.test is not None
    assert split.train.names == ["x/a", "y/b"] and split.validate is None
    assert [len(r) for r in split.test] == [21] and len(split.all) == 3


def test_pieces_of_a_split_file_stay_in_its_part(tmp_path):
    for k, name in enumerate(["a", "b"]):
        text = HEADER + rows(20, start=k)
        (tmp_path / f"{name}.csv").write_text(text.replace(",2.5,x", ",,x"))
    path = write(
        tmp_path,
        None,
        data='missing = "split"',
        records='train = ["a.csv"]\ntest = ["b.csv"]',
    )
    split = read_split(path)
    assert split.train is not None and split.test is not None
    assert split.train.names == ["a#1", "a#2", "a#3", "a#4"]
    assert split.train.records[1].start_row == 5
    assert split.all.names == split.train.names + split.test.names


def test_root_by_argument_before_environment_before_folder(tmp_path, monkeypatch):
    path = write(tmp_path, HEADER + rows(5))
    for name, count in (("arg", 6), ("env", 7)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.csv").write_text(HEADER + rows(count))
    assert read(path).samples == 5
    monkeypatch.setenv("JAXNARX_DATA", str(tmp_path / "env"))
    assert read(path).samples == 7
    assert read(path, root=tmp_path / "arg").samples == 6
    refuse(DataFileError, path, "does not exist", "argument root", root=tmp_path / "no")


# faults of files ------------------------------------------------------------------


def test_missing_samples_name_file_channel_and_line(tmp_path):
    text = (HEADER + rows()).replace("1005,", ",").replace("1009,", "inf,")
    path = write(tmp_path, text)
    error = refuse(
        DataError,
        path,
        "a.csv: N has 1 NaN and 1 inf, first at row 7, counted from 1 with the header",
        "(t = 0.5 s)",
        "missing='mask'",
    )
    assert (error.channel, error.row) == ("N", 5)
    assert (
        not read(write(tmp_path, text, data='missing = "mask"')).records[0].valid.all()
    )


def test_the_named_line_is_the_line_of_the_file(tmp_path):
    text = "made by bench 4\n" + HEADER + "s,rpm,Nm,ppm,\n" + rows()
    text = text.replace("1005,", ",")
    line = next(i for i, s in enumerate(text.split("\n"), 1) if ",," in s and "x" in s)
    path = write(tmp_path, text, data="skip_rows = 1\nunit_row = true")
    refuse(DataError, path, f"first at row {line},")


SEMICOLON = (HEADER + rows(sep=";")).replace(",", ";").replace(".", ",")
FAULTS = {
    "decimal comma": (
        SEMICOLON,
        "",
        ['state decimal = ","', "1: t;N;Md", "2: 0,0;1000"],
    ),
    "decimal comma in comma file": (
        "N,Md,NOx\n" + "1,5,2,5,3,5\n" * 3,
        "",
        ["6 fields under 3 names", "decimal comma", "2: 1,5,2,5"],
    ),
    "wrong delimiter": (
        (HEADER + rows()).replace(",", ";"),
        'delimiter = ","',
        ["no column 'N'", "state the delimiter"],
    ),
    "unit row": (
        HEADER + "s,rpm,Nm,ppm,\n" + rows(),
        "",
        ["line 2 looks like a row of units (rpm, Nm, ppm)", "unit_row = true"],
    ),
    "Windows-1252": (
        (HEADER + rows()).replace(",x", ",20 °C").encode("cp1252"),
        "",
        ["line 2 is not utf-8 (byte 0xB0)", "'", 'encoding = "cp1252"'],
    ),
    "UTF-16": ((HEADER + rows()).encode("utf-16"), "", ['encoding = "utf-16"']),
    "unknown column": (
        (HEADER + rows()).replace("NOx", "NOx1"),
        "",
        ["no column 'NOx'", "Did you mean 'NOx1'"],
    ),
    "double column": (
        HEADER.replace("t,", "N,") + rows(),
        "",
        ["2 columns are named 'N'"],
    ),
    "no header": (
        rows().replace(",x", ",1"),
        "",
        ["no header line", "columns = [...]"],
    ),
    "header too many": (
        HEADER + rows(),
        'columns = ["t", "N", "Md", "NOx", "c"]',
        ["first line is a header", "skip_rows = 1"],
    ),
    "columns do not fit": (
        rows(),
        'columns = ["N", "Md", "NOx"]',
        ["line 1 has 5 fields", "names 3"],
    ),
    "ragged": (
        HEADER + rows(9) + "0.9,1009\n",
        "",
        ["line 11 has 2 fields, expected 5: '0.9,1009'"],
    ),
    "empty line": (HEADER + rows(9) + "\n" + rows(3), "", ["line 11 is empty"]),
    "empty": ("", "", ["the file is empty"]),
    "only a header": (HEADER, "", ["no data rows"]),
    "gzip": (b"\x1f\x8b\x08\0" + bytes(50), "", ["gzip archive", "Unpack it first"]),
    "stray carriage return": (
        HEADER + rows(9) + "0.9,1009,1.1\r,2.5,x\n",
        "",
        ["line 11 has 3 fields, expected 5: '0.9,1009,1.1'"],
    ),
    "stray carriage return in the first rows": (
        HEADER + rows(2) + "0.9,1009,1.1\r,2.5,x\n",
        "",
        ["line 4 has 3 fields, expected 5: '0.9,1009,1.1'"],
    ),
    "empty line, carriage returns": (
        (HEADER + rows(9) + "\n" + rows(3)).replace("\n", "\r"),
        "",
        ["line 11 is empty"],
    ),
    "field too long to cut": (
        HEADER + rows(9) + "1," * 3 + "9" * 140_000 + "\n",
        "",
        ["line 11 cannot be cut into fields", "131072", "'1,1,1,9999"],
    ),
    "line too long": (
        HEADER + rows(9) + "1," * 4 + "9" * 3_000_000 + "\n",
        "",
        ["line 11 "],
    ),
    "many fields": (
        HEADER + rows(9) + "1," * 2_000_000 + "\n",
        "",
        ["line 11 has 2000001 fields, expected 5"],
    ),
    "no line ends": ("1," * 100_000, "", ["first 131,072 bytes", "line 1 goes on"]),
    "UTF-32": (
        (HEADER + rows()).encode("utf-32"),
        'encoding = "utf-32-be"',
        ["not utf-32-be", "State the encoding"],
    ),
    "punycode": (
        (HEADER + rows()).replace("x", "ü-ö"),
        'encoding = "punycode"',
        ["not punycode", "State the encoding"],
    ),
    "binary": (bytes(range(128)) * 3, "", ["binary data"]),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_odd_files_are_refused_with_what_to_do(tmp_path, fault):
    content, data, said = FAULTS[fault]
    error = refuse(DataFileError, write(tmp_path, content, data=data), "a.csv", *said)
    assert Path(str(error.path)).name == "a.csv"


def test_text_channels_are_refused_with_labels_and_line(tmp_path):
    text = HEADER + "".join(f"{i},{g},1,1,x\n" for i, g in enumerate("DNRDN"))
    said = [
        "a.csv: channel N holds text: 'D', 'N', 'R'",
        "at row 2",
        "labels by numbers",
    ]
    error = refuse(DataError, write(tmp_path, text), *said)
    assert error.channel == "N"
    text = (HEADER + rows(9)).replace("1004,", "err,")
    refuse(DataError, write(tmp_path, text), "'err'", "row 6", "Correct these cells")
    # Windows-1252 beyond the beginning of the file, which alone is tried as UTF-8
    late = (HEADER + rows(6000) + "600.0,9°,1,1,x\n").encode("cp1252")
    refuse(DataError, write(tmp_path, late), "N holds text: '9°'", "row 6002")


def test_time_columns_are_checked_with_lines(tmp_path):
    text = (HEADER + rows()).replace("\n0.5,", "\n0.4,")
    path = write(tmp_path, text, data='time = "t"')
    refuse(
        DataError, path, "a.csv", "repeats 0.4 s between rows 6 and 7", "header line"
    )
    text = (HEADER + rows()).replace("\n0.5,", "\n0.53,")
    path = write(tmp_path, text, data='time = "t"')
    refuse(DataError, path, "jitter 30 %", "Resample")
    text = (HEADER + rows()).replace("\n0.5,", "\nnoon,")
    path = write(tmp_path, text, data='time = "t"')
    refuse(DataError, path, "channel t holds text: 'noon'", "must hold seconds")


def test_dates_serve_as_time(tmp_path):
    text = HEADER + "".join(
        f"2024-05-31 12:00:0{i // 10}.{i % 10},{i},{i},{i},x\n" for i in range(20)
    )
    data = read(write(tmp_path, text, data='time = "t"'))
    assert data.sample_time == pytest.approx(0.1, rel=1e-9)


def test_files_of_other_sample_times_are_refused(tmp_path):
    (tmp_path / "b.csv").write_text("t,N,Md,NOx\n0,1,1,1\n0.2,2,2,2\n0.4,1,2,3\n")
    path = write(tmp_path, HEADER + rows(), data='time = "t"')
    refuse(DataError, path, "a.csv", "b.csv", "every 0.1 s", "every 0.2 s")


def test_size_is_limited_before_reading(tmp_path):
    path = write(tmp_path, HEADER + rows(500))
    refuse(DataFileError, path, "a.csv", "over the limit", max_bytes=5e3)
    table = pa.table({n: np.zeros(100_000) for n in ("N", "Md", "NOx")})
    parquet.write_table(table, tmp_path / "b.parquet")
    assert (tmp_path / "b.parquet").stat().st_size < 1e5
    path = write(tmp_path, None, records='files = ["b.parquet"]')
    refuse(DataFileError, path, "b.parquet: about 0.0024 GB when read", max_bytes=1e6)


def test_texts_that_are_called_dat_are_read(tmp_path):
    path = write(tmp_path, HEADER + rows(), name="a.dat", records='files = ["*.dat"]')
    assert read(path).records[0].u[0, 0] == 1000


def test_broken_parquet_and_unknown_kinds(tmp_path):
    (tmp_path / "b.parquet").write_bytes(b"PAR1" + bytes(100))
    path = write(tmp_path, None, records='files = ["b.parquet"]')
    refuse(DataFileError, path, "b.parquet", "cannot be read as Parquet")
    (tmp_path / "b.bin").write_bytes(b"12345678")
    path = write(tmp_path, None, records='files = ["b.bin"]')
    refuse(DataFileError, path, "kind '.bin'", ".csv, .txt, .parquet")
    parquet.write_table(pa.table({"N": [1.0], "Md": [1.0]}), tmp_path / "c.parquet")
    path = write(tmp_path, None, records='files = ["c.parquet"]')
    refuse(DataFileError, path, "no single column 'NOx'", "Did you mean 'N'")


# faults of descriptions -----------------------------------------------------------


@pytest.mark.parametrize(
    ("data", "records", "field", "said"),
    [
        ("sampletime = 1", 'files=["*"]', "data.sampletime", "mean 'sample_time'"),
        ("skip_rows = 1.5", 'files=["*"]', "data.skip_rows", "a whole number, got 1.5"),
        ("unit_row = 1", 'files=["*"]', "data.unit_row", "true or false, got 1"),
        ("columns = [1]", 'files=["*"]', "data.columns", "a list of text"),
        ('missing = "drop"', 'files=["*"]', "missing", "'refuse', 'mask'"),
        ('decimal = ";"', 'files=["*"]', "data.decimal", "decimal must be"),
        ('delimiter = "::"', 'files=["*"]', "data.delimiter", "one character"),
        ("sample_time = -1", 'files=["*"]', "sample_time", "positive finite"),
        ("", 'files = "a.csv"', "records.files", "a list of text, got 'a.csv'"),
        ("", 'tests = ["a.csv"]', "records.tests", "Did you mean 'test'"),
        ("", 'files=["*"]\ntest=["*"]', "records.files", "use either"),
        ("", "train = []", "records", "no file is named"),
        ("", 'files = ["../a.csv"]', "records.files", "leaves the data folder"),
        ("", 'files = ["/tmp/a.csv"]', "records.files", "leaves the data folder"),
        (
            "",
            'train=["a.csv"]\ntest=["*.csv"]',
            "records.test",
            "is in train and in test",
        ),
    ],
)
def test_wrong_settings_name_file_and_field(tmp_path, data, records, field, said):
    path = write(tmp_path, HEADER + rows(), data=data, records=records)
    if data.startswith("sample_time"):
        path.write_text(path.read_text().replace("\nsample_time = 0.1", ""))
    error = refuse(SpecError, path, "d.toml: ", said)
    assert error.field == field


def test_a_pattern_without_files_names_the_folder(tmp_path):
    path = write(tmp_path, HEADER + rows(), records='train = ["b*.csv"]')
    refuse(
        DataFileError, path, "no file matches 'b*.csv'", str(tmp_path), "JAXNARX_DATA"
    )


def test_links_out_of_the_folder_are_refused(tmp_path):
    inner = tmp_path / "inner"
    inner.mkdir()
    (tmp_path / "far.csv").write_text(HEADER + rows())
    (inner / "a.csv").symlink_to(tmp_path / "far.csv")
    refuse(
        SpecError,
        write(inner, None),
        "a.csv, which is, or is a link to, a place outside",
    )


def test_equal_contents_may_not_train_and_test(tmp_path):
    (tmp_path / "b.csv").write_text(HEADER + rows())
    records = 'train = ["a.csv"]\ntest = ["b.csv"]'
    path = write(tmp_path, HEADER + rows(), records=records)
    with pytest.raises(
        SpecError, match="b in test has the same contents as a in train"
    ):
        read_split(path)


def test_descriptions_that_are_none(tmp_path):
    path = tmp_path / "d.toml"
    refuse(DataFileError, path, "cannot be opened")
    path.write_text("[data\n")
    refuse(DataFileError, path, "d.toml: not valid TOML", "line 1")
    path.write_text("[data]\nsample_time = 0.1\n")
    refuse(SpecError, path, "section [channels] is missing")
    path.write_text('[data]\n[channels.outputs]\ny=""\n[records]\nfiles=["a.csv"]')
    (tmp_path / "a.csv").write_text("y\n1\n2\n")
    static = "--input-lags 0 --output-lags --partition tree"
    refuse(SpecError, path, "needs sample_time in seconds", static)
    refuse(SpecError, tmp_path / "a.csv", "takes a TOML description")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x = " + 3000 * "[", "cannot be read as TOML (RecursionError"),
        ("x = " + 5000 * "9", "d.toml: "),
        ("[data]\nsample_time = " + 400 * "9", "data.sample_time must be a number"),
        ("[data]\nsample_time = 0x" + 9000 * "f", "cannot be read as a description"),
        ("[data]\nsample_time = 1e-310", "positive finite"),
        (
            '[data]\nsample_time=1\nroot="a\\u0000"\n[channels.outputs]\ny=""\n'
            '[records]\nfiles=["a"]',
            "does not exist",
        ),
    ],
)
def test_toml_that_trips_the_parser_is_refused_by_name(tmp_path, text, said):
    path = tmp_path / "d.toml"
    path.write_text(text)
    with pytest.raises((DataFileError, SpecError)) as caught:
        read(path)
    assert said in str(caught.value) and len(str(caught.value)) < 500
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize("encoding", ["undefined", "a\\u0000b", "hex", "none", "rot13"])
def test_encodings_that_are_none_for_text_are_refused(tmp_path, encoding):
    path = write(tmp_path, HEADER + rows(), data=f'encoding = "{encoding}"')
    error = refuse(SpecError, path, "d.toml: encoding", "is none for text", "cp1252")
    assert error.field == "data.encoding"


@pytest.mark.parametrize("root", ["../x", "..", "ABSOLUTE", "link"])
def test_a_given_root_is_not_left_by_the_description(tmp_path, root, monkeypatch):
    inner, far = tmp_path / "inner", tmp_path / "x"
    inner.mkdir()
    far.mkdir()
    (far / "a.csv").write_text(HEADER + rows())
    (inner / "link").symlink_to(far)
    root = root.replace("ABSOLUTE", str(far))
    path = write(inner, None, data=f'root = "{root}"', records='files = ["**/a.csv"]')
    said = "data.root names", "outside the data folder"
    assert refuse(SpecError, path, *said, root=inner).field == "data.root"
    odd = write(inner, None, data='root = "a\\u0000"')
    refuse(DataFileError, odd, "cannot be read as a description", root=inner)
    path = write(inner, None, data=f'root = "{root}"', records='files = ["**/a.csv"]')
    # without one, the description says where its files are
    assert read(path).samples == 20
    monkeypatch.setenv("JAXNARX_DATA", str(inner))
    refuse(SpecError, path, *said)


def test_patterns_take_files_away(tmp_path):
    for k, name in enumerate(["s1", "s2", "s3", "cold1", "cold2"]):
        (tmp_path / f"{name}.csv").write_text(HEADER + rows(20 + k))

    def names(*patterns):
        return read(write(tmp_path, None, records=f"train = {list(patterns)}")).names

    assert names("s*.csv", "!s2.csv") == ["s1", "s3"]
    assert names("*.csv", "!cold*", "cold2.csv") == ["s1", "s2", "s3", "cold2"]
    path = write(tmp_path, None, records='train = ["s*.csv", "!s9.csv"]')
    refuse(DataFileError, path, "no file matches 's9.csv'")
    path = write(tmp_path, None, records='train = ["!s1.csv", "s*.csv"]')
    error = refuse(SpecError, path, "no pattern before it has chosen")
    assert error.field == "records.train"
    path = write(tmp_path, None, records='train = ["s*.csv", "!*.csv"]')
    refuse(SpecError, path, "train has no file left")
    path = write(tmp_path, None, records='train = ["s**.csv\\u0000"]')
    with pytest.raises((SpecError, DataFileError), match="d.toml"):
        read(path)


def test_what_a_file_holds_does_not_act_on_the_terminal(tmp_path):
    text = (HEADER + rows()).replace("NOx", "NO\x1b[31m\u202e")
    error = refuse(
        DataFileError, write(tmp_path, text), "no column", "\\x1b", "\\u202e"
    )
    assert str(error).replace("\n", "").isprintable()


# groups ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("groups", "found"),
    [
        ('{cold = ["s1*", "s3.csv"], warm = ["s2*"]}', ["cold", "warm", "cold"]),
        ('[["s1*"], ["s3*", "s2*"]]', ["s1*", "s3*, s2*", "s3*, s2*"]),
        ('{cold = ["s*", "!s2*"]}', ["cold", "", "cold"]),
        ('{all = ["*.csv", "s1*"]}', ["all"] * 3),
        ("{}", [""] * 3),
    ],
)
def test_groups_of_the_description_are_with_the_records(tmp_path, groups, found):
    split = read_split(grouped(tmp_path, groups))
    assert split.train is not None and split.test is not None
    assert [r.group for r in split.train] == found
    assert [r.group for r in split.test] == [""]
    assert [r.group for r in split.all] == [*found, ""]


def test_pieces_of_a_split_file_stay_in_its_group(tmp_path):
    path = grouped(tmp_path, '{cold = ["s1*"]}', data='missing = "split"')
    text = (HEADER + rows()).replace(",2.5,x", ",,x")
    (tmp_path / "s1.csv").write_text(text)
    data = read(path)
    assert [r.group for r in data if r.name.startswith("s1#")] == ["cold"] * 4
    assert {r.group for r in data if not r.name.startswith("s1#")} == {""}


def test_without_parts_all_records_may_be_grouped(tmp_path):
    write(tmp_path, HEADER + rows(), name="b.csv")
    path = write(
        tmp_path, HEADER + rows(), records='files = ["*.csv"]\ngroups = [["b*"]]'
    )
    assert [r.group for r in read(path)] == ["", "b*"]


@pytest.mark.parametrize(
    ("error", "groups", "field", "said"),
    [
        (
            SpecError,
            '{cold = ["s1*"], warm = ["s2*", "*1.csv"]}',
            "records.groups",
            "s1.csv is in the group 'cold' by 's1*' and in 'warm' by '*1.csv'",
        ),
        (SpecError, '["s1*"]', "records.groups", "or a list of such lists"),
        (SpecError, '"s1*"', "records.groups", "must be lists of patterns by name"),
        (SpecError, '{cold = "s1*"}', "records.groups.cold", "a list of text"),
        (SpecError, '[["s1*"], [2]]', "records.groups[1]", "a list of text"),
        (SpecError, "{cold = []}", "records.groups", "'cold' has no pattern"),
        (SpecError, '{"" = ["s1*"]}', "records.groups", "or no name"),
        (SpecError, '{"a\\u001b" = ["s1*"]}', "records.groups", "are seen"),
        (SpecError, '{a = ["../s*"]}', "records.groups.a", "leaves the data folder"),
        (SpecError, '{a = ["s*", "!s*"]}', "records.groups.a", "no file left"),
        (DataFileError, '{a = ["x*"]}', None, "no file matches 'x*'"),
        (
            DataFileError,
            '{a = ["t*"]}',
            None,
            "'t*' (records.groups.a) matches no training record, but t1.csv",
        ),
    ],
)
def test_groups_that_cannot_be_are_refused(tmp_path, error, groups, field, said):
    caught = refuse(error, grouped(tmp_path, groups), "d.toml: ", said)
    assert field is None or caught.field == field


def test_what_several_files_have_alike_is_told_once(tmp_path):
    for name in "abc":
        (tmp_path / f"{name}.csv").write_text(
            "t,N,Md,NOx\ns,rpm,Nm,%\n" + "0,1,2,3\n0.1,2,3,4\n"
        )
    path = write(tmp_path, None, data="unit_row = true")
    path.write_text(path.read_text().replace('"ppm"', '"-"'))
    notes = read(path).notes
    assert len(notes) == 1 and "and 2 more" in notes[0], notes
