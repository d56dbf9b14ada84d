"""Records as files that `jaxnarx check` and `identify` read: CSV and a description."""

import csv
import io
import json
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool

from jaxnarx.data import Dataset
from jaxnarx.files import cell
from jaxnarx.settings import Physics


def record_csv(
    data: Dataset,
    n: int,
    *,
    by_event: bool = False,
    flags: Mapping[str, Bool[np.ndarray, " time"]] | None = None,
) -> str:
    """Record `n` as CSV: time [s] and every channel; masked samples are empty.

    Numbers are written so that they are read back as they are. `by_event` counts
    samples instead of telling their time, where they are not equidistant in time;
    `flags` adds columns of 0 and 1.
    """
    record, names = data.records[n], data.channels.names
    x = np.concatenate([record.u, record.y], axis=1)
    columns = {k: np.asarray(v).astype(int).tolist() for k, v in (flags or {}).items()}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    first = _unused_header("event" if by_event else "time [s]", names)
    writer.writerow([first, *map(cell, names), *map(cell, columns)])
    for k, (row, valid) in enumerate(
        zip(x.tolist(), record.valid.tolist(), strict=True)
    ):
        at = str(k) if by_event else f"{k * data.sample_time:.10g}"
        cells = [repr(v) if good else "" for v, good in zip(row, valid, strict=True)]
        writer.writerow([at, *cells, *(column[k] for column in columns.values())])
    return text.getvalue()


def _unused_header(name: str, names: Sequence[str]) -> str:
    """A header that no channel has."""
    while name in names:
        name = "record " + name
    return name


def describe(
    data: Dataset,
    files: Mapping[str, Sequence[str]],
    *,
    by: str,
    remarks: Sequence[str] = (),
    extra: Mapping[str, str] | None = None,
    physics: Mapping[str, Physics] | None = None,
) -> str:
    """A TOML description of written records, by part; they lie in its own folder.

    `by` is the command that wrote them; `remarks` become comments, `extra` entries of
    [data], `physics` those signs of gains whose channels are there.
    """
    lines = [
        f"# Written by `{' '.join(by.split())}`.",
        "# The files are in the folder of this one.",
        *(f"# {remark}" for remark in remarks),
        "[data]",
        f"sample_time = {data.sample_time!r}",
        'missing = "mask"  # empty cells are masked samples',
        'delimiter = ","',
        *(f"{key} = {_quote(value)}" for key, value in (extra or {}).items()),
    ]
    groups = {"inputs": data.channels.inputs, "outputs": data.channels.outputs}
    for group, channels in groups.items():
        lines += ["", f"[channels.{group}]"]
        for c in channels:
            column, unit = _quote(cell(c.name)), _quote(c.unit)
            lines.append(f"{_quote(c.name)} = {{column = {column}, unit = {unit}}}")
    lines += ["", "[records]"]
    for part, names in files.items():
        lines.append(f"{part} = {_list(names)}")
    lines += [*_groups(data, files), *_physics(data, physics or {})]
    return "\n".join(lines) + "\n"


def _physics(data: Dataset, physics: Mapping[str, Physics]) -> list[str]:
    """What physics says, of those inputs that there are."""
    lines = []
    for name, one in physics.items():
        if name not in data.channels.output_names:
            continue
        told: list[str] = [
            f"{way} = {_list(kept)}"
            for way in ("increases_with", "decreases_with")
            if (kept := [n for n in getattr(one, way) if n in data.channels.names])
        ]
        if one.longest_time_constant is not None:
            told.append(f"longest_time_constant = {one.longest_time_constant!r}")
        lines += [f"{_quote(name)} = {{{', '.join(told)}}}"] if told else []
    return ["", "[physics]", *lines] if lines else []


def _groups(data: Dataset, files: Mapping[str, Sequence[str]]) -> list[str]:
    """The groups that are left out together, as the records say."""
    of: dict[str, list[str]] = {}
    if any(record.group for record in data):
        names = [name for part in files.values() for name in part]
        for record, name in zip(data, names, strict=True):
            of.setdefault(record.group, []).append(name)
    told = [f"{_quote(g)} = {_list(names)}" for g, names in of.items() if g]
    return [f"groups = {{{', '.join(told)}}}"] if told else []


def _list(names: Sequence[str]) -> str:
    return f"[{', '.join(map(_quote, names))}]"


def _quote(text: str) -> str:
    """A TOML string; unlike JSON's, it may not hold the delete character."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
