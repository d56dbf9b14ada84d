"""Rows of a table on the disk, and jobs in processes of their own.

Shared by the tables of `experiments/open_sets` and `experiments/public`.
"""

import json
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from common import code, record, worker  # noqa: E402 # pyright: ignore

Row = dict[str, Any]


class Table:
    """Rows by set and output, written whenever one of them changes."""

    def __init__(self, name: str, folder: Path, note: str, packages: Sequence[str]):
        """`packages` are those of peers, whose versions stay known when a later run is
        without them."""
        self.name, self.folder, self.note = name, folder, note
        path = folder / f"{name}.json"
        held = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        figures = held.get("figures", {})
        versions = held.get("versions", {})
        self.versions = {p: versions[p] for p in packages if p in versions}
        self.sets: dict[str, Row] = figures.get("sets", {})
        self.rows: list[Row] = figures.get("rows", [])

    def row(self, name: str, output: str) -> Row:
        """The row of an output, empty at first."""
        for row in self.rows:
            if (row["set"], row["output"]) == (name, output):
                return row
        self.rows.append({"set": name, "output": output, "scored": []})
        return self.rows[-1]

    def misses(self, name: str, column: str) -> bool:
        """Whether a set has no such column yet in one of its rows."""
        outputs = self.sets.get(name, {}).get("outputs", [])
        return not outputs or any(column not in self.row(name, o) for o in outputs)

    def put(self, name: str, output: str, columns: Row) -> Row:
        """Keep columns of a row, and that the test was scored for them."""
        row = self.row(name, output)
        row |= {"unit": self.sets[name]["unit"][output]} | columns
        now = datetime.now(UTC).isoformat(timespec="seconds")
        for column, found in columns.items():
            if "test" in found:
                row["scored"].append({"column": column, "date": now} | code())
        return row

    def write(self, order: Sequence[str], figures: Row) -> Path:
        """The whole table as JSON: rows in the order of their sets, and `figures`."""
        place = {name: n for n, name in enumerate(order)}
        self.rows.sort(key=lambda row: place[row["set"]])
        whole = {"notes": {}, "sets": self.sets, "rows": self.rows} | figures
        options: Row = {"folder": self.folder, "note": self.note}
        return record(self.name, whole, versions=self.versions, **options)


def in_process(
    script: str, name: str, python: str, limit: float, /, **options: Any
) -> Row:
    """What the worker `name` of a script says, in a process of its own: its JSON, or
    `failed` with the reason."""
    text = json.dumps(options)
    found, done = worker(script, "--worker", name, text, python=python, limit=limit)
    if found is not None:
        return found
    stopped = done.wall >= limit
    lines = done.stderr.strip().splitlines() or ["ended without a word"]
    return {"failed": f"stopped after {limit:g} s" if stopped else lines[-1]}
