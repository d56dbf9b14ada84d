"""Descriptions beside files of any content, and how they are refused."""

import itertools

import pytest

from jaxnarx.data import read

CHANNELS = """
[channels.inputs]
N = "rpm"
TRQ = {column = "Md", unit = "Nm"}
[channels.outputs]
NOx = "ppm"
"""
HEADER = "t,N,Md,NOx,comment\n"


def rows(count=20, start=0.0, sep=","):
    lines = (
        sep.join(
            [f"{0.1 * i:.1f}", f"{1000 + i}", f"{start + i / 8}", f"{i % 7}.5", "x"]
        )
        for i in range(count)
    )
    return "\n".join(lines) + "\n"


def write(folder, content, name="a.csv", data="", records='files = ["*.csv"]'):
    """A description beside one file of this content; the path of the description."""
    if content is not None:
        raw = content if isinstance(content, bytes) else content.encode()
        (folder / name).write_bytes(raw)
    if "time" not in data:
        data += "\nsample_time = 0.1"
    path = folder / "d.toml"
    path.write_text(f"[data]\n{data}\n{CHANNELS}\n[records]\n{records}\n")
    return path


def mixed(text, *ends):
    """`text` with these line ends in turn."""
    ends = itertools.cycle(ends)
    return "".join(line + next(ends) for line in text.splitlines())


def refuse(error, path, *said, **options):
    with pytest.raises(error) as caught:
        read(path, **options)
    for words in said:
        assert words in str(caught.value), str(caught.value)
    return caught.value


def grouped(folder, groups, train='["s*.csv"]', data=""):
    """Three records for training, one for testing."""
    for k, name in enumerate(["s1", "s2", "s3", "t1"]):
        (folder / f"{name}.csv").write_text(HEADER + rows(20 + k))
    records = f'train = {train}\ntest = ["t*.csv"]\ngroups = {groups}'
    return write(folder, None, data=data, records=records)
