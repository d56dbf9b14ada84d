"""The house of DESIGN section 3: which module may import which, and what loads jax."""

import ast
import graphlib
import operator
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

import jaxnarx

PACKAGE = Path(jaxnarx.__file__).parent
ROOT = Path(__file__).parents[1]


@cache
def modules() -> dict[str, Path]:
    """Every module of the package by name."""
    return {
        ".".join(("jaxnarx", *path.relative_to(PACKAGE).with_suffix("").parts)): path
        for path in sorted(PACKAGE.rglob("*.py"))
    }


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


# Rooms from the ground up. A module may import its own room and every room on a line
# above it here; rooms on one line do not know each other.
HOUSE = [
    ["errors"],
    ["checks", "child_process", "deprecation", "extensions", "files"],
    ["argument_checks", "docstrings", "formatting"],
    ["settings"],
    ["solution"],
    ["arrays", "metrics"],
    # Floor 2. The order within is not prescribed; this is the one that has no cycle.
    ["data"],
    ["excitation", "regressors"],
    ["models"],
    # Floor 3, in the order of the design.
    ["simulation"],
    ["refinement"],
    ["confidence"],
    ["selection"],
    ["partition"],
    ["exporters"],
    ["linear", "inverse", "design", "evaluation"],
    ["identification", "calibration"],
    ["fleet", "sweep", "control"],
    # Floor 4, and the checks that users run over their extensions.
    ["shell", "contracts"],
]
RANK = {room: rank for rank, rooms in enumerate(HOUSE) for room in rooms}
FLOOR_2 = RANK["models"]

# The virtual engines use floors 1 and 2 only; what uses them is the shell.
ENGINES = "engines"

# Documented, imported when asked: a report writes itself as HTML, which the shell does,
# and a network runs itself, by functions that are written for networks.
EXCEPTIONS = {
    ("jaxnarx.evaluation._report", "jaxnarx.shell.report.html"),
    ("jaxnarx.models.network", "jaxnarx.models.state_form"),
}


def room(module: str) -> str | None:
    """Room of a module, None for the package itself."""
    parts = module.split(".")[1:]
    return parts[0] if parts and parts[0] != "__init__" else None


def imports(path: Path, known: dict[str, Path]) -> list[tuple[str, bool]]:
    """(module, inside a function) of every import of this package, at any depth."""
    tree = parsed(path)
    inside = {
        id(node)
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        for node in ast.walk(function)
    }
    found = []
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative imports hide where they point"
            base = node.module or ""
            # `from jaxnarx.shell import figures` may name a module.
            found_in = {name.removesuffix(".__init__") for name in known}
            names = [
                name if (name := f"{base}.{a.name}") in found_in else base
                for a in node.names
            ]
            names = [n if n != "jaxnarx" else "jaxnarx.__init__" for n in names]
        found += [(n, id(node) in inside) for n in names if n.startswith("jaxnarx")]
    return found


def allowed(importer: str, imported: str) -> bool:
    here, there = room(importer), room(imported)
    assert here is not None and there is not None
    if here == there:
        return True
    if here == ENGINES:
        return RANK[there] <= FLOOR_2
    if there == ENGINES:
        return here in ("shell", "contracts")
    return RANK[there] < RANK[here]


@cache
def edges() -> list[tuple[str, str, bool]]:
    """Every import of one module by another, the package's own list excepted."""
    known = modules()
    return [
        (module, target, lazy)
        for module, path in known.items()
        if room(module) is not None
        for target, lazy in imports(path, known)
    ]


def test_every_module_has_a_room():
    homeless = {
        module for module in modules() if room(module) not in {None, ENGINES, *RANK}
    }
    assert not homeless, (
        f"{sorted(homeless)}: say in DESIGN section 3 which floor they belong to, then "
        "here"
    )


def test_imports_point_to_the_same_folder_or_down():
    assert len(edges()) > 100, "the imports were not found"
    wrong = [
        f"{a} -> {b}{' (in a function)' if lazy else ''}"
        for a, b, lazy in edges()
        if not allowed(a, b) and not ((a, b) in EXCEPTIONS and lazy)
    ]
    assert not wrong


def test_rooms_are_entered_by_their_door():
    past = {
        (module, target)
        for module, target, _ in edges()
        if room(module) != room(target) and len(target.split(".")) > 2
        if not target.endswith(".__init__")
    }
    assert past <= EXCEPTIONS


