"""Mutation score: how many small faults in the package do the default tests find?

A fixed random sample of faults is drawn over the rooms that compute: a comparison, an
operator, a constant or an index is changed, one at a time, in a copy of the project.
The test files that reach the changed line are run, those of the same room first, until
one fails (the mutant is killed) or none does (it survives). Some survivors behave as
the original does and cannot be found; the list is there to be looked at.

    python tests/mutants.py reach reach.json      # each file once, by `coverage`
    python tests/mutants.py draw mutants.json [--number 150] [--seed 0]
    python tests/mutants.py run mutants.json reach.json [--files 12] [--workers 1]
                                                        [--known earlier.json]
    python tests/mutants.py compare earlier.json mutants.json

`reach` needs the package `coverage`, `run` only the tests. `run` writes its findings
into the list and goes on where it was stopped. The test that killed a mutant in an
earlier list is tried first, alone. `compare` keeps two lists among the results of the
benchmarks, as `mutants.json`.
"""

import argparse
import ast
import importlib
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
ROOMS = (
    *("arrays", "selection", "simulation", "refinement", "partition", "models"),
    "data",
)
SWAPS: dict[type, str] = {
    ast.Lt: "<=",
    ast.LtE: "<",
    ast.Gt: ">=",
    ast.GtE: ">",
    ast.Eq: "!=",
    ast.NotEq: "==",
    ast.Add: "-",
    ast.Sub: "+",
    ast.Mult: "/",
    ast.Div: "*",
    ast.And: "or",
    ast.Or: "and",
}
SLACK, SECONDS = 6.0, 60.0
"""A test file that takes so many times its time and seconds more hangs: found."""


def sites(path: Path) -> Iterator[dict[str, Any]]:
    """Every change of one file: where, from what, to what."""
    source = path.read_text(encoding="utf-8")
    lines = source.splitlines(keepends=True)
    starts = [0]
    for line in lines:
        starts.append(starts[-1] + len(line.encode()))
    data = source.encode()

    def place(line: int, column: int) -> int:
        return starts[line - 1] + column

    def change(start: int, end: int, new: str, line: int) -> dict[str, Any]:
        return {
            "path": str(path.relative_to(ROOT)),
            "line": line,
            "text": lines[line - 1].strip(),
            "start": start,
            "old": data[start:end].decode(),
            "new": new,
        }

    def between(left: ast.AST, right: ast.AST, op: ast.AST) -> Iterator[dict[str, Any]]:
        a = place(left.end_lineno, left.end_col_offset)  # type: ignore[attr-defined]
        b = place(right.lineno, right.col_offset)  # type: ignore[attr-defined]
        found = re.search(rb"[<>=!]=|[<>+\-*/]|\band\b|\bor\b", data[a:b])
        if type(op) in SWAPS and found:
            start, end = a + found.start(), a + found.end()
            yield change(start, end, SWAPS[type(op)], left.end_lineno)  # type: ignore[attr-defined]

    for node in _code(ast.parse(source)):
        if isinstance(node, ast.Compare):
            for left, op, right in zip(
                [node.left, *node.comparators], node.ops, node.comparators, strict=False
            ):
                yield from between(left, right, op)
        elif isinstance(node, ast.BinOp):
            if not isinstance(node.left, ast.Constant | ast.JoinedStr) or isinstance(
                getattr(node.left, "value", 0), int | float
            ):
                yield from between(node.left, node.right, node.op)
        elif isinstance(node, ast.BoolOp):
            yield from between(node.values[0], node.values[1], node.op)
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float, bool):
            start = place(node.lineno, node.col_offset)
            end = place(node.end_lineno or 0, node.end_col_offset or 0)
            value = node.value
            if isinstance(value, bool):
                new = str(not value)
            elif isinstance(value, int):
                new = repr(value + 1)
            else:
                assert isinstance(value, float)
                new = repr(2 * value + 0.5)
            yield change(start, end, new, node.lineno)


