"""Files that commands write: whole or not at all, never outside the given folder."""

import errno
import itertools
import json
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from jaxnarx.data import Dataset
from jaxnarx.errors import DataFileError, SpecError
from jaxnarx.files import unwritable
from jaxnarx.shell.formats import Values, table_csv, write_text
from jaxnarx.shell.unfinished import UNFINISHED_PREFIX, folders_in_use, new_folder

if TYPE_CHECKING:
    from jaxnarx.confidence import Intervals
    from jaxnarx.evaluation import Report
    from jaxnarx.inverse import Tracking
    from jaxnarx.simulation import Trajectories


RUN_FILES = ("model.safetensors", "report.json", "report.html")
"""Files of a run; one that is there already is not overwritten without --force."""


def slug(name: str) -> str:
    """A name as a file name: letters, digits, dot, dash and underscore only."""
    return re.sub(r"[^A-Za-z0-9._-]+", "_", name).strip("._")[:100] or "unnamed"


@contextmanager
def run_folder(
    out: str | None,
    name: str,
    *,
    force: bool,
    marks: Sequence[str],
    by: str = "out",
) -> Iterator[Path]:
    """The folder of a run, made if absent; by default a new one under `runs/`.

    A given folder that already holds one of the files `marks` is refused without
    `force`, and always one in which another run is making one of them; so is one that
    cannot be written, before any work is done. Folders made here are removed again when
    the run fails and they are empty. `by` is the option that names the folder.
    """
    made: list[Path] = []
    try:
        with ExitStack() as stack:
            try:
                if out is None:
                    folder = _make_new(Path("runs") / slug(name), made)
                else:
                    _make(folder := Path(out), made)
                stack.enter_context(new_folder(folder, marks, by))
            except OSError as error:
                raise DataFileError(
                    f"{error.filename if out is None else out}: cannot be written "
                    f"({error.strerror}). Choose another --{by}.",
                    path=out,
                ) from error
            taken = [mark for mark in marks if os.path.lexists(folder / mark)]
            if taken and not force:
                raise SpecError(
                    f"{folder} already holds {taken[0]}; choose another --{by}, or "
                    "overwrite it with --force",
                    field=by,
                )
            yield folder
    except BaseException:
        for path in reversed(made):
            with suppress(OSError):
                path.rmdir()
        raise


def _make(folder: Path, made: list[Path]) -> None:
    """Make `folder` and its parents; `made` is told which."""
    absent = [p for p in (folder, *folder.parents) if not p.exists()]
    for path in reversed(absent):
        path.mkdir(exist_ok=True)
        made.append(path)
    if not folder.is_dir():
        raise NotADirectoryError(
            errno.ENOTDIR, "it is a file, not a folder", str(folder)
        )


def _make_new(base: Path, made: list[Path]) -> Path:
    """Make the first of base, base-2, ... that is free: no two runs share one.

    What killed runs have left beside it is cleared first.
    """
    _make(base.parent, made)
    for other in base.parent.iterdir():
        if any(other.glob(UNFINISHED_PREFIX + "*")) and not folders_in_use(other):
            with suppress(OSError):  # where there is more in it
                other.rmdir()
    number = 1
    while True:
        folder = base if number == 1 else base.with_name(f"{base.name}-{number}")
        try:
            folder.mkdir()
        except FileExistsError:
            number += 1
        else:
            made.append(folder)
            return folder


@contextmanager
def write_together(folder: Path) -> Iterator[Path]:
    """A place to write files to; they move into `folder` when all are complete.

    Whatever happens before that, `folder` is left as it was.
    """
    try:
        with new_folder(folder) as place:
            yield place
            for path in sorted(place.iterdir()):
                os.replace(path, folder / path.name)
    except OSError as error:
        raise unwritable(folder, error) from error


def write_report(report: "Report", folder: Path) -> None:
    """`report.json` and `report.html`."""
    write_text(
        folder / "report.json", json.dumps(report.to_dict(), allow_nan=False, indent=1)
    )
    report.to_html(folder / "report.html")


def file_names(names: Sequence[str], suffix: str = ".csv") -> list[str]:
    """A file name for every record; no two alike, even where case is ignored."""
    files: list[str] = []
    for name in names:
        stem, taken = slug(name.removesuffix(".csv")), {f.lower() for f in files}
        ends = (f"{'' if n == 1 else f'-{n}'}{suffix}" for n in itertools.count(1))
        tries = (stem + end for end in ends)
        files.append(next(f for f in tries if f.lower() not in taken))
    return files


def trajectory_columns(
    value: "Trajectories",
    data: Dataset,
    n: int,
    kind: str,
    index: Float[np.ndarray, " time"] | None = None,
    bounds: "Intervals | None" = None,
) -> dict[str, Values]:
    """Record `n` as columns: time, computed and measured outputs, limited, held, their
    intervals where they are given, extrapolated, and the index of the model's domain
    where there is one.

    `kind` heads the computed outputs, `"simulated"`; missing measurements are NaN.
    """
    record, names = data.records[n], list(value.output_names)
    known, inputs = data.channels.output_names, len(data.channels.inputs)
    found = {"time [s]": Values(np.arange(len(record)) * data.sample_time, "s")}
    for o, name in enumerate(names):
        at = known.index(name)
        unit = data.channels.outputs[at].unit
        measured = np.where(record.valid[:, inputs + at], record.y[:, at], np.nan)
        found[f"{name} {kind}"] = Values(value.outputs[n][:, o], unit)
        found[f"{name} measured"] = Values(measured, unit)
        found[f"{name} limited"] = Values(value.limited[n][:, o].astype(int))
        found[f"{name} held"] = Values(value.held[n][:, o].astype(int))
        if bounds is not None:
            found[f"{name} lower"] = Values(bounds.lower[n][:, o], unit)
            found[f"{name} upper"] = Values(bounds.upper[n][:, o], unit)
    found["extrapolated"] = Values(value.extrapolated[n].astype(int))
    if index is not None:
        found["index"] = Values(index)
    return found


def tracking_csv(value: "Tracking", sample_time: float, n: int) -> str:
    """Record `n` of a cascade: commands and where a limit held them, references,
    outputs, and where the model's bound, or its limits, held those."""
    length = len(value.commands[n])
    header = ["time [s]"]
    columns = [(np.arange(length) * sample_time).tolist()]
    held = value.at_range[n] | value.at_rate[n]
    for c, name in enumerate(value.command_names):
        header += [f"{name} commanded", f"{name} at limit"]
        columns += [value.commands[n][:, c].tolist(), held[:, c].astype(int).tolist()]
    for o, name in enumerate(value.output_names):
        if o in value.targets:
            header.append(f"{name} reference")
            reference = value.references[n][:, value.targets.index(o)]
            columns.append(reference.tolist())
        header += [f"{name} simulated", f"{name} limited", f"{name} held"]
        columns.append(value.outputs[n][:, o].tolist())
        columns.append(value.limited[n][:, o].astype(int).tolist())
        columns.append(value.held[n][:, o].astype(int).tolist())
    return table_csv(header, columns)