def test_no_function_hides_its_module():
    """What a folder's `__init__` takes in must not have the name of a file there."""
    hidden = []
    for module, path in modules().items():
        if path.name != "__init__.py":
            continue
        here = module.removesuffix(".__init__")
        files = {
            p.stem for p in path.parent.iterdir() if p.suffix == ".py" or p.is_dir()
        }
        for node in ast.walk(parsed(path)):
            if isinstance(node, ast.ImportFrom) and node.module != here:
                names = {a.asname or a.name for a in node.names}
                hidden += [f"{here}.{name}" for name in names & files]
    assert not hidden


def test_the_exceptions_are_still_needed():
    lazy = {(a, b) for a, b, inside in edges() if inside}
    assert lazy >= EXCEPTIONS


def circle(edges: list[tuple[str, str]]) -> list[str]:
    """Files that import one another in a circle, the first that is found."""
    graph: dict[str, set[str]] = {}
    for importer, imported in edges:
        graph.setdefault(importer, set()).add(imported)
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        return error.args[1]
    return []


def test_no_files_import_one_another_in_a_circle():
    known = modules()
    found = [
        (a, b if b in known else f"{b}.__init__")
        for a, b, _ in edges()
        if (a, b) not in EXCEPTIONS
    ]
    assert {b for _, b in found} <= set(known)
    assert not circle(found)
    assert circle([*found, ("jaxnarx.data.record", "jaxnarx.data.files")])
    # The exceptions do make circles, or they would need no exception.
    assert all(circle([*found, exception]) for exception in EXCEPTIONS)


def test_nothing_below_imports_the_package_itself():
    # Its list loads on first use: a module that asks for it makes a circle.
    users = {a for a, b, _ in edges() if b in ("jaxnarx", "jaxnarx.__init__")}
    assert all(room(module) == "shell" for module in users), users


def test_the_rule_catches_what_it_should():
    assert not allowed("jaxnarx.arrays.windows", "jaxnarx.data")
    assert not allowed("jaxnarx.simulation", "jaxnarx.refinement._refine")
    assert not allowed("jaxnarx.refinement._refine", "jaxnarx.evaluation._report")
    assert not allowed("jaxnarx.selection.select_terms", "jaxnarx.partition")
    assert not allowed("jaxnarx.evaluation._report", "jaxnarx.shell.report.html")
    assert not allowed("jaxnarx.engines.pfi", "jaxnarx.simulation")
    assert not allowed("jaxnarx.data.files", "jaxnarx.engines")
    assert allowed("jaxnarx.refinement._refine", "jaxnarx.metrics")
    assert allowed("jaxnarx.evaluation.traces", "jaxnarx.metrics")
    assert allowed("jaxnarx.partition._grow", "jaxnarx.selection")
    assert allowed("jaxnarx.engines.engine", "jaxnarx.data")


def drives(path: Path) -> bool:
    """Whether a module takes steps of a search: `state = method.step(state)`."""
    return any(
        isinstance(node, ast.Assign)
        and isinstance(node.targets[0], ast.Name)
        and isinstance(node.value, ast.Call)
        and isinstance(node.value.func, ast.Attribute)
        and node.value.func.attr == "step"
        and len(node.value.args) == 1
        for node in ast.walk(parsed(path))
    )


def test_searches_have_one_place_where_steps_are_made_and_judged():
    known = modules()
    assert {m for m in known if drives(known[m])} == {"jaxnarx.arrays.iteration"}


def loaded(statement: str) -> set[str]:
    """Top-level modules that a fresh interpreter has loaded after `statement`."""
    code = f"{statement}\nimport sys\nprint(*{{m.split('.')[0] for m in sys.modules}})"
    found = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=120,
        cwd=Path(__file__).parent,
    )
    assert found.returncode == 0, found.stderr
    return set(found.stdout.split())


@pytest.mark.parametrize(
    "statement",
    [
        "import jaxnarx, jaxnarx.settings, jaxnarx.errors, jaxnarx.data",
        "from jaxnarx import Dataset, ForwardOLS, Lolimot, SpecError, check, read",
    ],
)
def test_settings_errors_and_data_do_without_jax(statement):
    modules = loaded(statement)
    assert "jaxnarx" in modules
    assert not modules & {"jax", "jaxlib", "equinox", "matplotlib", "pandas"}


def test_verbs_do_load_jax():
    # Else the test above shows nothing.
    assert "jax" in loaded("from jaxnarx import select")


# docstrings -----------------------------------------------------------------------


def public(tree: ast.Module) -> list[ast.FunctionDef | ast.ClassDef]:
    """Functions and classes of a module that have a public name."""
    return [
        node
        for node in tree.body
        if isinstance(node, ast.FunctionDef | ast.ClassDef)
        and not node.name.startswith("_")
    ]