def _code(tree: ast.AST) -> Iterator[ast.AST]:
    """Nodes of what is run: no annotations, messages or statements of a module."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.JoinedStr | ast.Raise | ast.Assert):
            continue
        if isinstance(node, ast.keyword) and node.arg == "strict":
            continue
        if isinstance(node, ast.FunctionDef):
            for part in node.body:
                yield part
                yield from _code(part)
        elif isinstance(node, ast.ClassDef) or not isinstance(tree, ast.Module):
            if isinstance(tree, ast.AnnAssign) and node is tree.annotation:
                continue
            yield node
            yield from _code(node)


def draw(number: int, seed: int) -> list[dict[str, Any]]:
    """The sample: uniform over all changes of the rooms, in order of place."""
    every = [
        site
        for room in ROOMS
        for path in sorted((ROOT / "jaxnarx" / room).rglob("*.py"))
        for site in sites(path)
    ]
    chosen = random.Random(seed).sample(range(len(every)), number)
    return [every[i] for i in sorted(chosen)]


def reach() -> dict[str, Any]:
    """Lines of the package that each test file runs, and its seconds."""
    found = {}
    for path in sorted(ROOT.glob("tests/**/test_*.py")):
        with tempfile.TemporaryDirectory() as space:
            options = ["--source=jaxnarx", f"--data-file={space}/reach"]
            start = time.monotonic()
            python = [sys.executable, "-m", "coverage"]
            test = ["-m", "pytest", "-q", str(path)]
            subprocess.run([*python, "run", *options, *test], cwd=ROOT)
            seconds = time.monotonic() - start
            out = Path(space) / "reach.json"
            options = [f"--data-file={space}/reach", "-q", "-o", str(out)]
            subprocess.run([*python, "json", *options], cwd=ROOT)
            files = json.loads(out.read_text())["files"] if out.exists() else {}
            lines = {name: part["executed_lines"] for name, part in files.items()}
            name = str(path.relative_to(ROOT))
            found[name] = {"seconds": round(seconds, 1), "lines": lines}
    return found


def judges(mutant: dict[str, Any], reached: dict[str, Any], most: int) -> list[str]:
    """Test files that run the changed line: of the same room first, quick ones first.

    What runs in processes of its own is not seen: all files of its room are taken.
    """
    room = Path(mutant["path"]).parts[1]

    def order(name: str) -> tuple[bool, float]:
        return Path(name).parts[1] != room, reached[name]["seconds"]

    every = [
        name
        for name, part in reached.items()
        if mutant["line"] in part["lines"].get(mutant["path"], ())
    ]
    alike = [name for name in reached if Path(name).parts[1] == room]
    return sorted(every or alike, key=order)[:most]


def try_one(
    mutant: dict[str, Any],
    reached: dict[str, Any],
    most: int,
    home: Path,
    known: str = "",
) -> dict[str, Any]:
    """Whether a test notices, and which; the `known` one is asked first."""
    path = home / mutant["path"]
    source = path.read_bytes()
    start, old = mutant["start"], mutant["old"].encode()
    assert source[start : start + len(old)] == old, f"{path} is not what it was"
    names = [n for n in judges(mutant, reached, most) if (home / n).exists()]
    changed = source[:start] + mutant["new"].encode() + source[start + len(old) :]
    if "::" in known and (home / known.partition("::")[0]).exists():
        path.write_bytes(changed)
        how = _fails([known], home, SECONDS + 240.0)
        path.write_bytes(source)
        if "::" in how and sound(known, home):
            return {"killed": True, "by": how, "tried": 1}
    while names:
        limit = SLACK * sum(reached[name]["seconds"] for name in names) + SECONDS
        path.write_bytes(changed)
        how = _fails(names, home, limit)
        path.write_bytes(source)
        if not how:
            break
        file = how.partition("::")[0]
        # Who ends without a word, or never, may be any of them.
        unsound = [n for n in names if file in (n, how) and not sound(n, home)]
        if not unsound:
            return {"killed": True, "by": how, "tried": len(names)}
        names = [name for name in names if name not in unsound]
    return {"killed": False, "tried": len(names), "files": names}


def sound(name: str, home: Path) -> bool:
    """Whether a file passes as the package is, in this copy of it."""
    key = name, str(home)
    if key not in _SOUND:
        _SOUND[key] = not _fails([name], home, 3600.0)
    return _SOUND[key]


_SOUND: dict[tuple[str, str], bool] = {}


def _fails(names: list[str], home: Path, limit: float) -> str:
    """The first test of these files that fails, or nothing."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "--tb=no", *names]
    environment = os.environ | {"PYTHONPATH": str(home)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # modules are compiled once
    try:
        done = subprocess.run(
            [*command, "-p", "no:cacheprovider"],
            cwd=home,
            env=environment,
            capture_output=True,
            text=True,
            timeout=limit,
        )
    except subprocess.TimeoutExpired:
        return "time"
    if done.returncode in (0, 5):
        return ""
    found = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, flags=re.M)
    return found[1] if found else f"exit code {done.returncode}"


