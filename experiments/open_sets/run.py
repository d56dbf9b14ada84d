"""Automatic identification on every open set, beside trees and SysIdentPy.

Six measured or published sets (`sets.py`) and ten records each of six virtual engines
with 2 % noise (`virtual.py`), all by the same command: what is chosen, its
cross-validated error and its error on the test side by side, the best linear
output-error model of the same leaderboard, histogram gradient boosting on lagged
inputs, and SysIdentPy's FROLS as it comes and with BIC (`peers.py`). A row is an output
of a set. Everything chosen is chosen on training records; the test is scored once when
a column of a row is there, and every such scoring is kept in the row with its date and
the commit of the code.

    python experiments/open_sets/run.py --peers path/to/peers/bin/python
    python experiments/open_sets/run.py --columns jaxnarx --sets cascaded_tanks

Columns are written as they come; a second run goes on where the first stopped, and
`--again` does columns anew. One run at a time: each writes the whole table. The files
come from `$JAXNARX_DATA`.

The peers alone: SysIdentPy as it comes is worse than the mean of the output in 18 of 32
rows (first part of the test) and diverges in six; with BIC, least squares and a lag
chosen it never diverges, is worse than the mean in one, and ahead of the trees in 19.
The limits set for time held them back: half of the rows end with the most trees (17)
or the most terms (16) allowed.
"""

import json
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
sys.path.insert(0, str(Path(__file__).resolve().parent))
from common import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    benchmark_parser,
    results_folder,
)
from kept import Table, in_process  # noqa: E402 # pyright: ignore
from own import NAMES, fit, prepare  # noqa: E402 # pyright: ignore
from peers import PACKAGES, PEERS, installed  # noqa: E402 # pyright: ignore
from sets import READERS  # noqa: E402 # pyright: ignore
from table import NOTES, compared, show, summary  # noqa: E402 # pyright: ignore

COLUMNS = ("jaxnarx", *PEERS)
SMOKE = ("cascaded_tanks", "engine-pfi-cc")
LIMIT, OWN_LIMIT = 600.0, 4 * 3600.0
"""Seconds after which a peer's fit, or an identification, is stopped."""

Row = dict[str, Any]
WORKERS: dict[str, Any] = {"prepare": prepare, "jaxnarx": fit, "installed": installed}
WORKERS |= {name: function for name, (function, _) in PEERS.items()}


def keep(table: Table, name: str, output: str, columns: Row) -> None:
    """Put columns into a row, and what they say of the choice."""
    row = table.row(name, output)
    if "jaxnarx" in columns:
        row.pop("best linear", None)
    row = table.put(name, output, columns)
    row["compared"] = compared(row)


def write(table: Table) -> Path:
    """The whole table as JSON."""
    figures = {"notes": NOTES, "summary": summary(table.rows, table.sets)}
    return table.write(NAMES, figures)


def main() -> None:
    """Run what the command line asks for."""
    parser = benchmark_parser("Open sets by one command.", "short records, no search")
    add = parser.add_argument
    add("--sets", nargs="+", choices=NAMES, metavar="NAME", help=", ".join(NAMES))
    add("--columns", nargs="+", choices=COLUMNS, help="default: all")
    add("--again", action="store_true", help="do these columns anew")
    add("--method", choices=("identify", "fixed"), default="identify")
    add("--preset", default="good", help="of identify")
    add("--budget", type=float, help="of identify")
    chosen = parser.parse_args()
    if chosen.worker:
        name, options = chosen.worker
        print(json.dumps(WORKERS[name](**json.loads(options))))
        return
    folder = results_folder(chosen.results, smoke=chosen.smoke)
    table = Table("open_sets", folder, chosen.note, tuple(PACKAGES))
    pythons = _find(chosen.peers, table)
    for name in chosen.sets or (SMOKE if chosen.smoke else NAMES):
        for _ in fill(table, name, chosen, pythons):
            write(table)
    print(write(table))
    show(table.rows)


def fill(table: Table, name: str, chosen: Any, pythons: Row) -> Iterator[None]:
    """The missing columns of a set; yields after each."""
    data = Path(os.environ.get("JAXNARX_DATA", "../shared/data")).resolve()
    if name in READERS and not (data / name).is_dir():
        print(f"{name}: not in JAXNARX_DATA, left out")
        return
    asked = {"name": name, "data": str(data), "small": chosen.smoke}
    wanted = [
        column
        for column in chosen.columns or COLUMNS
        if chosen.again or table.misses(name, column)
    ]
    if "jaxnarx" in wanted:
        _identified(table, asked, chosen)
        yield
    if peers := [column for column in wanted if column in pythons]:
        with tempfile.TemporaryDirectory() as temporary:
            yield from _peers(table, asked, peers, pythons, Path(temporary), chosen)


def _identified(table: Table, asked: Row, chosen: Any) -> None:
    """Our own columns of all outputs of a set, by one identification."""
    options = {
        "method": "fixed" if chosen.smoke else chosen.method,
        "preset": chosen.preset,
        "budget": chosen.budget,
        "cache": os.environ.get("JAX_COMPILATION_CACHE_DIR"),
    }
    found = _run("jaxnarx", sys.executable, OWN_LIMIT, **asked, **options)
    held = table.sets.setdefault(asked["name"], {})
    held.pop("failed", None)
    if "failed" in found:
        held["failed"] = found["failed"]
        print(f"{asked['name']}: {found['failed']}")
        return
    held |= found["about"] | {"leaderboard": found["leaderboard"]}
    for output, columns in found["columns"].items():
        keep(table, asked["name"], output, columns)


def _peers(
    table: Table, asked: Row, columns: list[str], pythons: Row, space: Path, chosen: Any
) -> Iterator[None]:
    """The peers' columns, one process for each output."""
    name, path = asked["name"], str(space / "set.npz")
    about = _run("prepare", sys.executable, LIMIT, **asked, path=path)
    if "failed" in about:
        raise SystemExit(f"{name}: {about['failed']}")
    table.sets.setdefault(name, {}).update(about)
    for output in about["outputs"]:
        for column in columns:
            if column in table.row(name, output) and not chosen.again:
                continue
            options = {"path": path, "output": output, "small": asked["small"]}
            found = _run(column, pythons[column], LIMIT, **options)
            keep(table, name, output, {column: found})
            print(name, output, column, found.get("failed", ""), flush=True)
            yield


def _find(python: str | None, table: Table) -> dict[str, str]:
    """The interpreter for every peer that is there."""
    if python is None:
        return {}
    versions = _run("installed", python, LIMIT)
    if "failed" in versions:
        raise SystemExit(versions["failed"])
    table.versions |= versions
    missing = {need for _, need in PEERS.values()} - set(versions)
    if missing:
        print(f"without {', '.join(sorted(missing))}: not installed")
    return {name: python for name, (_, need) in PEERS.items() if need in versions}


def _run(name: str, python: str, limit: float, /, **options: Any) -> Row:
    return in_process(str(Path(__file__).resolve()), name, python, limit, **options)


if __name__ == "__main__":
    main()
