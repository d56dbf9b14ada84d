"""The size of the house, room by room: lines, files, functions, classes, public names.

Lines of code are those with something on them that is neither comment nor docstring.
With `--before DIR` another checkout is counted beside it.

    python experiments/benchmarks/house.py [--smoke] [--before DIR]
"""

import argparse
import ast
import io
import tokenize
from pathlib import Path
from typing import Any

from common import ROOT, record, results_folder

SILENT = (
    *(tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT),
    *(tokenize.DEDENT, tokenize.ENCODING, tokenize.ENDMARKER),
)


def of_file(path: Path) -> dict[str, int]:
    """Figures of one file."""
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    nodes = list(ast.walk(tree))
    functions = (ast.FunctionDef, ast.AsyncFunctionDef)
    told: set[int] = set()
    for node in nodes:
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            if isinstance(node.value.value, str):
                told |= set(range(node.lineno, (node.end_lineno or 0) + 1))
    spoken = {
        line
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
        if token.type not in SILENT
        for line in range(token.start[0], token.end[0] + 1)
    }
    return {
        "files": 1,
        "lines": text.count("\n"),
        "code": len(spoken - told),
        "functions": sum(isinstance(n, functions) for n in nodes),
        "classes": sum(isinstance(n, ast.ClassDef) for n in nodes),
    }


def rooms(root: Path) -> dict[str, dict[str, int]]:
    """Figures of every room of the package, and sums of all, tests and experiments."""
    found: dict[str, dict[str, int]] = {}
    for top in ("jaxnarx", "tests", "experiments"):
        for path in sorted((root / top).rglob("*.py")):
            inside = path.relative_to(root / top).parts
            room = f"{top}/{inside[0]}" if len(inside) > 1 else f"{top}/*.py"
            for place in (top, room) if top == "jaxnarx" else (top,):
                sums = found.setdefault(place, {})
                for name, value in of_file(path).items():
                    sums[name] = sums.get(name, 0) + value
    return found


def public(root: Path) -> int:
    """Names that the package lists at its top."""
    tree = ast.parse((root / "jaxnarx" / "__init__.py").read_text(encoding="utf-8"))
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) in (
            "_HOME",
            "_ROOM_NAMES",
        ):
            table = ast.literal_eval(node.value)
            return sum(len(names.split()) for names in table.values())
    raise ValueError(f"{root}: no list of public names")


def figures(root: Path) -> dict[str, Any]:
    """What is counted of a checkout."""
    return {"public names": public(root), "rooms": rooms(root)}


def main() -> None:
    """Count and record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--smoke", action="store_true", help="as without it")
    parser.add_argument("--before", metavar="DIR", help="another checkout")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    options = parser.parse_args()
    found = {"now": figures(ROOT)}
    if options.before:
        found["before"] = figures(Path(options.before).resolve())
    for when, figure in found.items():
        print(f"{when}: {figure['public names']} public names")
        for room, sums in figure["rooms"].items():
            print(f"  {room:24s}", *(f"{k} {v:6d}" for k, v in sums.items()))
    record("house", found, folder=results_folder(options.results, smoke=options.smoke))


if __name__ == "__main__":
    main()