def run(
    path: Path,
    reached: dict[str, Any],
    most: int,
    workers: int,
    known: dict[tuple, str],
) -> None:
    """Try every mutant that has no finding yet; the list is written after each."""
    mutants = json.loads(path.read_text())
    left = [m for m in mutants if "killed" not in m]
    with tempfile.TemporaryDirectory() as space, ThreadPoolExecutor(workers) as pool:
        homes = []
        for number in range(workers):
            home = Path(space) / str(number)
            for part in ("jaxnarx", "tests", "docs", "experiments"):
                shutil.copytree(ROOT / part, home / part)
            for name in ("pyproject.toml", "README.md", "CHANGELOG.md"):
                shutil.copy(ROOT / name, home / name)
            homes.append(home)

        def work(number: int) -> None:
            for mutant in left[number::workers]:
                by = known.get(place(mutant), "")
                mutant |= try_one(mutant, reached, most, homes[number], by)
                path.write_text(json.dumps(mutants, indent=1) + "\n")
                print(mutant["path"], mutant["line"], mutant.get("by", "survives"))

        list(pool.map(work, range(workers)))
    killed = sum(m["killed"] for m in mutants)
    print(f"{killed} of {len(mutants)} killed")


def compare(before: list[dict[str, Any]], after: list[dict[str, Any]]) -> dict:
    """How many of each list are killed, and every mutant with the tests that did it.

    Code that has moved to another file is found again by its text.
    """
    earlier, rows = list(before), []
    for mutant in after:
        same = [m for m in earlier if place(m) == place(mutant)]
        moved = [m for m in earlier if place(m)[1:] == place(mutant)[1:]]
        old = (same or moved or [{}])[0]
        earlier = [m for m in earlier if m is not old]
        keys = ("path", "line", "text", "old", "new")
        by = {"before": old.get("by"), "after": mutant.get("by")}
        rows.append({k: mutant[k] for k in keys} | {"killed by": by})
    return {
        "before": {"mutants": len(before), "killed": sum(m["killed"] for m in before)},
        "after": {"mutants": len(after), "killed": sum(m["killed"] for m in after)},
        "not found again": [f"{m['path']}: {m['text']}" for m in earlier],
        "mutants": rows,
    }


def keep(figures: dict[str, Any]) -> None:
    """Among the results of the benchmarks."""
    sys.path.insert(0, str(ROOT / "experiments" / "benchmarks"))
    benchmarks: Any = importlib.import_module("common")  # theirs, not that of the tests
    folder = benchmarks.results_folder(None, smoke=False)
    benchmarks.record("mutants", figures, folder=folder)
    print({k: figures[k] for k in ("before", "after", "not found again")})


def place(mutant: dict[str, Any]) -> tuple:
    """What a mutant changes, wherever it stands in its file."""
    return tuple(mutant[key] for key in ("path", "text", "old", "new"))


def main() -> None:
    parser = argparse.ArgumentParser(description="Mutation score of the tests.")
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("reach", "draw", "run"):
        command = commands.add_parser(name)
        command.add_argument("path", type=Path)
        if name == "draw":
            command.add_argument("--number", type=int, default=150)
            command.add_argument("--seed", type=int, default=0)
        if name == "run":
            command.add_argument("reach", type=Path)
            command.add_argument("--files", type=int, default=12)
            command.add_argument("--workers", type=int, default=1)
            command.add_argument("--known", type=Path, help="an earlier list")
    command = commands.add_parser("compare")
    command.add_argument("path", type=Path)
    command.add_argument("after", type=Path)
    chosen = parser.parse_args()
    if chosen.command == "compare":
        lists = (json.loads(p.read_text()) for p in (chosen.path, chosen.after))
        return keep(compare(*lists))
    if chosen.command == "run":
        reached = json.loads(chosen.reach.read_text())
        earlier = json.loads(chosen.known.read_text()) if chosen.known else []
        known = {place(m): m.get("by", "") for m in earlier}
        run(chosen.path, reached, chosen.files, chosen.workers, known)
        return
    made = reach() if chosen.command == "reach" else draw(chosen.number, chosen.seed)
    chosen.path.write_text(json.dumps(made, indent=1) + "\n")


if __name__ == "__main__":
    main()
