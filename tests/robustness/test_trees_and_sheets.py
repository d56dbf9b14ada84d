"""Links in HDF5 trees and far cells of spreadsheets: refused or read, in little memory.

Peaks of memory are those of the process that reads.
"""

import zipfile
from pathlib import Path

import numpy as np
import pytest
from battery import MEMORY_IS_TOLD

from jaxnarx.data.readers import contents, read_table, sandbox
from jaxnarx.data.readers.columns import Asked
from jaxnarx.errors import DataFileError, JaxnarxError

h5py = pytest.importorskip("h5py")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not MEMORY_IS_TOLD, reason="the system tells no memory"),
]

ASKED = Asked(max_bytes=200e6)
MEGABYTES = 900
"""Peak of the process that reads: its libraries, and twice what may be asked."""
SECRET = 123456.75
"""What the file holds that no other may lead to."""


def peak() -> float:
    """Of the reading process since it was last asked [MB]."""
    process = sandbox._READING_PROCESS[0]._process
    if process is None or process.poll() is not None:
        return 0.0
    place = Path(f"/proc/{process.pid}")
    lines = place.joinpath("status").read_text().splitlines()
    place.joinpath("clear_refs").write_text("5")
    return next(float(s.split()[1]) for s in lines if s.startswith("VmHWM")) / 1e3


def read_all(path: Path) -> None:
    """All columns of a file; none may be those of another."""
    try:
        columns = contents(path, ASKED)
        names = [c.name for c in columns if c.rows][:20]
        if names:
            table = read_table(path, names, ASKED)
            for column in table.columns.values():
                values = column.to_numpy(zero_copy_only=False)
                assert SECRET not in values[:100].tolist()
    except JaxnarxError as error:
        assert path.name in str(error) and len(str(error)) < 3000
        raise
    finally:
        most = peak()
        assert most < MEGABYTES, f"{most:.0f} MB in the process that reads"


def pick(rng, options):
    return options[int(rng.integers(len(options)))]


# HDF5 ---------------------------------------------------------------------------------


def plant(file, place: str, rng: np.random.Generator, other: Path) -> str:
    """Something at a place of a tree; the answer is what must be refused."""
    kind = pick(rng, KINDS)
    if kind == "data":
        file[place] = rng.standard_normal(int(rng.integers(0, 50)))
    elif kind == "cube":
        file[place] = rng.standard_normal((3, 4, 2))
    elif kind == "text":
        file[place] = [b"a", b"b"]
    elif kind == "bomb":
        shape = (int(10 ** rng.uniform(5, 9.5)),)
        file.create_dataset(place, shape, "f8", chunks=(10**5,), compression="gzip")
    elif kind == "vast":
        file.create_dataset(place, (10**7, 10**7), "f8", chunks=(100, 100))
    elif kind == "group":
        file.create_group(place)
    elif kind == "soft":
        file[place] = h5py.SoftLink(pick(rng, ("/", "/g", "/no/such", place, "/x0")))
    elif kind == "hard":
        own = [g for g in file if isinstance(file.get(g, getlink=True), h5py.HardLink)]
        file[place] = file[pick(rng, ["/", *own])]
    elif kind == "link":
        file[place] = h5py.ExternalLink(pick(rng, (other.name, str(other))), "x")
    elif kind == "storage":
        held = [(str(other), 0, 80)]
        file.create_dataset(place, (10,), "f8", external=held)
    else:
        layout = h5py.VirtualLayout(shape=(5,), dtype="f8")
        layout[:] = h5py.VirtualSource(str(other), "x", shape=(5,))
        file.create_virtual_dataset(place, layout)
    return kind


def is_group(file, name: str) -> bool:
    """Whether it is a group of the file's own."""
    link = file.get(name, getlink=True)
    return isinstance(link, h5py.HardLink) and isinstance(file[name], h5py.Group)


OUTSIDE = ("link", "storage", "virtual")
KINDS = ("data", "cube", "text", "bomb", "vast", "group", "soft", "hard", *OUTSIDE)
KINDS = ("data", "group", *KINDS)


@pytest.mark.parametrize("suffix", [".h5", ".mat"])
def test_trees_of_links(suffix, battery, tmp_path):
    other = tmp_path / "other.h5"
    with h5py.File(other, "w") as file:
        file["x"] = np.full(5, SECRET)

    def attempt(rng):
        path = tmp_path / f"a{suffix}"
        block = 512 if suffix == ".mat" else 0
        planted = []
        with h5py.File(path, "w", userblock_size=block) as file:
            for n in range(int(rng.integers(1, 12))):
                groups = [g for g in file if is_group(file, g)]
                parent = pick(rng, ["", *(f"{g}/" for g in groups)])
                planted.append(plant(file, f"{parent}x{n}", rng, other))
        if block:
            with path.open("r+b") as raw:
                raw.write(b"MATLAB 7.3 MAT-file".ljust(512, b" "))
        if set(planted) & set(OUTSIDE):
            with pytest.raises(DataFileError):
                read_all(path)
        else:
            read_all(path)

    battery.run(attempt, seconds=20, megabytes=600)