def test_every_public_function_and_class_has_a_docstring():
    count, missing = 0, []
    for module, path in modules().items():
        tree = parsed(path)
        if ast.get_docstring(tree) is None and tree.body:
            missing.append(module)
        for node in public(tree):
            count += 1
            if ast.get_docstring(node) is None:
                missing.append(f"{module}.{node.name} (line {node.lineno})")
    assert count > 150, "the definitions were not found"
    assert not missing


def classes() -> dict[str, list[str]]:
    """Every class of the package by its name, with the modules that define it."""
    found: dict[str, list[str]] = {}
    for module, path in modules().items():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef):
                found.setdefault(node.name, []).append(module)
    return found


# Model files and flags know these by their class: a validity function and the settings
# that grow it; a command and what it prints;
# a filter inside a model and a step of preparation, both stored by their names.
NAMESAKES = {"SigmoidTree", "Report", "Leaderboard", "LowPass"}


def test_a_class_name_means_one_thing():
    double = {name for name, places in classes().items() if len(places) > 1}
    assert double == NAMESAKES


# The public surface ---------------------------------------------------------------

MOST_NAMES = 60
NAMED = re.compile(r"\bjnx\.([a-zA-Z_]+(?:\.[a-zA-Z_]+)*)")


def words_of_the_command_line() -> set[str]:
    found = set()
    for path in (PACKAGE / "shell").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            match node:
                case (
                    ast.Name(id=name) | ast.Attribute(attr=name) | ast.alias(name=name)
                ):
                    found.add(name)
    return found


def pages() -> str:
    """The README and what is written, not made, of the documentation."""
    written = sorted((ROOT / "docs").rglob("*.md"))
    paths = [p for p in written if not {"made", "_build"} & set(p.parts)]
    assert len(paths) > 20
    return "\n".join(p.read_text("utf-8") for p in [ROOT / "README.md", *paths])


def words_of_the_pages() -> set[str]:
    spans = re.findall(r"```.*?```|`[^`\n]*`", pages(), re.S)
    return set(re.findall(r"\w+", " ".join(spans)))


def names_in_docstrings() -> set[str]:
    """What follows `jnx.` in the package's docstrings."""
    found = set()
    for path in modules().values():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Module):
                found |= set(NAMED.findall(ast.get_docstring(node) or ""))
    return found


def names_in_the_pages() -> set[str]:
    return set(NAMED.findall(pages()))


def test_top_level_names_are_few_and_each_is_used():
    assert len(jaxnarx.__all__) <= MOST_NAMES
    used = words_of_the_command_line() | words_of_the_pages()
    used |= {name.split(".")[0] for name in names_in_docstrings()}
    assert not set(jaxnarx.__all__) - used


def test_names_that_texts_give_exist():
    missing = []
    for name in sorted(names_in_the_pages() | names_in_docstrings()):
        value: object = jaxnarx
        try:
            for part in name.split("."):
                value = getattr(value, part)
        except AttributeError:
            missing.append(name)
    assert not missing


def test_a_room_is_there_on_first_use_and_offers_what_no_other_name_does():
    rooms = set(dir(jaxnarx)) - set(jaxnarx.__all__)
    assert {"data", "design", "engines", "excitation", "inverse", "linear"} <= rooms
    top = {id(getattr(jaxnarx, name)) for name in jaxnarx.__all__}
    for room in ("design", "inverse", "linear"):
        for name in getattr(jaxnarx, room).__all__:
            value = getattr(getattr(jaxnarx, room), name)
            assert id(value) not in top and value.__doc__, f"{room}.{name}"
    code = "import jaxnarx as jnx; jnx.linear.fit_linear; jnx.excitation.aprbs"
    assert "jax" in loaded(code)


def test_every_public_name_is_there_and_described():
    told = {}
    for name in jaxnarx.__all__:
        value = getattr(jaxnarx, name)
        told[name] = value.__doc__
        for attribute, member in vars(value).items() if isinstance(value, type) else ():
            is_public = not attribute.startswith("_") or attribute == "__call__"
            if is_public and (callable(member) or isinstance(member, property)):
                told[f"{name}.{attribute}"] = getattr(value, attribute).__doc__
    assert not [name for name, text in told.items() if not (text or "").strip()]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("Kautz", "regressors.Kautz"),
        ("methods", "settings"),
        ("states", "linear"),
        ("targets", "exporters"),
        ("trust", "confidence"),
    ],
)
def test_old_names_say_where_they_are(old, new):
    with pytest.warns(DeprecationWarning, match=rf"is now jnx\.{new}"):
        assert getattr(jaxnarx, old) is operator.attrgetter(new)(jaxnarx)
