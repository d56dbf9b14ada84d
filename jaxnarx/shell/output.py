"""Files that commands write: whole or not at all, never outside the given folder."""

import csv
import io
import json
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxnarx.data import Dataset
from jaxnarx.errors import DataFileError, SpecError

if TYPE_CHECKING:
    from jaxnarx.evaluation import Report
    from jaxnarx.simulation import Trajectories


def slug(name: str) -> str:
    """A name as a file name: letters, digits, dot, dash and underscore only."""
    return re.sub(r"[^A-Za-z0-9._-]+", "_", name).strip("._") or "unnamed"


def run_folder(
    out: str | None, name: str, *, force: bool, mark: str = "model.safetensors"
) -> Path:
    """The folder of a run, made if absent; by default a new one under `runs/`.

    A given folder that already holds `mark` is refused without `force`.
    """
    if out is None:
        base = Path("runs") / slug(name)
        folder, number = base, 1
        while (folder / mark).exists():
            number += 1
            folder = base.with_name(f"{base.name}-{number}")
    else:
        folder = Path(out)
        if (folder / mark).exists() and not force:
            raise SpecError(
                f"{folder} already holds {mark}; choose another --out, or overwrite it "
                "with --force",
                field="out",
            )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataFileError(
            f"{folder}: cannot be made ({error.strerror}); choose another --out",
            path=folder,
        ) from error
    return folder


def write_text(path: Path, text: str) -> None:
    """Write whole or not at all."""
    temporary = path.with_name(path.name + ".tmp")
    temporary.write_text(text, encoding="utf-8")
    os.replace(temporary, path)


def write_report(report: "Report", folder: Path) -> None:
    """`report.json` and `report.html`."""
    write_text(
        folder / "report.json", json.dumps(report.to_dict(), allow_nan=False, indent=1)
    )
    report.to_html(folder / "report.html")


def cell(text: str) -> str:
    """Text that a spreadsheet will not take for a formula."""
    return "'" + text if text[:1] in "=+-@\t\r" else text


def write_trajectories(
    value: "Trajectories", data: Dataset, out: str, *, force: bool
) -> list[Path]:
    """One CSV per record: time, simulated and measured outputs, limited, extrapolated."""
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    stems = [slug(name) for name in value.names]
    paths = [
        folder / f"{stem}{f'-{stems[:n].count(stem) + 1}' if stem in stems[:n] else ''}.csv"
        for n, stem in enumerate(stems)
    ]
    taken = [p for p in paths if p.exists()]
    if taken and not force:
        raise SpecError(
            f"{taken[0]} exists; choose another --out, or overwrite with --force",
            field="out",
        )
    for n, path in enumerate(paths):
        write_text(path, _csv(value, data, n))
    return paths


def _csv(value: "Trajectories", data: Dataset, n: int) -> str:
    record, names = data.records[n], list(value.output_names)
    known = data.channels.output_names
    header = ["time [s]"]
    columns = [np.arange(len(record)) * data.sample_time]
    for o, name in enumerate(names):
        header += [f"{name} simulated", f"{name} measured", f"{name} limited"]
        measured = record.y[:, known.index(name)]
        columns += [value.outputs[n][:, o], measured, value.limited[n][:, o].astype(int)]
    header.append("extrapolated")
    columns.append(value.extrapolated[n].astype(int))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([cell(h) for h in header])
    for row in zip(*(c.tolist() for c in columns), strict=True):
        writer.writerow([f"{x:.10g}" if isinstance(x, float) else x for x in row])
    return text.getvalue()
