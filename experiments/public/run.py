"""Public sets: ours by the best configuration and by default, peers, published figures.

Six sets by one command; what is compared and how is told in `README.md`. Whatever is
chosen is chosen on training records; every scoring of a test is kept in its row with
its date and the commit of the code.

    python experiments/public/run.py --peers path/to/peers/bin/python
    python experiments/public/run.py --columns "hidden states" --sets silverbox

Columns are written as they come, and so are the candidates that they are chosen from: a
second run goes on where the first stopped, `--again` does columns anew. One run at a
time: each writes the whole table. The files come from `$JAXNARX_DATA`. Results:
`experiments/benchmarks/results/public.json`, and `public.png` beside it.
"""

import json
import os
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "benchmarks"))
sys.path.insert(0, str(HERE.parent / "open_sets"))
sys.path.insert(0, str(HERE))
from common import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    RESULTS,
    benchmark_parser,
    results_folder,
)
from gru import fit_gru  # noqa: E402 # pyright: ignore
from kept import Table, in_process  # noqa: E402 # pyright: ignore
from others import PACKAGES, PEERS, installed  # noqa: E402 # pyright: ignore
from ours import (  # noqa: E402 # pyright: ignore
    column,
    finished,
    judged,
    losses,
    taken,
    window,
)
from own import fit, load, prepare  # noqa: E402 # pyright: ignore
from packed import told  # noqa: E402 # pyright: ignore
from published import PUBLISHED  # noqa: E402 # pyright: ignore
from sets import READERS, OpenSet  # noqa: E402 # pyright: ignore
from show import NOTES, draw, show, with_best  # noqa: E402 # pyright: ignore
from structures import methods, named  # noqa: E402 # pyright: ignore

HIDDEN, NOT_HELD = "hidden states", "hidden states, not held"
COLUMNS = (HIDDEN, NOT_HELD, "identify", "GRU", *PEERS)
SMOKE = "silverbox"
LIMIT, OWN_LIMIT = 1800.0, 2 * 3600.0
"""Seconds after which a fit of a peer, or an identification, is stopped."""

Row = dict[str, Any]
WORKERS: dict[str, Any] = {"identify": fit, "prepare": prepare, "installed": installed}
WORKERS |= {"GRU": fit_gru} | PEERS


def main() -> None:
    """Run what the command line asks for."""
    parser = benchmark_parser("Public sets by one command.", "short records, one set")
    add = parser.add_argument
    add("--sets", nargs="+", choices=READERS, metavar="NAME", help=", ".join(READERS))
    add("--columns", nargs="+", choices=COLUMNS, help="default: all")
    add("--again", action="store_true", help="do these columns anew")
    add("--rows", type=int, default=8000, help="samples that train while it is chosen")
    add("--budget", type=float, help="of identify [s]")
    add("--chosen-only", action="store_true", help="choose, and score nothing")
    chosen = parser.parse_args()
    if chosen.worker:
        name, options = chosen.worker
        print(json.dumps(WORKERS[name](**json.loads(options))))
        return
    folder = results_folder(chosen.results, smoke=chosen.smoke)
    table = Table("public", folder, chosen.note, PACKAGES)
    pythons = _peers(chosen.peers, table)
    for name in chosen.sets or ([SMOKE] if chosen.smoke else READERS):
        for _ in fill(table, name, chosen, pythons):
            write(table)
    print(write(table))
    show(table.rows, PUBLISHED, elsewhere())
    draw(table.rows, PUBLISHED, folder / "public.png")


def write(table: Table) -> Path:
    """The whole table as JSON, with the better of our two columns."""
    for row in table.rows:
        with_best(row)
    return table.write(tuple(READERS), {"notes": NOTES, "published": PUBLISHED})


def elsewhere() -> list[Row]:
    """Rows of `open_sets.json`, for the peers that are run there."""
    path = RESULTS / "open_sets.json"
    return json.loads(path.read_text(encoding="utf-8"))["figures"]["rows"]