# Spreadsheets -------------------------------------------------------------------------

BOOK = {
    "[Content_Types].xml": '<?xml version="1.0"?><Types xmlns="http://schemas.openxml'
    'formats.org/package/2006/content-types"><Default Extension="xml" ContentType='
    '"application/xml"/><Default Extension="rels" ContentType="application/vnd.open'
    'xmlformats-package.relationships+xml"/><Override PartName="/xl/workbook.xml" '
    'ContentType="application/vnd.openxmlformats-officedocument.spreadsheetml.sheet'
    '.main+xml"/></Types>',
    "_rels/.rels": '<Relationships xmlns="http://schemas.openxmlformats.org/package/'
    '2006/relationships"><Relationship Id="r1" Type="http://schemas.openxmlformats.org'
    '/officeDocument/2006/relationships/officeDocument" Target="xl/workbook.xml"/>'
    "</Relationships>",
    "xl/workbook.xml": '<workbook xmlns="http://schemas.openxmlformats.org/spreadsheet'
    'ml/2006/main" xmlns:r="http://schemas.openxmlformats.org/officeDocument/2006/'
    'relationships"><sheets><sheet name="S" sheetId="1" r:id="r1"/></sheets>'
    "</workbook>",
    "xl/_rels/workbook.xml.rels": '<Relationships xmlns="http://schemas.openxmlformats'
    '.org/package/2006/relationships"><Relationship Id="r1" Type="http://schemas.open'
    'xmlformats.org/officeDocument/2006/relationships/worksheet" Target="worksheets/'
    'sheet1.xml"/></Relationships>',
}
MAIN = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"


def letters(column: int) -> str:
    """`1` is A, `27` is AA."""
    text = ""
    while column:
        column, rest = divmod(column - 1, 26)
        text = chr(65 + rest) + text
    return text


def far(rng: np.random.Generator, most: int) -> int:
    """A number up to `most` and a little beyond it; small ones as often as large."""
    return int(np.exp(rng.uniform(0, np.log(1.2 * most))))


def xlsx(path: Path, rng: np.random.Generator) -> None:
    """Few cells, some far away; places are told by cells, by rows, or by neither."""
    rows = []
    for _ in range(int(rng.integers(1, 6))):
        row, cells = far(rng, 1_048_576), []
        for _ in range(int(rng.integers(1, 4))):
            place = f' r="{letters(far(rng, 16_384))}{row}"'
            style = ' s="0"' if rng.random() < 0.3 else ""
            place = "" if rng.random() < 0.2 else place
            both = style + place if rng.random() < 0.5 else place + style
            cells.append(f"<c{both}><v>1</v></c>")
        where = f' r="{row}"' if rng.random() < 0.8 else ""
        rows.append(f"<row{where}>{''.join(cells)}</row>")
    size = pick(rng, ("", '<dimension ref="A1:XFD1048576"/>', '<dimension ref="A1"/>'))
    text = f'<worksheet xmlns="{MAIN}">{size}<sheetData>{"".join(rows)}</sheetData>'
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in BOOK.items():
            archive.writestr(name, content)
        archive.writestr("xl/worksheets/sheet1.xml", text + "</worksheet>")


FLOAT = ' office:value-type="float" office:value="1"'


def ods(path: Path, rng: np.random.Generator) -> None:
    """Rows and cells that are repeated, with values and without."""
    space = "urn:oasis:names:tc:opendocument:xmlns"
    rows = []
    for _ in range(int(rng.integers(1, 6))):
        cells = []
        for _ in range(int(rng.integers(1, 5))):
            filled = ' office:value-type="float" office:value="1"' * (
                rng.random() < 0.5
            )
            times = f' table:number-columns-repeated="{far(rng, 16_384)}"'
            times = times if rng.random() < 0.5 else ""
            cells.append(f"<table:table-cell{filled}{times}/>")
        times = f' table:number-rows-repeated="{far(rng, 1_048_576)}"'
        times = times if rng.random() < 0.5 else ""
        rows.append(f"<table:table-row{times}>{''.join(cells)}</table:table-row>")
    text = (
        f'<office:document-content xmlns:office="{space}:office:1.0" '
        f'xmlns:table="{space}:table:1.0"><office:body><office:spreadsheet>'
        f'<table:table table:name="S">{"".join(rows)}</table:table>'
        "</office:spreadsheet></office:body></office:document-content>"
    )
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        kind = "application/vnd.oasis.opendocument.spreadsheet"
        archive.writestr("mimetype", kind)
        archive.writestr("content.xml", text)
        archive.writestr("META-INF/manifest.xml", "<manifest/>")


@pytest.mark.parametrize("write", [xlsx, ods])
def test_far_cells(write, battery, tmp_path):
    path = tmp_path / f"a.{write.__name__}"

    def attempt(rng):
        write(path, rng)
        read_all(path)

    ends = battery.run(attempt, seconds=20, megabytes=600)
    assert battery.cases < 100 or {"done", "DataFileError"} <= set(ends)
