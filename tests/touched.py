"""Which experiments do changed files reach? Their small modes are tested at a landing.

    python tests/touched.py changed.txt

prints the slow tests of experiments whose scripts import, name by name and through any
number of modules, a file listed in `changed.txt` (as `git diff --name-only` lists
them). A file that every script needs, such as `pyproject.toml`, touches all.
"""

import ast
import re
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TESTS = (
    "tests/test_experiments.py",
    "tests/test_linear_experiments.py",
    "tests/test_network_experiments.py",
    "tests/test_open_sets.py",
    "tests/test_public_sets.py",
    "tests/test_sweep_experiments.py",
)
EVERYBODY = {"pyproject.toml", "tests/smoke.py"}
PACKAGE, EXPERIMENTS = ROOT / "jaxnarx", ROOT / "experiments"
FOLDERS = sorted(p for p in EXPERIMENTS.iterdir() if p.is_dir())


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def module(name: str) -> Path | None:
    """File of a module of the package."""
    base = ROOT.joinpath(*name.split("."))
    for path in (base.with_suffix(".py"), base / "__init__.py"):
        if path.is_file():
            return path
    return None


@cache
def offered(path: Path) -> dict[str, tuple[str, str]]:
    """Names that a module takes in from elsewhere: from which module, which name."""
    return {
        alias.asname or alias.name: (node.module or "", alias.name)
        for node in ast.walk(parsed(path))
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }


def home(name: str, part: str) -> Path | None:
    """The file that defines `part` of module `name`, behind any number of rooms."""
    if inner := module(f"{name}.{part}"):
        return inner
    path = module(name)
    if path is None or path.name != "__init__.py":
        return path
    further = offered(path).get(part)
    if further and further[0].startswith("jaxnarx") and further != (name, part):
        return home(*further) or path
    return path


def beside(path: Path, name: str) -> Path | None:
    """A script of the experiments that another one imports: of its folder first."""
    for folder in (path.parent, *FOLDERS):
        if (found := folder / f"{name}.py").is_file():
            return found
    return None


@cache
def imported(path: Path) -> frozenset[Path]:
    """Files that one file imports names of, ours only."""
    found: set[Path | None] = set()
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.ImportFrom):
            name = node.module or ""
            if name.split(".")[0] == "jaxnarx":
                found |= {home(name, alias.name) for alias in node.names}
            else:
                found.add(beside(path, name))
        elif isinstance(node, ast.Import):
            found |= {beside(path, a.name) for a in node.names}
        elif chain := attributes(node):
            found.add(deepest(chain))
    return frozenset(p for p in found if p)


def attributes(node: ast.AST) -> list[str]:
    """`jnx.a.b` as its names, or nothing."""
    names: list[str] = []
    while isinstance(node, ast.Attribute):
        names.insert(0, node.attr)
        node = node.value
    ours = isinstance(node, ast.Name) and node.id in ("jnx", "jaxnarx")
    return names if ours else []


def deepest(chain: list[str]) -> Path | None:
    """The file behind `jnx.room.name`, or behind `jnx.name`."""
    name = "jaxnarx"
    for part in chain:
        path = home(name, part)
        if path is None or path.name != "__init__.py" or path == module("jaxnarx"):
            return path
        name = f"{name}.{part}"
    return module(name)


def reach(paths: Iterable[Path]) -> set[Path]:
    """All files that these lead to."""
    found, left = set(), list(paths)
    while left:
        path = left.pop()
        if path not in found:
            found.add(path)
            left += imported(path)
    return found


def scripts(test: ast.FunctionDef) -> list[Path]:
    """Scripts that a test names."""
    words = [n.value for n in ast.walk(test) if isinstance(n, ast.Constant)]
    names = [w for w in words if isinstance(w, str) and re.fullmatch(r"[\w/.]+", w)]
    return [
        found
        for name in names
        for found in (
            *(folder / name for folder in (EXPERIMENTS, EXPERIMENTS / "benchmarks")),
            EXPERIMENTS / name / "run.py",
        )
        if found.suffix == ".py" and found.is_file()
    ]


def touched(changed: Iterable[str]) -> list[str]:
    """Slow tests to be run, as pytest names them.

    Always run is one that leads to no file of the package: it starts the command.
    """
    changed = set(changed)
    files = {ROOT / name for name in changed}
    chosen = []
    for name in TESTS:
        for node in parsed(ROOT / name).body:
            marks = map(ast.unparse, getattr(node, "decorator_list", []))
            if not isinstance(node, ast.FunctionDef) or "pytest.mark.slow" not in marks:
                continue
            own = reach(scripts(node))
            known = any(PACKAGE in path.parents for path in own)
            if not known or name in changed or changed & EVERYBODY or own & files:
                chosen.append(f"{name}::{node.name}")
    return chosen


if __name__ == "__main__":
    print(*touched(Path(sys.argv[1]).read_text().split()), sep="\n")