def fill(table: Table, name: str, chosen: Any, pythons: Row) -> Iterator[None]:
    """The missing columns of a set; yields when something is to be written."""
    data = Path(os.environ.get("JAXNARX_DATA", "../shared/data")).resolve()
    if not (data / name).is_dir():
        print(f"{name}: not in JAXNARX_DATA, left out")
        return
    asked = {"name": name, "data": str(data), "small": chosen.smoke}
    wanted = [
        one
        for one in chosen.columns or COLUMNS
        if chosen.again or table.misses(name, one)
    ]
    open_set = load(name, str(data), small=chosen.smoke)
    table.sets.setdefault(name, {}).update(told(open_set))
    hidden = [one for one in (HIDDEN, NOT_HELD) if one in wanted]
    if hidden:
        for output in open_set.outputs:
            yield from hidden_states(table, open_set, output, hidden, chosen)
    if "identify" in wanted:
        _identified(table, asked, chosen)
        yield
    others = [one for one in wanted if one in pythons]
    if others:
        with tempfile.TemporaryDirectory() as temporary:
            path = str(Path(temporary) / "set.npz")
            prepare(name, str(data), chosen.smoke, path)
            for output in open_set.outputs:
                for peer in others:
                    if peer in table.row(name, output) and not chosen.again:
                        continue
                    options = {"path": path, "output": output, "small": chosen.smoke}
                    options |= _more(peer, table, name, output)
                    found = _run(peer, pythons[peer], LIMIT, **options)
                    table.put(name, output, {peer: found})
                    print(name, output, peer, found, flush=True)
                    yield


def hidden_states(
    table: Table, open_set: OpenSet, output: str, columns: list[str], chosen: Any
) -> Iterator[None]:
    """Judge every structure, then train the best on everything and score it, held to
    the ranges of its training and not."""
    held = table.sets[open_set.name].setdefault("candidates", {})
    if chosen.again:
        held.pop(output, None)
    board: list[Row] = held.setdefault(output, [])
    tried = list(methods(open_set.name, open_set.train, output, window(open_set)))
    if chosen.smoke:
        linear = (m for m in tried if (m.degree, m.regions) == (1, 1))
        few = {"start": "subspace", "max_steps": 2, "first_steps": 2}
        tried = [replace(m, shrink=m.shrink[:1], **few) for m in linear][:1]
    for method in tried:
        first = named(method, method.stages[0][0])
        if any(row["name"].startswith(first + ",") for row in board):
            continue
        rows = judged(method, open_set, losses(board), chosen.rows)
        board.extend(rows)
        print(open_set.name, output, *rows, sep="\n  ", flush=True)
        yield
    from jaxnarx.models import hold_to_range

    row = taken(board)
    if chosen.chosen_only or row is None:
        return
    size = row["states"], row["degree"], row.get("regions", 1) > 1
    method = next(m for m in tried if (m.states, m.degree, m.regions > 1) == size)
    network, seconds = finished(method, row, open_set, chosen.rows)
    for name in columns:
        model = hold_to_range(network, None) if name == NOT_HELD else network
        found = column(model, row, seconds, open_set)
        found["choice_seconds"] = round(sum(r["seconds"] for r in board), 1)
        table.put(open_set.name, output, {name: found})
        print(open_set.name, output, name, found, flush=True)
    yield


def _identified(table: Table, asked: Row, chosen: Any) -> None:
    """What `identify` chooses by itself, for all outputs of a set."""
    options = {
        "method": "fixed" if chosen.smoke else "identify",
        "preset": "good",
        "budget": chosen.budget,
        "cache": os.environ.get("JAX_COMPILATION_CACHE_DIR"),
    }
    found = _run("identify", sys.executable, OWN_LIMIT, **asked, **options)
    if "failed" in found:
        print(f"{asked['name']}: {found['failed']}")
        return
    table.sets[asked["name"]]["leaderboard"] = found["leaderboard"]
    for output, columns in found["columns"].items():
        table.put(asked["name"], output, {"identify": columns["jaxnarx"]})
        print(asked["name"], output, columns["jaxnarx"], flush=True)


def _more(peer: str, table: Table, name: str, output: str) -> Row:
    """What else a peer is told: the set, or the structure that ours has; with products
    of two in place of regions."""
    if peer == "GRU":
        return {"name": name}
    board = table.sets[name].get("candidates", {}).get(output, [])
    row = taken(board) or {"states": 2, "degree": 2}
    degree = row["degree"] if row.get("regions", 1) == 1 else 2
    return {"states": row["states"], "degree": degree}


def _peers(python: str | None, table: Table) -> dict[str, str]:
    """The interpreter of every peer that is there; the GRU runs in this one."""
    found = {"GRU": sys.executable}
    if python is None:
        return found
    versions = _run("installed", python, LIMIT)
    if "failed" in versions:
        raise SystemExit(versions["failed"])
    table.versions |= versions
    return found | {name: python for name in PEERS if name in versions}


def _run(name: str, python: str, limit: float, /, **options: Any) -> Row:
    return in_process(str(Path(__file__).resolve()), name, python, limit, **options)


if __name__ == "__main__":
    main()
